"""Accepted meshes for tests of what comes after."""

import hashlib
from datetime import UTC, datetime
from pathlib import Path

from backend import records
from schemas import keys
from schemas.manifest import Accepted, StageRecord
from schemas.mesh import PreprocessOptions


def accept(store, data=b"solid", name="a.stl", **options):
    """Accept bytes as the service does; the mesh's id."""
    sha256, extension = hashlib.sha256(data).hexdigest(), name.rpartition(".")[2]
    chosen = PreprocessOptions(**options)
    mesh_id = keys.mesh_id(sha256, extension, chosen)
    with store.temporary() as file:
        file.write(data)
        file.flush()
        records.accept(
            store,
            Accepted(
                id=mesh_id,
                name=name,
                extension=extension,
                upload_sha256=sha256,
                upload_bytes=len(data),
                options=chosen,
                created=datetime.now(UTC),
            ),
            Path(file.name),
        )
    return mesh_id


def record(store, mesh_id, stage, outcome="done", **values):
    with records.publishing(store, mesh_id):
        records.write_stage(store, mesh_id, StageRecord(stage=stage, outcome=outcome, seconds=0.1, **values))


def of_meshes(store):
    """Keys of everything that belongs to a mesh, and not to the store as a whole."""
    return [key for key in store.list() if key != keys.USES_COMPLETE]


LOAD_REPORT = {
    "frame": {"centre": [1.0, 2.0, 3.0], "scale": 2.0},
    "stats": {
        "vertices": 4,
        "faces": 4,
        "edges": 6,
        "components": 1,
        "closed": True,
        "oriented": True,
        "bounds": [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]],
    },
    "capabilities": {"clip": {"available": True, "reason": None}},
    "repairs": {"welded": 0},
}


def record_all(store, mesh_id):
    record(store, mesh_id, "load", report=LOAD_REPORT)
    record(store, mesh_id, "hull", report={"faces": 4, "volume_excess": 0.1})
    for stage in ("bake", "levels", "tree", "inner", "verify"):
        record(store, mesh_id, stage)
