"""Checks of the machine: Python, compiled kernels, limits, clock, drawing."""

from __future__ import annotations

import os
import platform
import resource
import sys
import tempfile
import time
from pathlib import Path

from backend.local_store import LocalStore
from schemas.render import RenderRequest
from service import kernels
from service.doctor.finding import Finding
from service.render.context import EglUnavailableError
from service.render.renderer import Renderer
from service.settings import ServiceSettings
from service.warm import octahedron

LEAST_PYTHON = (3, 11)
LEAST_FILES = 1024
CLOCK_S = 2.0
"""By which clocks may differ: keys and signed addresses expire by them."""

SIDE_PX = 64
DRAW_S = 120.0
"""Longest that the test picture may take; the first one compiles kernels."""


def check_python(_: ServiceSettings) -> Finding:
    """The interpreter."""
    found = f"{platform.python_version()}, {os.cpu_count()} processors"
    if sys.version_info[:2] < LEAST_PYTHON:
        return Finding(found, "use Python 3.11 or newer")
    return Finding(found)


def check_kernel_cache(_: ServiceSettings) -> Finding:
    """Where compiled kernels are kept: without a place every start compiles them again, for minutes."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(named) if named else Path(kernels.__path__[0]) / "__pycache__"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return Finding(str(folder))
    except OSError as error:
        return Finding(
            f"{folder}: {error.strerror}", "set NUMBA_CACHE_DIR to a folder that can be written, else each start compiles", is_fatal=False
        )


def check_files(_: ServiceSettings) -> Finding:
    """How many files and connections the process may have open."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < LEAST_FILES:
        return Finding(f"{soft} (at most {hard})", f"ulimit -n {LEAST_FILES}, or LimitNOFILE={LEAST_FILES} in the unit", is_fatal=False)
    return Finding(str(soft))


def check_clock(settings: ServiceSettings) -> Finding:
    """This machine's clock against that of the file system of its data."""
    try:
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=settings.data_dir) as file:
            apart_s = time.time() - Path(file.name).stat().st_mtime
    except OSError as error:
        return Finding(f"{settings.data_dir}: {error.strerror}", "see what is said of the store", is_fatal=False)
    found = f"{abs(apart_s):.2f} s from that of {settings.data_dir}"
    return Finding(found) if abs(apart_s) <= CLOCK_S else Finding(found, "set the clock (timedatectl set-ntp true)")


def check_drawing(settings: ServiceSettings) -> Finding:
    """EGL, GL and a picture."""
    renderer = Renderer(1, settings.gpu_cache_mib, limit_s=DRAW_S)
    try:
        renderer.start()
    except EglUnavailableError as error:
        return Finding("no GL", str(error))
    try:
        with tempfile.TemporaryDirectory(prefix="silhouette-doctor-") as folder:
            started = time.perf_counter()
            image = renderer.submit(octahedron(LocalStore(Path(folder))), RenderRequest(width=SIDE_PX, height=SIDE_PX)).result(DRAW_S)
            ms = (time.perf_counter() - started) * 1e3
        found = f"{renderer.costs.device}: a picture in {ms:.0f} ms"
    finally:
        renderer.close()
    opaque = image.pixels[SIDE_PX // 2, SIDE_PX // 2, 3], image.pixels[0, 0, 3]
    if opaque != (255, 0):
        return Finding(f"{found}, and it is wrong", "update the GL driver, or set LIBGL_ALWAYS_SOFTWARE=1 to draw on the CPU")
    return Finding(found)
