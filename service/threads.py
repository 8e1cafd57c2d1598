"""Threads that share work with the caller: kernels release the interpreter lock, so that they run side by side."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

Made = TypeVar("Made")


@cache
def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


@cache
def pool() -> ThreadPoolExecutor:
    """Threads that wait for a share of somebody's work, one less than there are cores: the caller is one too."""
    return ThreadPoolExecutor(max(1, cores() - 1), thread_name_prefix="share")


def side_by_side(work: Callable[[], Made], count: int) -> list[Made]:
    """What `count` calls of work return, one of them made here and the others by the pool's threads at the same time.

    Raises what work raises, when all are done.
    """
    helpers = [pool().submit(work) for _ in range(count - 1)]
    try:
        own = work()
    finally:
        for helper in helpers:
            helper.exception()  # waits; quicker than `wait` of the library
    return [own, *(helper.result() for helper in helpers)]
