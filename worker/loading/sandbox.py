"""The parent's side of parsing: start the limited child, wait no longer than allowed, believe nothing it says unchecked."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO, Any

import numpy as np
import safetensors.numpy

import worker
from schemas.conventions import Array
from schemas.errors import SilhouetteError, TooLargeError
from worker.loading.faults import from_report, parse_failed, rejected
from worker.loading.limits import LoadLimits
from worker.loading.parsed import Parsed

MAX_REPORT = 1 << 16
_SHAPES: dict[str, tuple[str, tuple[int | str, ...]]] = {
    "positions": ("<f8", ("n", 3)),
    "faces": ("<i4", ("f", 3)),
    "corner_color": ("|u1", ("f", 3, 4)),
    "corner_uv": ("<f4", ("f", 3, 2)),
    "texture": ("|u1", ("h", "w", 4)),
}


def parse_limited(path: Path, extension: str, limits: LoadLimits) -> Parsed:
    """Parse an upload in a child process of its own.

    Raises MeshRejectedError, UnknownFormatError or TooLargeError; nothing of the child is left behind.
    """
    with tempfile.TemporaryFile() as result, tempfile.TemporaryFile() as report, path.open("rb") as upload:
        child = _start(extension, limits, upload, (result.fileno(), report.fileno()))
        try:
            status = child.wait(timeout=limits.wall_s)
        except subprocess.TimeoutExpired:
            raise rejected("time-limit", f"Reading the mesh takes longer than the {limits.wall_s:g} s that are allowed.") from None
        finally:
            _end(child)
        return _collect(result, report, status, limits)


def _start(extension: str, limits: LoadLimits, upload: IO[bytes], outputs: tuple[int, int]) -> subprocess.Popen[bytes]:
    root = str(Path(worker.__file__).resolve().parents[1])
    environment = {"PYTHONPATH": root, "PATH": os.defpath, "LC_ALL": "C.UTF-8", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    arguments = [extension, json.dumps(limits.as_dict()), str(os.getpid()), *map(str, outputs)]
    return subprocess.Popen(
        [sys.executable, "-s", "-P", "-m", "worker.loading.child", *arguments],
        stdin=upload,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd="/",
        env=environment,
        start_new_session=True,
        pass_fds=outputs,
    )


def _end(child: subprocess.Popen[bytes]) -> None:
    """Kill what is left of the child's session, and reap it."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, signal.SIGKILL)
    child.wait()


def _collect(result: IO[bytes], output: IO[bytes], status: int, limits: LoadLimits) -> Parsed:
    if status:
        raise _death(status, limits)
    report = _report(output)
    if "code" in report:
        raise from_report(str(report["code"]), report.get("message", ""), report.get("where") or {})
    tensors = _tensors(result, limits)
    notes = report.get("notes", {})
    positions, faces = tensors.pop("positions"), tensors.pop("faces")
    return Parsed(
        positions.astype(np.float64, copy=False), faces.astype(np.int32, copy=False), tensors, notes if isinstance(notes, dict) else {}
    )


def _death(status: int, limits: LoadLimits) -> SilhouetteError:
    if status == -signal.SIGXCPU:
        return rejected("time-limit", f"Reading the mesh takes more than the {limits.cpu_s} s of processor time that are allowed.")
    if status in (-signal.SIGKILL, -signal.SIGXFSZ):
        return rejected("out-of-memory", "Reading the mesh took too much memory.")
    return rejected("parser-crashed", "Reading the mesh brought its reader down.")


def _report(output: IO[bytes]) -> dict[str, Any]:
    try:
        output.seek(0)
        report = json.loads(output.read(MAX_REPORT))
    except (OSError, ValueError, RecursionError):
        raise rejected("parser-crashed", "Reading the mesh ended without a result.") from None
    if not isinstance(report, dict) or not isinstance(report.get("where", {}), dict):
        raise rejected("parser-crashed", "Reading the mesh ended without a result.")
    return report


def _tensors(result: IO[bytes], limits: LoadLimits) -> dict[str, Array]:
    """The child's arrays, each of the type and shape it must have, finite, with indices in range and within the caps."""
    try:
        result.seek(0)
        tensors = safetensors.numpy.load(result.read())
    except Exception:
        raise parse_failed("a mesh") from None
    bound: dict[str, int] = {}
    if not {"positions", "faces"} <= tensors.keys() <= _SHAPES.keys():
        raise parse_failed("a mesh")
    for name, array in tensors.items():
        dtype, shape = _SHAPES[name]
        if array.dtype != np.dtype(dtype) or array.ndim != len(shape):
            raise parse_failed("a mesh")
        if any(
            size != (dim if isinstance(dim, int) else bound.setdefault(dim, size)) for dim, size in zip(shape, array.shape, strict=True)
        ):
            raise parse_failed("a mesh")
    positions, faces = tensors["positions"], tensors["faces"]
    if len(faces) > limits.max_faces or len(positions) > limits.max_vertices * 2:
        raise TooLargeError(f"The mesh has {len(faces)} faces; {limits.max_faces} are allowed.", limit=limits.max_faces)
    sound = np.isfinite(positions).all() and len(faces) and faces.min() >= 0 and faces.max() < len(positions)
    if not sound or ("corner_uv" in tensors) != ("texture" in tensors):
        raise parse_failed("a mesh")
    if "corner_uv" in tensors and not (np.isfinite(tensors["corner_uv"]).all() and tensors["texture"].size):
        raise parse_failed("a mesh")
    return tensors
