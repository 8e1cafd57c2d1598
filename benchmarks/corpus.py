"""Every mesh of a folder through the whole pipeline and seen from everywhere: a right result or a clear refusal, and nothing else.

    python -m benchmarks.corpus DIR [--only NAME ...] [--without NAME ...] [--views 24] [--size 256] [--json]

Each file that can be uploaded goes through a real queue and real worker processes, one after the other. `outcome` is `ready`; `refused`,
where the loader says what is wrong with the file; or `failed`, which is anything else: a stage that failed, a worker that died, a mesh that
took longer than it may, views that could not be measured. `reason` is that of the refusal or failure, or why a ready mesh cannot be
clipped. `seconds`: from upload to manifest. `peak_mib`: the most any stage's process had resident. The rest is what
`benchmarks.corpus_views` finds of a ready mesh. A small mesh goes through first, so that kernels are compiled. NAME is a file's name, with
or without its extension. Ends with status 1 when a bar is missed.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from backend import records
from backend.queue import JobQueue
from backend.settings import BackendSettings
from benchmarks.accuracy import COVERAGE_ERROR
from benchmarks.corpus_views import SIDE_PX, VIEWS, measure_views
from benchmarks.isolated import FailedError, isolated
from benchmarks.preprocess import ENVIRONMENT, SMALL, accept, preprocess
from benchmarks.report import NONE, markdown_table, number
from client.shapes import torus_knot, write_ply
from schemas.manifest import Manifest
from schemas.mesh import PreprocessOptions
from service.embedded import EmbeddedBackend
from service.uploads import EXTENSIONS
from worker.loading.faults import CODES

Values = dict[str, Any]
WORKERS = 2
POLL_S = 0.02
LEAST_LIMIT_S, LIMIT_MS_A_FACE = 240.0, 3.0
LIMIT_RATIO_OF_VIEWS = 2.0
"""Times the limit of preprocessing."""
REFUSALS = (CODES | {"unknown-format", "too-large"}) - {"parser-crashed"}
"""Codes of a loader that knows what is wrong with a file."""


class Pipeline:
    """A private queue and workers over a data folder; a context."""

    def __init__(self, data_dir: Path, workers: int = WORKERS) -> None:
        self.data_dir, self._workers = data_dir, workers

    def __enter__(self) -> Pipeline:
        self._backend = EmbeddedBackend(self.data_dir, self._workers, ENVIRONMENT)
        self._backend.start()
        self.queue = JobQueue.open(BackendSettings(data_dir=self._backend.data_dir, redis_url=self._backend.redis_url))
        return self

    def warm_up(self) -> None:
        """Put a small mesh through."""
        with tempfile.TemporaryDirectory() as folder:
            write_ply(str(small := Path(folder) / "small.ply"), *torus_knot(160, 16))
            preprocess(self.queue, small, SMALL)

    def __exit__(self, *_: object) -> None:
        self._backend.stop()

    def preprocess(self, mesh: Path, ms_a_face: float) -> tuple[float, Manifest]:
        """(seconds, manifest). Raises FailedError when it is not done in the time for its faces; the workers are then started anew."""
        mesh_id = accept(self.queue, mesh, PreprocessOptions())
        started = time.perf_counter()
        self.queue.advance(mesh_id)
        limit_s, faces = LEAST_LIMIT_S, None
        while (manifest := records.read_manifest(self.queue.store, mesh_id)) is None:
            time.sleep(POLL_S)
            if faces is None and (loaded := records.read_stage(self.queue.store, mesh_id, "load")) is not None:
                faces = loaded.report.get("stats", {}).get("faces", 0)
                limit_s = time_limit(faces, ms_a_face)
            if time.perf_counter() - started > limit_s:
                self._give_up(mesh_id)
                raise FailedError(f"not done after {limit_s:.0f} s")
        return time.perf_counter() - started, manifest

    def _give_up(self, mesh_id: str) -> None:
        self.queue.cancel(mesh_id)
        self._backend.stop(0.0)
        self.__enter__()


def time_limit(faces: int, ms_a_face: float) -> float:
    """Seconds that a mesh may take."""
    return LEAST_LIMIT_S + 1e-3 * ms_a_face * faces


def mesh_files(folder: Path, only: list[str], without: list[str]) -> list[Path]:
    """The files below a folder that can be uploaded, small ones first. Raises SystemExit for a name that no file has."""
    files = [path for path in folder.rglob("*") if path.suffix.lower().removeprefix(".") in EXTENSIONS and path.is_file()]
    known = {name for path in files for name in (path.name, path.stem)}
    if missing := [name for name in (*only, *without) if name not in known]:
        raise SystemExit(f"no mesh of this name: {', '.join(missing)}")
    chosen = [path for path in files if (not only or {path.name, path.stem} & {*only}) and not {path.name, path.stem} & {*without}]
    return sorted(chosen, key=lambda path: (path.stat().st_size, str(path)))


def run(folder: Path, files: list[Path], views: int, side: int, ms_a_face: float) -> Values:
    """{"meshes": one row a file, "bars": what is demanded of all of them}."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    rows = []
    with (
        tempfile.TemporaryDirectory() as data,
        Pipeline(Path(data) / "data") as pipeline,
        Progress(*columns, console=Console(stderr=True)) as progress,
    ):
        task = progress.add_task("kernels", total=len(files))
        pipeline.warm_up()
        for path in files:
            name = str(path.relative_to(folder))
            progress.update(task, description=name)
            rows.append({"file": name} | row_of(pipeline, path, views, side, ms_a_face))
            progress.advance(task)
            progress.console.print(f"{name}: {rows[-1]['outcome']}", markup=False, highlight=False)
    return {"meshes": rows, "bars": list(bars(rows))}


