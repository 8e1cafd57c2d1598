import json
import logging
import sys

from backend.logs import JsonFormatter


def line(**values):
    return json.loads(JsonFormatter("worker").format(logging.makeLogRecord({"name": "a.b", "levelname": "INFO", **values})))


def test_a_line_is_one_object_with_what_was_passed_as_extra():
    written = line(msg="stage %s", args=("done",), mesh="abc", seconds=1.5)
    assert written.pop("time").endswith("+00:00")
    assert written == {
        "level": "INFO",
        "logger": "a.b",
        "process": "worker",
        "message": "stage done",
        "mesh": "abc",
        "seconds": 1.5,
    }


def test_a_trace_stays_within_its_line():
    try:
        int("two\nlines")
    except ValueError:
        text = JsonFormatter("worker").format(logging.makeLogRecord({"msg": "broken", "exc_info": sys.exc_info()}))
    assert "\n" not in text
    assert "ValueError" in json.loads(text)["trace"]


def test_values_that_are_not_json_are_written_as_text():
    assert line(msg="x", where=set)["where"] == "<class 'set'>"
