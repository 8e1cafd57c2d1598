"""Threads that share work with the caller: kernels release the interpreter lock, so that they run side by side."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

Item = TypeVar("Item")
Made = TypeVar("Made")


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


@cache
def pool() -> ThreadPoolExecutor:
    """Threads that wait for a share of somebody's work, one less than there are cores: the caller is one too."""
    return ThreadPoolExecutor(max(1, cores() - 1), thread_name_prefix="share")


def share_out(work: Callable[[Item], Made], items: Sequence[Item]) -> list[Made]:
    """work of every item, in the order of the items; the caller and the pool's threads take the next one whenever they are free.

    Raises what work raises, of the first item that does, when all are done.
    """
    waiting = iter(range(len(items)))
    made: dict[int, Made] = {}

    def help_out() -> None:
        for i in waiting:
            made[i] = work(items[i])

    helpers = [pool().submit(help_out) for _ in range(min(cores(), len(items)) - 1)]
    try:
        help_out()
    finally:
        errors = [helper.exception() for helper in helpers]
    for error in errors:
        if error is not None:
            raise error
    return [made[i] for i in range(len(items))]
