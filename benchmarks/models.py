"""The meshes of the benchmarks: generated ones by name, scanned ones from a folder beside the checkout, or any file."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from client.shapes import three_holed_torus, torus_knot, write_ply

GENERATED = {"knot": torus_knot, "holes3": three_holed_torus}
"""Faces: knot 185,856, holes3 188,416, as in Silhouette Clipping, Table 1."""
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
SUFFIXES = (".ply", ".obj", ".off", ".stl", ".glb")
MESH_HELP = "a mesh file, knot, holes3, or the name of a scan in ../shared/data"


class AbsentError(LookupError):
    """A mesh, or something to compare with, is not on this machine."""


@contextmanager
def mesh_file(name: str) -> Iterator[Path]:
    """A file with the mesh, while the block runs. Raises AbsentError."""
    if name in GENERATED:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{name}.ply"
            write_ply(str(path), *GENERATED[name]())
            yield path
    else:
        yield _existing(name)


def _existing(name: str) -> Path:
    candidates = [Path(name), *(DATA / f"{name}{suffix}" for suffix in SUFFIXES)]
    for path in candidates:
        if path.is_file():
            return path
    raise AbsentError(f"{name} is not on this machine: no such file, and not in {DATA}")
