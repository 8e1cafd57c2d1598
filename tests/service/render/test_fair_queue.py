"""Owners take turns, whatever each has waiting; the longest line makes room."""

from __future__ import annotations

import threading
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.render.fair_queue import FairQueue, FullError


def filled(depth, *items):
    queue: FairQueue[tuple[str, int]] = FairQueue(depth)
    for item in items:
        queue.put(item[0], item)
    return queue


def test_owners_take_turns_and_each_keeps_its_order():
    queue = filled(8, ("a", 1), ("a", 2), ("a", 3), ("b", 1), ("c", 1), ("b", 2))
    taken = [queue.take() for _ in range(6)]
    assert taken == [("a", 1), ("b", 1), ("c", 1), ("a", 2), ("b", 2), ("a", 3)]


def test_one_who_comes_last_does_not_wait_for_all_of_a_crowd():
    queue = filled(101, *(("crowd", n) for n in range(100)), ("one", 0))
    assert [queue.take() for _ in range(2)] == [("crowd", 0), ("one", 0)]


def test_full_queue_drops_the_last_of_the_longest_line():
    queue = filled(4, ("a", 1), ("a", 2), ("a", 3), ("b", 1))
    assert queue.put("c", ("c", 1)) == ("a", 3)
    assert len(queue) == 4


def test_full_queue_refuses_the_longest_line_itself():
    queue = filled(2, ("a", 1), ("a", 2))
    with pytest.raises(FullError):
        queue.put("a", ("a", 3))


def test_full_queue_refuses_who_would_have_as_many_as_the_longest_line():
    queue = filled(2, ("a", 1), ("b", 1))
    with pytest.raises(FullError):
        queue.put("c", ("c", 1))


def test_closing_wakes_who_waits_for_an_item_and_hands_over_what_is_left():
    queue, found = filled(2), []
    waiter = threading.Thread(target=lambda: found.append(queue.take()))
    waiter.start()
    assert queue.close() == []
    waiter.join(10)
    assert found == [None]
    assert filled(2, ("a", 1), ("b", 1)).close() == [("a", 1), ("b", 1)]


@given(st.integers(1, 6), st.lists(st.tuples(st.sampled_from("abc"), st.booleans()), max_size=60))
def test_nothing_is_lost_twice_given_or_beyond_the_depth(depth, steps):
    queue: FairQueue[tuple[str, int]] = FairQueue(depth)
    inside: list[tuple[str, int]] = []
    for number, (owner, takes) in enumerate(steps):
        if takes and inside:
            taken = queue.take()
            assert taken in inside
            assert taken == next(item for item in inside if item[0] == taken[0])
            inside.remove(taken)
            continue
        lines = Counter(name for name, _ in inside)
        try:
            dropped = queue.put(owner, (owner, number))
        except FullError:
            assert len(inside) == depth
            assert lines[owner] + 1 >= max(lines.values())
            continue
        inside.append((owner, number))
        if dropped is not None:
            assert lines[dropped[0]] == max(lines.values())
            inside.remove(dropped)
        assert len(queue) == len(inside) <= depth
    assert Counter(queue.close()) == Counter(inside)


def test_promised_items_have_a_place_do_not_count_and_never_give_way():
    queue = filled(2, ("a", 1))
    assert queue.put("a", ("a", 2), promised=True) is None
    assert queue.put("a", ("a", 3)) is None
    assert len(queue) == 2
    assert queue.put("b", ("b", 1)) == ("a", 3)
    assert queue.put("a", ("a", 4), promised=True) is None
    assert [queue.take() for _ in range(4)] == [("a", 1), ("b", 1), ("a", 2), ("a", 4)]


def test_of_an_owner_what_is_due_first_comes_first_and_in_its_order_what_is_due_alike():
    queue: FairQueue[str] = FairQueue(8)
    for item, due in (("long", 9.0), ("short", 2.0), ("middle", 5.0), ("short too", 2.0)):
        queue.put("a", item, due=due)
    queue.put("b", "another's", due=100.0)
    assert [queue.take() for _ in range(5)] == ["short", "another's", "short too", "middle", "long"]


def test_without_a_time_an_item_comes_after_all_that_wait():
    queue: FairQueue[str] = FairQueue(8)
    queue.put("a", "long", due=9.0)
    queue.put("a", "after", promised=True)
    queue.put("a", "short", due=1.0)
    assert [queue.take() for _ in range(3)] == ["short", "long", "after"]


def test_full_queue_drops_what_is_due_last():
    queue: FairQueue[str] = FairQueue(3)
    for item, due in (("long", 9.0), ("short", 2.0), ("middle", 5.0)):
        queue.put("a", item, due=due)
    assert queue.put("b", "new", due=50.0) == "long"
