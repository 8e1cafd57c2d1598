"""What is fuzzed: readers of bytes that strangers send or that a disk may have changed. Each takes bytes, and raises only what it must not.

An error of the project's own tree is an answer; anything else that leaves a target, and any claim below that fails, is a finding.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
from starlette.datastructures import Headers

from backend.artifacts import open_artifact
from schemas import artifacts
from schemas.access import KeyRecord, Scope
from schemas.errors import CorruptArtifactError, ForbiddenError, InvalidRequestError, SilhouetteError
from schemas.mesh import PreprocessOptions
from service.access.credentials import challenges, is_foreign_write, token_of
from service.access.signing import check, key_of, parse, without_signature
from service.access.tokens import parse_token
from service.positions import poses_in
from worker.load import build
from worker.loading import sniff
from worker.loading.limits import LoadLimits
from worker.loading.parse import parse as parse_mesh

LIMITS = LoadLimits(memory_mib=2048, max_vertices=20_000, max_faces=10_000, max_texture_px=256, unpacked_mib=16)
OPTIONS = PreprocessOptions()
POSE_VERTICES = 4
KEY = KeyRecord(id="a1b2c3d4", name="fuzz", scopes=[Scope.READ], created=datetime(2026, 1, 1, tzinfo=UTC), secret_sha256="5e" * 32)


def load(extension: str, data: bytes) -> None:
    """Bytes as a mesh of this format: parsed as the limited child does it, then repaired and framed as the stage does it."""
    try:
        parsed = parse_mesh(extension, data, LIMITS)
        assert np.isfinite(parsed.positions).all()
        assert 0 <= parsed.faces.min() <= parsed.faces.max() < len(parsed.positions)
        mesh = build(parsed, OPTIONS)
    except SilhouetteError:
        return
    except MemoryError:  # the child answers that with its own code
        return
    assert np.isfinite(mesh.positions).all() and np.isfinite(mesh.shading.tensors()["normals"]).all()
    assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.positions)
    assert mesh.edges is not None or not mesh.clip.available


def artifact(data: bytes) -> None:
    """Bytes as an artifact file of every layout; what is opened must be within the file and as its layout says."""
    with tempfile.NamedTemporaryFile() as file:
        file.write(data)
        file.flush()
        for layout in (artifacts.MESH, artifacts.APPEARANCE, artifacts.TREE, artifacts.HULL_SEQUENCE):
            try:
                tensors = open_artifact(Path(file.name), layout, verify=len(data) % 2 == 0)
            except CorruptArtifactError:
                continue
            for name, tensor in tensors.items():
                assert tensor.dtype.str == layout.tensors[name][0]
                tensor.sum()


def positions(data: bytes) -> None:
    """Bytes as positions of a mesh of four vertices."""
    with tempfile.NamedTemporaryFile() as file:
        file.write(data)
        file.flush()
        try:
            poses = poses_in(Path(file.name), POSE_VERTICES)
        except InvalidRequestError:
            return
        assert poses.shape[1:] == (POSE_VERTICES, 3) and poses.dtype.str in ("<f4", "<f8")
        assert poses.nbytes <= len(data)
        poses.sum()


def signature(data: bytes) -> None:
    """Bytes as `PATH?QUERY` of a signed address. Nobody here knows the secret: it is never good."""
    path, _, query = data.decode("latin-1").partition("?")
    try:
        found = parse(query)
        if found is None:
            return
        pairs, given = found
        key_of(pairs)
        without_signature(pairs)
        check(KEY, path, pairs, given)
    except ForbiddenError:
        return
    raise AssertionError("a signature that nobody made is good")


def credentials(data: bytes) -> None:
    """Bytes as header lines `name: value`."""
    lines = [line.partition(b":")[::2] for line in data.split(b"\n")]
    headers = Headers(raw=[(name.strip().lower(), value.strip()) for name, value in lines])
    token = token_of(headers)
    assert token is None or parse_token(token) is None or token.isascii()
    assert all(challenge.isascii() for challenge in challenges(headers))
    is_foreign_write("POST", headers, {"https://shop.example"})


TARGETS: dict[str, Callable[[bytes], None]] = {
    **{extension: partial(load, extension) for extension in sniff.FORMATS},
    "artifact": artifact,
    "positions": positions,
    "signature": signature,
    "credentials": credentials,
}
