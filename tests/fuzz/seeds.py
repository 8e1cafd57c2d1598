"""What fuzzing starts from: small sound inputs of every target, made here."""

from __future__ import annotations

import base64
import io
import tempfile
from pathlib import Path

import numpy as np
import trimesh

from backend.artifacts import write_artifact
from backend.local_store import LocalStore
from schemas import artifacts, keys
from service.access.signing import signature
from tests.fuzz.targets import KEY, POSE_VERTICES
from tests.meshes import cube, sphere
from tests.worker.loading.uploads import FORMATS, as_bytes, extension, glb

PLY_COLORS = b"""ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 4
property list uchar int vertex_indices
end_header
0 0 0 255 0 0
1 0 0 0 255 0
0 1 0 0 0 255
0 0 1 9 9 9
3 0 2 1
3 0 1 3
3 1 2 3
3 0 3 2
"""
OBJ_EXTRAS = b"""mtllib ../../etc/passwd
o a
v 0 0 0 1 0 0
v 1 0 0 0 1 0
v 1 1 0 0 0 1
v 0 1 \\
0 1 1 1
vt 0 0
vn 0 0 1
usemtl none
f 1/1/1 2/1/1 3/1/1 4/1/1
f -1 -2 -3
"""
OFF_COLORS = b"""COFF
4 4 0
0 0 0 255 0 0 255
1 0 0 0 255 0 255
0 1 0 0 0 255 255
0 0 1 9 9 9 255
3 0 2 1
3 0 1 3
3 1 2 3 1 0 0
3 0 3 2
"""


def seeds() -> dict[str, list[bytes]]:
    """Sound inputs of every target."""
    made: dict[str, list[bytes]] = {}
    for kind in FORMATS:
        made.setdefault(extension(kind), []).extend(as_bytes(mesh, kind) for mesh in (cube(), sphere(0)))
    made["ply"].append(PLY_COLORS)
    made["obj"].append(OBJ_EXTRAS)
    made["off"].append(OFF_COLORS)
    made["glb"] += [_painted_glb(), glb(b'{"asset":{"version":"2.0"},"nodes":[{"children":[0]}],"scenes":[{"nodes":[0]}],"scene":0}')]
    made |= {"artifact": _artifacts(), "positions": _positions(), "signature": _signatures(), "credentials": _credentials()}
    return made


def _painted_glb() -> bytes:
    from PIL import Image

    vertices, faces = cube()
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (4, 4), (200, 30, 30)))
    visual = trimesh.visual.TextureVisuals(uv=vertices[:, :2], material=material)
    data: bytes = trimesh.Trimesh(vertices, faces, visual=visual, process=False).export(file_type="glb")
    return data


def _artifacts() -> list[bytes]:
    mesh = {
        "positions": np.eye(3, dtype=np.float32),
        "faces": np.array([[0, 1, 2]], np.int32),
        "normals": np.eye(3, dtype=np.float32),
    }
    sequence = {
        "step_vertices": np.zeros((2, 2), np.int32),
        "step_positions": np.zeros((2, 3), np.float32),
        "level_faces": np.zeros(1, np.int32),
        "level_steps": np.zeros(1, np.int32),
    }
    painted = {"corner_color": np.zeros((1, 3, 4), np.uint8)}
    with tempfile.TemporaryDirectory() as folder:
        store, mesh_id = LocalStore(Path(folder)), "0" * 32
        wanted = ((artifacts.MESH, mesh), (artifacts.HULL_SEQUENCE, sequence), (artifacts.APPEARANCE, painted))
        for layout, tensors in wanted:
            write_artifact(store, mesh_id, layout, tensors, "fuzz")
        return [store.get_bytes(keys.artifact(mesh_id, layout.file)) for layout, _ in wanted]


def _positions() -> list[bytes]:
    made = [np.zeros((POSE_VERTICES, 3), "<f4").tobytes()]
    for poses in (np.zeros((POSE_VERTICES, 3), "<f8"), np.ones((2, POSE_VERTICES, 3), "<f4"), np.ones((3, POSE_VERTICES), "<f4").T):
        out = io.BytesIO()
        np.save(out, poses)
        made.append(out.getvalue())
    return made


def _signatures() -> list[bytes]:
    path, pairs = f"/v1/meshes/{'0' * 32}/thumbnail.png", [("size", "64"), ("exp", "4000000000"), ("kid", KEY.id)]
    good = signature(KEY, path, pairs)
    turned = good[:-2] + ("AA" if good[-2:] != "AA" else "BB")
    return [f"{path}?size=64&exp=4000000000&kid={KEY.id}&sig={turned}".encode(), f"{path}?sig=%zz&sig=a".encode()]


def _credentials() -> list[bytes]:
    basic = base64.b64encode(b"me:sil_a1b2c3d4_secret")
    return [
        b"Authorization: Bearer sil_a1b2c3d4_secret\nOrigin: https://shop.example\nHost: here",
        b"Authorization: Basic " + basic + b"\nSec-Fetch-Site: cross-site\nOrigin: null",
        b"X-API-Key: sil_a1b2c3d4_secret\nAccept: text/html",
    ]
