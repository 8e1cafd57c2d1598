"""Waiting ends with the work, with the client, or with the clock; slots refuse what they cannot hold."""

import asyncio
import threading
from concurrent.futures import Future

import pytest
from starlette.requests import ClientDisconnect, Request

from schemas.errors import BusyError
from service.slots import Slots
from service.waiting import LOOK_S, wait_for, wait_until


def request(*messages):
    """A request that receives these messages, then nothing."""
    left = list(messages)

    async def receive():
        if left:
            return left.pop(0)
        return await asyncio.Future()

    return Request({"type": "http", "headers": []}, receive)


def test_result_of_the_work_is_returned():
    work: Future[int] = Future()
    work.set_result(3)
    assert asyncio.run(wait_for(request(), work, 1.0)) == 3


def test_error_of_the_work_is_raised():
    work: Future[int] = Future()
    work.set_exception(BusyError("no"))
    with pytest.raises(BusyError):
        asyncio.run(wait_for(request(), work, 1.0))


def test_client_that_left_cancels_the_work():
    work: Future[int] = Future()
    with pytest.raises(ClientDisconnect):
        asyncio.run(wait_for(request({"type": "http.request"}, {"type": "http.disconnect"}), work, 5.0))
    assert work.cancelled()


def test_time_that_is_up_cancels_the_work():
    work: Future[int] = Future()
    with pytest.raises(BusyError):
        asyncio.run(wait_for(request(), work, 0.01))
    assert work.cancelled()


def test_slots_refuse_what_they_cannot_hold_and_recover():
    slots, gate = Slots(1, 1, "test"), threading.Event()
    held = [slots.submit(gate.wait, 5.0), slots.submit(gate.wait, 5.0)]
    with pytest.raises(BusyError):
        slots.submit(gate.wait, 5.0)
    gate.set()
    assert [future.result(5.0) for future in held] == [True, True]
    assert slots.submit(lambda: 7).result(5.0) == 7
    slots.close()


def test_looking_goes_on_until_something_is_found_and_slows_down_where_it_is_told_to():
    looks = []

    def look():
        looks.append(threading.current_thread())
        return len(looks) if len(looks) == 12 else None

    assert asyncio.run(wait_until(request(), look, 10.0)) == 12
    assert threading.main_thread() not in looks
    looks.clear()
    with pytest.raises(BusyError):
        asyncio.run(wait_until(request(), lambda: looks.append(None), 0.5, last_look_s=0.25))
    assert 2 <= len(looks) < 0.5 / LOOK_S / 2


def test_looking_ends_with_the_client():
    with pytest.raises(ClientDisconnect):
        asyncio.run(wait_until(request({"type": "http.disconnect"}), lambda: None, 5.0))