def row_of(pipeline: Pipeline, path: Path, views: int, side: int, ms_a_face: float) -> Values:
    """What there is to say of a mesh, whatever becomes of it."""
    try:
        seconds, manifest = pipeline.preprocess(path, ms_a_face)
    except FailedError as failed:
        return {"outcome": "failed", "reason": f"preprocessing: {failed}"}
    peaks = [record.peak_mib for record in manifest.stages if record.peak_mib is not None]
    row: Values = {"outcome": outcome_of(manifest), "reason": reason_of(manifest)}
    row |= {"seconds": round(seconds, 2), "peak_mib": max(peaks, default=None)}
    if row["outcome"] == "ready":
        assert manifest.stats is not None
        row |= {"faces": manifest.stats.faces, "closed": manifest.stats.closed, "hull_faces": manifest.hull and manifest.hull.faces}
        limit_s = LIMIT_RATIO_OF_VIEWS * time_limit(manifest.stats.faces, ms_a_face)
        started = time.perf_counter()
        try:
            measured, _ = isolated(measure_views, pipeline.data_dir, manifest.id, views, side, limit_s=limit_s)
        except FailedError as failed:
            return row | {"outcome": "failed", "reason": f"views: {failed}"}
        row |= measured | {"views_seconds": round(time.perf_counter() - started, 2)}
    return row


def outcome_of(manifest: Manifest) -> str:
    """ready, refused or failed."""
    if manifest.error is None:
        return "ready"
    return "refused" if (manifest.error.model_extra or {}).get("code") in REFUSALS and len(manifest.stages) == 1 else "failed"


def reason_of(manifest: Manifest) -> str | None:
    """Why a mesh is not ready, or cannot be clipped."""
    if manifest.error is not None:
        return manifest.error.detail
    clip = manifest.capabilities.get("clip")
    return None if clip is None or clip.available else clip.reason


def bars(rows: list[Values]) -> Iterator[Values]:
    """What is demanded of all meshes together, and whether it is reached."""
    worst = max((row["mask_error"] for row in rows if row.get("mask_error") is not None), default=0.0)
    demands = [
        ("meshes without a right result or a clear refusal", sum(row["outcome"] == "failed" for row in rows), 0),
        ("refusals without a reason", sum(row["outcome"] == "refused" and not row["reason"] for row in rows), 0),
        ("hulls that do not enclose", sum(row.get("enclosed") is False for row in rows), 0),
        ("eyes with another silhouette", sum(row.get("mismatches") or 0 for row in rows), 0),
        ("eyes with open contours", sum(row.get("unbalanced") or 0 for row in rows), 0),
        ("bad pictures", sum(row.get("bad_pictures", 0) for row in rows), 0),
        ("wrong pixels", sum(row.get("wrong_pixels", 0) for row in rows), 0),
        ("views refused", sum(len(row.get("refused_views", ())) for row in rows), 0),
        ("mask error, worst mesh", worst, COVERAGE_ERROR),
    ]
    for name, value, most in demands:
        yield {"name": name, "value": value, "most": most, "met": value <= most}


def print_table(result: Values) -> None:
    head = ["file", "outcome", "faces", "hull", "s", "MiB", "encloses", "mismatches", "mask error", "worst", "pixel", "dB", "reason"]
    rows = []
    for row in result["meshes"]:
        figures = [number(row.get(key)) for key in ("faces", "hull_faces", "seconds", "peak_mib")]
        enclosed = {True: "yes", False: "NO", None: NONE}[row.get("enclosed")]
        errors = [number(row.get("mismatches")), *(number(row.get(key), 2) for key in ("mask_error", "mask_error_worst", "largest_error"))]
        rows.append([row["file"], row["outcome"], *figures, enclosed, *errors, number(row.get("psnr_db"), 2), row["reason"] or ""])
    print(markdown_table(head, rows))
    for bar in result["bars"]:
        print(f"{'met' if bar['met'] else 'MISSED'}: {bar['name']}: {number(bar['value'])}, at most {number(bar['most'])}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="these meshes and no other")
    parser.add_argument("--without", nargs="+", default=[], metavar="NAME", help="all but these meshes")
    parser.add_argument("--views", type=int, default=VIEWS)
    parser.add_argument("--size", type=int, default=SIDE_PX, help="pixels along each side of a picture")
    parser.add_argument(
        "--ms-a-face", type=float, default=LIMIT_MS_A_FACE, help=f"a mesh may take {LEAST_LIMIT_S:.0f} s and so many ms a face"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    options = parser.parse_args()
    files = mesh_files(options.folder, options.only, options.without)
    result = run(options.folder, files, options.views, options.size, options.ms_a_face)
    if options.json:
        print(json.dumps(result))
    else:
        print_table(result)
    raise SystemExit(0 if all(bar["met"] for bar in result["bars"]) else 1)


if __name__ == "__main__":
    main()
