import threading
import time

import pytest
import redis

from backend import turns
from backend.redis_connection import connect
from backend.turns import Turn

NAME = "a-turn"


@pytest.fixture
def quick(monkeypatch):
    """Turns that run out soon."""
    monkeypatch.setattr(turns, "HELD_S", 1.5)
    monkeypatch.setattr(turns, "RENEW_S", 0.1)


def test_one_at_a_time_has_the_turn_and_nobody_for_a_while_after(connection):
    turn = Turn.take(connection, NAME)
    assert Turn.take(connection, NAME) is None
    with turn.held(3600.0):
        assert Turn.take(connection, NAME) is None
    assert Turn.take(connection, NAME) is None
    assert 3000.0 < connection.ttl(NAME) <= 3600.0
    assert Turn.take(connection, "another") is not None


def test_a_turn_lasts_as_long_as_what_is_done_in_it(connection, quick):
    turn = Turn.take(connection, NAME)
    with turn.held(0.001):
        time.sleep(2.0)
        assert Turn.take(connection, NAME) is None
    time.sleep(0.05)
    assert Turn.take(connection, NAME) is not None


def test_the_turn_of_one_that_died_runs_out(connection, quick):
    assert Turn.take(connection, NAME) is not None
    deadline = time.monotonic() + 30.0
    while (turn := Turn.take(connection, NAME)) is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert turn is not None


def test_what_fails_in_a_turn_ends_it_and_may_be_tried_again_soon(connection):
    with pytest.raises(ZeroDivisionError), Turn.take(connection, NAME).held(86_400.0):
        raise ZeroDivisionError
    assert 0 < connection.ttl(NAME) <= 60


def test_a_redis_that_forgot_a_turn_gives_it_again_and_the_first_ends_in_peace(connection):
    turn = Turn.take(connection, NAME)
    with turn.held(0.001):
        connection.flushall()
        second = Turn.take(connection, NAME)
        assert second is not None
    assert Turn.take(connection, NAME) is None, "the first does not end the second's"


def test_many_at_once_get_one_turn(connection, redis_url):
    start, taken = threading.Barrier(6), []

    def take():
        own = connect(redis_url)
        start.wait()
        taken.append(Turn.take(own, NAME))
        own.close()

    threads = [threading.Thread(target=take) for _ in range(6)]
    [t.start() for t in threads]
    [t.join() for t in threads]
    assert sum(turn is not None for turn in taken) == 1


def test_without_redis_there_is_no_turn(tmp_path):
    with pytest.raises(redis.RedisError):
        Turn.take(connect(f"unix://{tmp_path}/nothing.sock"), NAME)
