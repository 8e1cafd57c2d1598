"""Tasks in two threads: at the same time, in order, and ended by whoever hears of the progress."""

from __future__ import annotations

import threading

import pytest

from schemas.errors import CancelledError
from worker.kernels import bake_boxes, verify_enclosure, verify_maps, verify_tree
from worker.side_by_side import run_side_by_side


def quiet(_):
    pass


def test_results_are_in_the_order_of_the_tasks_and_errors_stay_with_theirs():
    first_may_end = threading.Event()

    def slow():
        assert first_may_end.wait(10.0)
        return "slow"

    def fails():
        first_may_end.set()
        raise ValueError("no")

    slow_one, failed, quick = run_side_by_side([slow, fails, lambda: "quick"], quiet)
    assert (slow_one.result(), quick.result()) == ("slow", "quick")
    with pytest.raises(ValueError, match="no"):
        failed.result()


def test_two_tasks_run_at_the_same_time():
    both = threading.Barrier(2, timeout=10.0)
    assert len({future.result() for future in run_side_by_side([both.wait, both.wait], quiet)}) == 2


def test_progress_rises_to_one_and_none_is_told_without_tasks():
    told = []
    run_side_by_side([lambda: None] * 5, told.append)
    assert told == sorted(told) and told[-1] == 1.0
    assert run_side_by_side([], told.clear) == [] and told


def test_what_progress_raises_passes_while_tasks_run_and_the_rest_is_not_begun():
    may_end, begun = threading.Event(), []

    def long():
        begun.append(1)
        may_end.wait(10.0)

    def cancelled(_):
        raise CancelledError("gone")

    with pytest.raises(CancelledError):
        run_side_by_side([long] * 6, cancelled)
    may_end.set()
    assert len(begun) <= 2


def test_the_kernels_that_take_long_let_the_other_thread_run():
    kernels = [bake_boxes.closest_points, verify_enclosure.contacts, verify_enclosure.crossings, verify_enclosure.winding_numbers]
    kernels += [verify_tree.unsound_node, verify_maps.texel_faults]
    assert all(kernel.targetoptions["nogil"] for kernel in kernels)
