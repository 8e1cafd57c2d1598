"""What one upload may cost, and how a process takes those limits on itself."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
from dataclasses import asdict, dataclass

MIB = 1 << 20
PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class LoadLimits:
    """Limits of the child that parses an upload, and of what it may hand back."""

    memory_mib: int = 4096
    cpu_s: int = 120
    wall_s: float = 240.0
    result_mib: int = 2048
    open_files: int = 64
    max_vertices: int = 30_000_000
    max_faces: int = 20_000_000
    max_texture_px: int = 4096
    """Longest side of the texture that is kept; a larger one is scaled down."""
    unpacked_mib: int = 1024
    """All members of a 3MF archive together."""
    unpacked_ratio: int = 100
    """Unpacked by packed bytes of an archive beyond 16 MiB; model XML packs to about a tenth."""

    def as_dict(self) -> dict[str, float]:
        """Plain numbers, to pass to the child."""
        return asdict(self)


def limit_this_process(limits: LoadLimits, parent: int) -> None:
    """Take on the limits, for good; die when the process `parent` dies."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it died before the line above
        os._exit(1)
    for what, soft in (
        (resource.RLIMIT_AS, limits.memory_mib * MIB),
        (resource.RLIMIT_FSIZE, limits.result_mib * MIB),
        (resource.RLIMIT_NOFILE, limits.open_files),
        (resource.RLIMIT_CPU, limits.cpu_s),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(what)[1]
        value = soft if hard == resource.RLIM_INFINITY else min(soft, hard)
        # processor time needs a second between the two: at the soft limit comes SIGXCPU, which says why; then SIGKILL
        more = int(what == resource.RLIMIT_CPU and value != hard)
        resource.setrlimit(what, (value, value + more))
