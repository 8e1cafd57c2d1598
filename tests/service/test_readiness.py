import asyncio
import threading
import time

import pytest

from service.readiness import NO_ANSWER, Readiness


def test_the_answer_is_what_the_look_says():
    assert asyncio.run(Readiness(1.0).ask("store", lambda: "ok")) == "ok"


def test_a_look_that_hangs_is_no_answer_in_time_and_is_not_begun_twice():
    begun, end = [], threading.Event()

    def hang():
        begun.append(1)
        end.wait(20.0)
        return "ok"

    async def three():
        readiness = Readiness(0.1)
        started = time.monotonic()
        answers = [await readiness.ask("store", hang) for _ in range(2)]
        other = await readiness.ask("queue", lambda: "ok")
        took = time.monotonic() - started
        end.set()
        while (last := await readiness.ask("store", hang)) == NO_ANSWER:
            pass
        return answers, other, took, last

    answers, other, took, last = asyncio.run(three())
    assert (answers, other, last) == ([NO_ANSWER, NO_ANSWER], "ok", "ok")
    assert took < 5.0
    assert len(begun) <= 2


def test_those_who_ask_at_once_get_the_same_answer():
    looked = []

    def look():
        looked.append(1)
        time.sleep(0.05)
        return "ok"

    async def ask_together():
        readiness = Readiness(5.0)
        return await asyncio.gather(*(readiness.ask("store", look) for _ in range(5)))

    assert asyncio.run(ask_together()) == ["ok"] * 5
    assert len(looked) == 1


def test_what_a_look_raises_is_raised():
    def fails():
        raise OSError("gone")

    with pytest.raises(OSError, match="gone"):
        asyncio.run(Readiness(1.0).ask("store", fails))
