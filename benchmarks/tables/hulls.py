"""Hulls: faces, excess volume, seconds and a proof of enclosure, beside libigl's progressive hulls and Nested Cages.

    python -m benchmarks.tables.hulls [MESH ...] [--quick] [--json] [--out DIR]

Every hull, ours or not, is checked independently of how it was made: the winding number at all vertices of the original and at
random points of its faces (`tests.oracles_hull`). Volumes are those of the winding number's integral, over the original's.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks import hull, rivals
from benchmarks.isolated import FailedError, isolated
from benchmarks.models import AbsentError, mesh_file
from benchmarks.report import NONE, Result, markdown_table, number
from benchmarks.rivals import RivalHull
from benchmarks.tables.making import Table, main, say
from schemas.conventions import F4, F8, I4
from schemas.mesh import PreprocessOptions
from tests.oracles_hull import surface_points, uncovered
from worker.load import LoadedMesh, load_mesh

MESHES = ("bunny_closed", "armadillo_86k", "3holes", "fandisk", "knot", "holes3", "dragon_871k")
COUNTS = (500, 1_000, 4_000)
LARGE_FACES, LARGE_COUNTS = 400_000, (4_000,)
"""Meshes from so many faces on get these hulls only."""
CAGE_FACES, CAGE_COUNT, CAGE_LIMIT_S = 20_000, 1_000, 90.0
"""Nested Cages makes one hull of so many faces, of meshes of at most so many, in at most so long: of larger ones it takes minutes."""

QUICK_LIMIT_S = 5.0


def measure(mesh: str, quick: bool) -> Result:
    """Our hulls and the rivals'. {faces, ours: [row], our_mib, libigl: [row] or a word, nested_cages: [row] or a word}."""
    loaded, faces = _mesh(mesh)
    counts = list(COUNTS if faces < LARGE_FACES else LARGE_COUNTS)
    if quick:
        counts = [min(count, faces // 4) for count in counts[:1]]
    ours, mib = isolated(our_hulls, mesh, counts)
    result: Result = {"faces": ours["faces"], "ours": ours["hulls"], "our_mib": mib}
    result["libigl"] = _rival(lambda: [_row(loaded, rivals.igl_hull(*_arrays(loaded), count), count) for count in counts])
    result["nested_cages"] = _cage(loaded, CAGE_COUNT if CAGE_COUNT in counts else counts[0], QUICK_LIMIT_S if quick else CAGE_LIMIT_S)
    return result


def our_hulls(mesh: str, counts: list[int]) -> Result:
    """What `benchmarks.hull` says, kernels warm; in a process of its own, so that its memory is told apart."""
    with tempfile.TemporaryDirectory() as folder:
        hull.warm_up()
        return hull.run(mesh, counts, Path(folder))


def _mesh(name: str) -> tuple[LoadedMesh, int]:
    with mesh_file(name) as path:
        loaded = load_mesh(path, path.suffix, PreprocessOptions())
    return loaded, len(loaded.faces)


def _arrays(mesh: LoadedMesh) -> tuple[F4, I4]:
    return mesh.positions, mesh.faces


def _rival(make: Callable[[], list[Result]]) -> list[Result] | str:
    """The rows, or in a word why there are none."""
    try:
        return make()
    except (AbsentError, FailedError, RuntimeError, ValueError) as error:
        say(f"  rival: {error}")
        return str(error).partition("\n")[0]


def _cage(mesh: LoadedMesh, count: int, limit_s: float) -> list[Result] | str:
    if len(mesh.faces) > CAGE_FACES:
        return f"not tried on more than {CAGE_FACES:,} faces"
    return _rival(lambda: [_row(mesh, isolated(quiet_cage, *_arrays(mesh), count, limit_s=limit_s)[0], count)])


def quiet_cage(positions: F4, faces: I4, count: int) -> RivalHull:
    """Nested Cages without what it prints."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    return rivals.nested_cage(positions, faces, count)


def volume(positions: F4 | F8, faces: I4) -> float:
    """Volume counted with the winding number."""
    a, b, c = (np.asarray(positions, np.float64)[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def _row(mesh: LoadedMesh, made: RivalHull, requested: int) -> Result:
    points = np.concatenate([mesh.positions, surface_points(mesh.positions, mesh.faces, hull.SAMPLES)])
    outside = uncovered(mesh.positions, mesh.faces, made.positions, made.faces, points)
    return {
        "faces_requested": requested,
        "faces": len(made.faces),
        "seconds": round(made.seconds, 3),
        "volume_excess": volume(made.positions, made.faces) / volume(mesh.positions, mesh.faces) - 1.0,
        "enclosed": not bool(outside.any()),
    }


def text(result: Result) -> str:
    """One table: a row for each mesh, hull and maker."""
    rows = [line for name, row in result["meshes"].items() for line in _lines(name, row)]
    head = ["mesh", "faces", "hull", *(f"{maker}, %" for maker in MAKERS), *(f"{maker}, s" for maker in MAKERS), "do not enclose"]
    return f"{EXPLAINED}\n\n{markdown_table(head, rows)}\n\n{_words(result)}"


MAKERS = ("ours", "libigl", "Nested Cages")
EXPLAINED = """\
Excess volume over the original's in percent, then seconds (kernels warm, one core). libigl is
`igl.copyleft.progressive_hulls`; Nested Cages (Sacht, Vouga, Jacobson 2015) minimises volume as it re-inflates."""


def _lines(name: str, row: Result) -> list[list[str]]:
    lines = []
    for ours in row["ours"]:
        count = ours["faces_requested"]
        makers = [ours, *(_of(row[rival], count) for rival in ("libigl", "nested_cages"))]
        excess = [NONE if one is None else f"{100.0 * one['volume_excess']:.2f}" for one in makers]
        seconds = [NONE if one is None else number(one["seconds"]) for one in makers]
        pierced = [title for title, one in zip(MAKERS, makers, strict=True) if one is not None and not one["enclosed"]]
        lines.append([name, number(row["faces"]), number(ours["faces"]), *excess, *seconds, ", ".join(pierced) or "none"])
    return lines


def _of(rows: list[Result] | str, count: int) -> Result | None:
    return next((row for row in rows if row["faces_requested"] == count), None) if isinstance(rows, list) else None


def _words(result: Result) -> str:
    """What each rival that made nothing said."""
    said: dict[str, list[str]] = {}
    for name, row in result["meshes"].items():
        for rival, title in (("libigl", "libigl"), ("nested_cages", "Nested Cages")):
            if isinstance(row[rival], str):
                said.setdefault(f"{title}: {row[rival]}", []).append(name)
    return "\n".join(f"- {word} ({', '.join(names)})." for word, names in said.items())


TABLE = Table("hulls", "Hulls", MESHES, measure, text)

if __name__ == "__main__":
    main(TABLE)
