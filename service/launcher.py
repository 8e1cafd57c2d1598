"""Become another program that ends with its parent. Run by path: `python launcher.py PARENT_PID SIGNAL PROGRAM ARGUMENT...`.

A function between fork and exec is not safe in a process with threads, so this tiny program asks the kernel for the signal
and then executes the real one in its place, which keeps the request and the process id. The signal comes when the *thread*
that started the child ends. Standard library only.
"""

from __future__ import annotations

import ctypes
import os
import sys

PR_SET_PDEATHSIG = 1


def main() -> None:
    """Ask for the signal, then become the program; exits when the parent is gone already."""
    parent_pid, signal_number, *command = sys.argv[1:]
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(PR_SET_PDEATHSIG, int(signal_number), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl")
    if os.getppid() != int(parent_pid):
        sys.exit(1)
    os.execv(command[0], command)


if __name__ == "__main__":
    main()
