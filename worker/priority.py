"""How much of the processors this process leaves to others."""

from __future__ import annotations

import logging
import os
import time
from pathlib import Path

log = logging.getLogger("silhouette.worker")

AUTOGROUP = Path("/proc/self/autogroup")
TRIES, BETWEEN_TRIES_S = 5, 0.1
"""The kernel lets those without rights change one session every tenth of a second."""


def give_way(nice: int, worker: int) -> None:
    """Be at least so nice, 0 to 19; the session, too, if it is that of the worker with this process id, as it is beside a service.

    Where the kernel shares the processors between sessions first (autogroup, sched(7)), the nice value of a process counts only among
    those of its own session.
    """
    os.setpriority(os.PRIO_PROCESS, 0, max(nice, os.getpriority(os.PRIO_PROCESS, 0)))
    if os.getsid(0) != worker:
        return
    for _ in range(TRIES):
        try:
            AUTOGROUP.write_text(str(nice))
        except BlockingIOError:
            time.sleep(BETWEEN_TRIES_S)
        except FileNotFoundError:  # a kernel without
            return
        except OSError as error:
            log.warning("the session's priority stays as it is: %s", error)
            return
        else:
            return
