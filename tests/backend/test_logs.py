import json
import logging
import sys
from contextvars import copy_context

from backend.logs import JsonFormatter, bind, bound, bound_values


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


def test_what_is_bound_is_said_by_every_line_inside_and_by_none_after():
    with bound(request="r1"), bound(mesh="m1"):
        inside = line(msg="x", stage="load")
    assert (inside["request"], inside["mesh"], inside["stage"]) == ("r1", "m1", "load")
    assert not {"request", "mesh"} & line(msg="x").keys()


def test_what_is_bound_goes_with_a_copied_context_and_not_back():
    def bind_more():
        bind(mesh="m1")
        return dict(bound_values())

    with bound(request="r1"):
        assert copy_context().run(bind_more) == {"request": "r1", "mesh": "m1"}
        assert dict(bound_values()) == {"request": "r1"}
