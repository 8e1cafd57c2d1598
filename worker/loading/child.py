"""The process that touches hostile bytes: `python -m worker.loading.child EXTENSION LIMITS PARENT`, bytes on its input.

It writes `result.safetensors` or nothing, and `report.json`, into its working directory. It knows no path of the upload.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

from schemas.errors import SilhouetteError
from worker.loading.faults import parse_failed, rejected
from worker.loading.limits import LoadLimits, limit_this_process

RESULT, REPORT = "result.safetensors", "report.json"


def main(arguments: list[str]) -> int:
    """Parse the bytes on the standard input within the limits."""
    extension, limits, parent = arguments[0], LoadLimits(**json.loads(arguments[1])), int(arguments[2])
    limit_this_process(limits, parent)
    try:
        report = _run(extension, limits)
    except SilhouetteError as error:
        report = _failure(error)
    except MemoryError:
        report = _failure(rejected("out-of-memory", f"Reading the mesh takes more than the {limits.memory_mib} MiB that are allowed."))
    except OSError:
        report = _failure(rejected("out-of-memory", f"The mesh takes more than {limits.result_mib} MiB once it is read."))
    except Exception:
        report = _failure(parse_failed("a mesh"))
    Path(REPORT).write_text(json.dumps(report))
    return 0


def _failure(error: SilhouetteError) -> dict[str, Any]:
    return {"code": error.code, "message": error.message, "where": error.where}


def _run(extension: str, limits: LoadLimits) -> dict[str, Any]:
    data = sys.stdin.buffer.read()
    import safetensors.numpy

    from worker.loading.parse import parse

    parsed = parse(extension, data, limits)
    del data
    tensors = {"positions": parsed.positions, "faces": parsed.faces, **parsed.appearance}
    safetensors.numpy.save_file({k: _contiguous(v) for k, v in tensors.items()}, RESULT)
    return {"notes": parsed.notes}


def _contiguous(array: Any) -> Any:
    import numpy as np

    return np.ascontiguousarray(array)


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stdout.flush()
    os._exit(code)  # nothing to tear down, and a half-initialised library may hang in its exit hooks
