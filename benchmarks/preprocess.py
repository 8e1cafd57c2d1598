"""Seconds and memory of the preprocessing of one mesh, as the service does it: a queue, and two worker processes.

    python -m benchmarks.preprocess MESH [--hull-faces 1000] [--texels 1024] [--workers 2] [--json]

MESH is a file or a name that `benchmarks.models` knows. A small mesh goes through first, so that kernels are compiled.
`two_core_seconds` is the time from the accepted upload to the manifest, waiting in the queue included; a stage's seconds are
those that it took beside what ran at the same time. `peak_mib` is what a stage's process had resident at most, interpreter and
libraries included.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from backend import records
from backend.queue import JobQueue
from backend.settings import BackendSettings
from benchmarks.models import mesh_file
from benchmarks.report import mesh_parser, report
from client.shapes import torus_knot, write_ply
from schemas import keys
from schemas.manifest import Accepted, Manifest
from schemas.mesh import DEFAULT_HULL_FACES, DEFAULT_TEXELS, PreprocessOptions
from service.embedded import EmbeddedBackend

Values = dict[str, Any]
POLL_S = 0.005
SMALL = PreprocessOptions(hull_faces=200, texels=64)
ENVIRONMENT = {"SILHOUETTE_LOG_LEVEL": "ERROR", "SILHOUETTE_MEASURE": "false"}


def accept(queue: JobQueue, mesh: Path, options: PreprocessOptions) -> str:
    """Take a mesh file as an upload; the mesh's id."""
    sha256, extension = hashlib.sha256(mesh.read_bytes()).hexdigest(), mesh.suffix.removeprefix(".").lower()
    upload = Path(queue.store.root) / mesh.name
    shutil.copyfile(mesh, upload)
    accepted = Accepted(
        id=keys.mesh_id(sha256, extension, options),
        name=mesh.name,
        extension=extension,
        upload_sha256=sha256,
        upload_bytes=mesh.stat().st_size,
        options=options,
        created=datetime.now(UTC),
    )
    records.accept(queue.store, accepted, upload)
    return accepted.id


def preprocess(queue: JobQueue, mesh: Path, options: PreprocessOptions) -> tuple[float, Manifest]:
    """(seconds, manifest) of a mesh file. Ends the program when the mesh cannot be clipped."""
    mesh_id = accept(queue, mesh, options)
    started = time.perf_counter()
    queue.advance(mesh_id)
    while (manifest := records.read_manifest(queue.store, mesh_id)) is None:
        time.sleep(POLL_S)
    seconds = time.perf_counter() - started
    if manifest.error is not None:
        raise SystemExit(manifest.error.detail)
    if manifest.hull is None:
        raise SystemExit(f"this mesh has no hull: {manifest.capabilities['clip'].reason}")
    return seconds, manifest


def run(mesh: str, hull_faces: int, texels: int, workers: int = 2) -> Values:
    """Preprocess a mesh by name; seconds, peaks and facts of the result."""
    with tempfile.TemporaryDirectory() as folder, mesh_file(mesh) as path:
        small = Path(folder) / "small.ply"
        write_ply(str(small), *torus_knot(160, 16))
        backend = EmbeddedBackend(Path(folder) / "data", workers, ENVIRONMENT)
        backend.start()
        try:
            queue = JobQueue.open(BackendSettings(data_dir=backend.data_dir, redis_url=backend.redis_url))
            preprocess(queue, small, SMALL)
            seconds, manifest = preprocess(queue, path, PreprocessOptions(hull_faces=hull_faces, texels=texels))
        finally:
            backend.stop()
    return {"mesh": Path(mesh).name, "two_core_seconds": round(seconds, 3), **described(manifest)}


def described(manifest: Manifest) -> Values:
    """What a manifest says of the work and its result."""
    assert manifest.hull is not None and manifest.stats is not None
    baked = next(record.report for record in manifest.stages if record.stage == "bake")
    stages = [{"name": record.stage, "seconds": round(record.seconds, 3), "peak_mib": record.peak_mib or 0.0} for record in manifest.stages]
    return {
        "faces": manifest.stats.faces,
        "stages": stages,
        "total_seconds": round(sum(record.seconds for record in manifest.stages), 3),
        "peak_mib": max(record.peak_mib or 0.0 for record in manifest.stages),
        "hull_faces": manifest.hull.faces,
        "volume_excess": round(manifest.hull.volume_excess, 5),
        "levels": [level.model_dump() for level in manifest.hull.levels],
        "capabilities": {name: capability.available for name, capability in manifest.capabilities.items()},
        "texels": baked["texel_count"],
        "missed_texels": baked["missed"],
    }


def print_table(result: Values) -> None:
    missed = f"{result['missed_texels']} of {result['texels']} texels missed"
    print(f"{result['mesh']}: {result['faces']} faces, hull of {result['hull_faces']}, {missed}")
    for stage in result["stages"]:
        print(f"  {stage['name']:<8}{stage['seconds']:9.2f} s {stage['peak_mib']:9.0f} MiB")
    print(f"  {'total':<8}{result['total_seconds']:9.2f} s {result['peak_mib']:9.0f} MiB")
    print(f"  upload to manifest: {result['two_core_seconds']:.2f} s")
    for level in result["levels"]:
        print(
            f"  {level['side']} level of {level['faces']} faces: {level['volume_excess']:.2%} volume, {level['distance']:.4g} away at most"
        )
    for name, available in result["capabilities"].items():
        print(f"  {name}: {'yes' if available else 'no'}")


def main() -> None:
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--hull-faces", type=int, default=DEFAULT_HULL_FACES)
    parser.add_argument("--texels", type=int, default=DEFAULT_TEXELS)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    report(lambda: run(options.mesh, options.hull_faces, options.texels, options.workers), options.json, print_table)


if __name__ == "__main__":
    main()
