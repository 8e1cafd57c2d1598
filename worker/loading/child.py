"""The process that touches hostile bytes: `python -m worker.loading.child EXTENSION LIMITS PARENT RESULT REPORT`.

The bytes are on its standard input, RESULT and REPORT are file descriptors it writes to: it knows no path at all, and as the
files behind them have no name, nothing of it can be left behind.
"""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from typing import Any

from schemas.errors import SilhouetteError
from worker.loading.faults import parse_failed, rejected
from worker.loading.limits import LoadLimits, limit_this_process

UNUSED = ("scipy", "networkx")
"""What the readers would import for half a second, and do not call; that of 3MF calls the second."""
ALONE = ("ply", "stl")
"""Formats whose readers call a few of trimesh's modules; the package itself imports them all, for another fifth of a second."""


DENIED = ("socket.", "subprocess.", "os.system", "os.exec", "os.posix_spawn", "os.fork", "webbrowser.", "urllib.")
"""Audit events (PEP 578) of what no reader has any business with."""


def main(arguments: list[str]) -> int:
    """Parse the bytes on the standard input within the limits."""
    extension, limits = arguments[0], LoadLimits(**json.loads(arguments[1]))
    parent, result, report = map(int, arguments[2:])
    limit_this_process(limits, parent)
    deny_network_and_programs()
    try:
        summary = _run(extension, limits, result)
    except SilhouetteError as error:
        summary = _failure(error)
    except (MemoryError, ImportError):  # a library that cannot be mapped is an import error
        summary = _failure(rejected("out-of-memory", f"Reading the mesh takes more than the {limits.memory_mib} MiB that are allowed."))
    except Exception:
        summary = _failure(parse_failed("a mesh"))
    _write(report, json.dumps(summary).encode())
    return 0


def deny_network_and_programs() -> None:
    """Make connections, look-ups of names and other programs a PermissionError in this process, for good."""

    def deny(event: str, _: tuple[Any, ...]) -> None:
        if event.startswith(DENIED):
            raise PermissionError(event)

    sys.addaudithook(deny)


def _failure(error: SilhouetteError) -> dict[str, Any]:
    return {"code": error.code, "message": error.message, "where": error.where}


def _run(extension: str, limits: LoadLimits, result: int) -> dict[str, Any]:
    data = sys.stdin.buffer.read()
    leave_out(extension)
    import numpy as np
    import safetensors.numpy

    from worker.loading.parse import parse

    parsed = parse(extension, data, limits)
    del data
    tensors = {"positions": parsed.positions, "faces": parsed.faces, **parsed.appearance}
    try:
        _write(result, safetensors.numpy.save({k: np.ascontiguousarray(v) for k, v in tensors.items()}))
    except OSError:
        raise rejected("out-of-memory", f"The mesh takes more than {limits.result_mib} MiB once it is read.") from None
    return {"notes": parsed.notes}


def leave_out(extension: str) -> None:
    """Make an import of what the format has no use for an ImportError, which the readers take for a library that is not there.

    Or, of modules of the readers' own package, nothing that happens.
    """
    for name in UNUSED[:1] if extension == "3mf" else UNUSED:
        sys.modules[name] = None  # type: ignore[assignment]
    package = importlib.util.find_spec("trimesh") if extension in ALONE else None
    if package is not None:
        sys.modules["trimesh"] = importlib.util.module_from_spec(package)  # knows where its modules are, and has run nothing


def _write(descriptor: int, data: bytes) -> None:
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stdout.flush()
    os._exit(code)  # nothing to tear down, and a half-initialised library may hang in its exit hooks
