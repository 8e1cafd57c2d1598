"""A mesh through every stage of the preprocessing, as a worker runs them and with a real store, and its asset as the service opens it."""

from __future__ import annotations

import struct
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from backend import records
from backend.local_store import LocalStore
from backend.manifests import build_manifest
from backend.problems import problem_of
from backend.store import Store
from schemas.errors import SilhouetteError
from schemas.jobs import STAGES
from schemas.manifest import Manifest, StageRecord
from schemas.mesh import Problem
from service.assets import MeshAsset, load_asset
from tests.backend.accepting import accept
from worker.jobs import STAGE_FUNCTIONS, publish
from worker.stages import Inputs

HULL_FACES, TEXELS = 100, 64


@dataclass(frozen=True)
class Outcome:
    """What became of an upload: an asset, or the problem that refuses it; manifest: None when it was refused."""

    manifest: Manifest | None
    asset: MeshAsset | None
    problem: Problem | None

    @property
    def clips(self) -> bool:
        return self.asset is not None and self.asset.clip.available

    @property
    def reason(self) -> str:
        """Why it is not clipped, or not there at all."""
        if self.problem is not None:
            return f"{self.problem.code}: {self.problem.detail}"
        return self.asset.clip.reason or ""


def double_ply(mesh) -> bytes:
    """A binary PLY file with float64 positions, exactly those of the arrays."""
    vertices, faces = np.asarray(mesh[0], "<f8"), np.asarray(mesh[1], "<i4")
    rows = np.empty(len(faces), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    rows["n"], rows["v"] = 3, faces
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty double x\nproperty double y\n"
        f"property double z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return header.encode() + vertices.tobytes() + rows.tobytes()


def float_stl(mesh) -> bytes:
    """A binary STL file: float32 corners, no vertices in common."""
    corners = np.asarray(mesh[0], np.float32)[mesh[1]]
    rows = np.zeros(len(corners), np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]))
    rows["v"] = corners
    return bytes(80) + struct.pack("<I", len(corners)) + rows.tobytes()


def through(mesh, hull_faces: int = HULL_FACES, texels: int = TEXELS, repair: str = "auto") -> Outcome:
    """What becomes of (vertices, faces), uploaded as a PLY file of doubles."""
    return uploaded(double_ply(mesh), "mesh.ply", hull_faces=hull_faces, texels=texels, repair=repair)


def uploaded(data: bytes, name: str, **options) -> Outcome:
    """What becomes of a file. Only faults of the mesh are an outcome: anything else that a stage raises is a failed test."""
    with tempfile.TemporaryDirectory() as folder:
        store = LocalStore(Path(folder))
        mesh_id = accept(store, data, name, **options)
        made: dict[str, StageRecord | None] = {}
        for stage in STAGES:
            try:
                made[stage] = _run(store, mesh_id, stage)
            except SilhouetteError as error:
                return Outcome(None, None, problem_of(error))
        manifest = build_manifest(mesh_id, made)
        # mapped files stay readable when their folder is gone
        return Outcome(manifest, load_asset(store, manifest), None)


def _run(store: Store, mesh_id: str, stage: str) -> StageRecord:
    result = STAGE_FUNCTIONS[stage](Inputs(store, mesh_id, lambda _: None, lambda: False))
    assert result is not None
    with records.publishing(store, mesh_id):
        record = StageRecord(
            stage=stage,
            outcome="skipped" if result.skipped else "done",
            artifacts=publish(store, mesh_id, stage, result),
            report=result.report,
            seconds=0.0,
        )
        records.write_stage(store, mesh_id, record)
    return record
