"""Checks that run in two threads: at the end of a mesh's preprocessing, where its one stage would leave a core idle.

Their kernels let go of the interpreter's lock (`nogil`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import TypeVar

T = TypeVar("T")

THREADS = 2
"""The finest level takes as long as all other checks together, so a third thread would wait; and each holds its own arrays."""
REPORT_S = 0.5


def run_side_by_side(tasks: Sequence[Callable[[], T]], progress: Callable[[float], None]) -> list[Future[T]]:
    """Run tasks, the first ones first; their futures, all of them done, in the order of the tasks. The tasks may raise anything.

    progress is called in this thread with the part 0 ... 1 of the tasks that are done, several times a second; what it raises passes
    through at once, and tasks that have not begun are not run.
    """
    pool = ThreadPoolExecutor(THREADS, thread_name_prefix="check")
    try:
        futures = [pool.submit(task) for task in tasks]
        pending = set(futures)
        while pending:
            _, pending = wait(pending, REPORT_S, FIRST_COMPLETED)
            progress(1.0 - len(pending) / len(futures))
        return futures
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
