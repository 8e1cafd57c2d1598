import json
import os

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from backend import artifacts
from backend.artifacts import identity_of, open_artifact, write_artifact
from backend.local_store import LocalStore
from benchmarks.growth import open_files
from schemas import keys
from schemas.artifacts import HULL_SEQUENCE, MAPS, MESH, TREE, Layout
from schemas.errors import CorruptArtifactError, StorageFullError

MESH_ID = "a" * 32
IDENTITY = identity_of(MESH_ID, "load")


def mesh_tensors(edges=True):
    rng = np.random.default_rng(1)
    tensors = {
        "positions": rng.normal(size=(5, 3)).astype(np.float32),
        "faces": rng.integers(0, 5, (6, 3)).astype(np.int32),
        "normals": rng.normal(size=(5, 3)).astype(np.float32),
    }
    if edges:
        tensors |= {name: rng.integers(0, 5, (9, 2)).astype(np.int32) for name in ("edge_vertices", "edge_faces")}
    return tensors


def sequence_tensors(steps):
    return {
        "step_vertices": np.zeros((steps, 2), np.int32),
        "step_positions": np.zeros((steps, 3), np.float32),
        "level_faces": np.zeros(1, np.int32),
        "level_steps": np.zeros(1, np.int32),
    }


@pytest.fixture
def written(store):
    digest = write_artifact(store, MESH_ID, MESH, mesh_tensors(), IDENTITY)
    return store.local_path(keys.artifact(MESH_ID, MESH.file)), digest


def test_tensors_come_back_as_they_went(store, written):
    opened = open_artifact(written[0], MESH, identity=IDENTITY, verify=True)
    assert opened.keys() == mesh_tensors().keys()
    for name, array in mesh_tensors().items():
        np.testing.assert_array_equal(opened[name], array)
        assert opened[name].dtype == array.dtype
        assert type(opened[name]) is np.ndarray


@pytest.mark.parametrize(("vertices", "kept_open"), [(100, 0), (40_000, 1)])
def test_small_files_are_read_and_only_large_ones_stay_open(store, vertices, kept_open):
    tensors = {"positions": np.ones((vertices, 3), np.float32), "faces": np.zeros((4, 3), np.int32), "normals": np.ones((1, 3), np.float32)}
    write_artifact(store, MESH_ID, MESH, tensors, IDENTITY)
    path = store.local_path(keys.artifact(MESH_ID, MESH.file))
    before = open_files(os.getpid())
    opened = open_artifact(path, MESH, verify=True)
    assert open_files(os.getpid()) == before + kept_open
    np.testing.assert_array_equal(opened["positions"], tensors["positions"])
    with pytest.raises(ValueError, match="read-only"):
        opened["faces"][0] = 1


def test_views_cannot_be_written(written):
    for array in open_artifact(written[0], MESH).values():
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_views_outlive_the_file_and_are_aligned(written):
    opened = open_artifact(written[0], MESH)
    written[0].unlink()
    for name, array in mesh_tensors().items():
        np.testing.assert_array_equal(opened[name], array)
        assert opened[name].flags.aligned


def test_the_library_reads_the_same(written):
    with safe_open(str(written[0]), framework="numpy") as file:
        assert set(file.keys()) == set(mesh_tensors())
        assert file.metadata() == {"identity": IDENTITY, "sha256": written[1]}
        np.testing.assert_array_equal(file.get_tensor("faces"), mesh_tensors()["faces"])


def test_equal_tensors_give_equal_bytes_and_hash(store, written):
    first = written[0].read_bytes()
    shuffled = dict(reversed(mesh_tensors().items())) | {"faces": np.asfortranarray(mesh_tensors()["faces"])}
    assert write_artifact(store, MESH_ID, MESH, shuffled, IDENTITY) == written[1]
    assert written[0].read_bytes() == first


def test_optional_tensors_may_be_absent_and_empty_ones_are_kept(store):
    write_artifact(store, MESH_ID, MESH, mesh_tensors(edges=False), IDENTITY)
    assert "edge_faces" not in open_artifact(store.local_path(keys.artifact(MESH_ID, MESH.file)), MESH)
    none = sequence_tensors(0)
    write_artifact(store, MESH_ID, HULL_SEQUENCE, none, IDENTITY)
    opened = open_artifact(store.local_path(keys.artifact(MESH_ID, HULL_SEQUENCE.file)), HULL_SEQUENCE, verify=True)
    assert opened["step_positions"].shape == (0, 3)


def test_tensors_of_mixed_width_are_aligned(store):
    maps = {
        "tile_uv": np.zeros((3, 3, 2), np.float32),
        "normal": np.full((5, 7, 3), 3, np.uint8),
        "color": np.full((5, 7, 4), 4, np.uint8),
    }
    write_artifact(store, MESH_ID, MAPS, maps, IDENTITY)
    opened = open_artifact(store.local_path(keys.artifact(MESH_ID, MAPS.file)), MAPS, verify=True)
    assert opened["tile_uv"].flags.aligned
    np.testing.assert_array_equal(opened["normal"], maps["normal"])


@pytest.mark.parametrize(
    "change",
    [
        {"positions": None},
        {"extra": np.zeros(3, np.float32)},
        {"positions": np.zeros((5, 3))},
        {"positions": np.zeros((5, 4), np.float32)},
        {"positions": np.zeros(15, np.float32)},
        {"normal_vertices": np.zeros(6, np.int32)},
        {"edge_faces": np.zeros((8, 2), np.int32)},
        {"faces": np.zeros((6, 3), ">i4")},
    ],
)
def test_tensors_that_do_not_fit_the_layout_are_not_written(store, change):
    tensors = {name: array for name, array in (mesh_tensors() | change).items() if array is not None}
    with pytest.raises(ValueError, match=MESH.file):
        write_artifact(store, MESH_ID, MESH, tensors, IDENTITY)
    assert list(store.list()) == []


def test_no_room_while_writing_leaves_nothing(small_disk):
    store = LocalStore(small_disk / "store")
    large = sequence_tensors(1 << 17)
    with pytest.raises(StorageFullError):
        write_artifact(store, MESH_ID, HULL_SEQUENCE, large, IDENTITY)
    assert [path for path in small_disk.rglob("*") if path.is_file() and ".locks" not in path.parts] == []


# One rejection test for each fault a file can have.


def parts(path):
    data = path.read_bytes()
    length = int.from_bytes(data[:8], "little")
    return json.loads(data[8 : 8 + length]), data[8 + length :]


def rewrite(path, header, body, length=None):
    text = json.dumps(header).encode() if isinstance(header, dict | list) else header
    text += b" " * (-len(text) % 8)
    path.write_bytes((len(text) if length is None else length).to_bytes(8, "little") + text + body)


def refused(path, layout=MESH, **options):
    with pytest.raises(CorruptArtifactError) as caught:
        open_artifact(path, layout, **options)
    assert str(path) not in caught.value.message


def test_rejects_a_file_that_is_missing(tmp_path):
    refused(tmp_path / "nothing")


@pytest.mark.parametrize("size", [0, 1, 7, 8, 9, 100])
def test_rejects_a_file_cut_within_its_header(written, size):
    written[0].write_bytes(written[0].read_bytes()[:size])
    refused(written[0])


def test_rejects_a_file_cut_within_its_tensors(written):
    written[0].write_bytes(written[0].read_bytes()[:-1])
    refused(written[0])


def test_rejects_bytes_behind_the_tensors(written):
    written[0].write_bytes(written[0].read_bytes() + b"\0")
    refused(written[0])


@pytest.mark.parametrize("length", [0, 1 << 40, (1 << 64) - 1])
def test_rejects_a_header_length_that_lies(written, length):
    rewrite(written[0], *parts(written[0]), length=length)
    refused(written[0])


@pytest.mark.parametrize("text", [b"", b"{", b"not json", b"[]", b"null", b'{"positions": 3}', b"\xff\xfe{}"])
def test_rejects_a_header_that_is_no_table(written, text):
    rewrite(written[0], text, parts(written[0])[1])
    refused(written[0])


def test_rejects_missing_metadata(written):
    header, body = parts(written[0])
    del header["__metadata__"]
    rewrite(written[0], header, body)
    refused(written[0])


def test_rejects_another_identity(written):
    refused(written[0], identity=identity_of("b" * 32, "load"))


def test_rejects_changed_bytes_when_asked_to_verify(written):
    data = bytearray(written[0].read_bytes())
    data[-1] ^= 1
    written[0].write_bytes(data)
    open_artifact(written[0], MESH)
    refused(written[0], verify=True)


def test_rejects_the_artifact_of_another_layout(written):
    refused(written[0], layout=TREE)


def test_rejects_a_missing_tensor(tmp_path):
    tensors = mesh_tensors()
    del tensors["normals"]
    save_file(tensors, tmp_path / "x", {"identity": IDENTITY, "sha256": ""})
    refused(tmp_path / "x")


def test_rejects_an_unknown_tensor(tmp_path):
    save_file(mesh_tensors() | {"more": np.zeros(2, np.float32)}, tmp_path / "x", {"identity": IDENTITY, "sha256": ""})
    refused(tmp_path / "x")


def test_rejects_another_dtype(tmp_path):
    tensors = mesh_tensors()
    save_file(tensors | {"faces": tensors["faces"].astype(np.int64)}, tmp_path / "x", {"identity": IDENTITY, "sha256": ""})
    refused(tmp_path / "x")


def test_rejects_an_unknown_dtype(written):
    header, body = parts(written[0])
    header["faces"]["dtype"] = "BF16"
    rewrite(written[0], header, body)
    refused(written[0])


def test_rejects_sides_that_do_not_belong_together(tmp_path):
    tensors = mesh_tensors()
    save_file(tensors | {"edge_faces": tensors["edge_faces"][:4]}, tmp_path / "x", {"identity": IDENTITY, "sha256": ""})
    refused(tmp_path / "x")


def test_rejects_a_side_that_is_not_the_fixed_one(tmp_path):
    save_file(mesh_tensors() | {"faces": np.zeros((6, 4), np.int32)}, tmp_path / "x", {"identity": IDENTITY, "sha256": ""})
    refused(tmp_path / "x")


@pytest.mark.parametrize(
    "offsets", [[0, 1 << 40], [-4, 56], [1 << 62, (1 << 62) + 72], [72, 0], [4, 76], [0], [0, 72, 144], ["0", "72"], [0.0, 72.0], None]
)
def test_rejects_offsets_outside_or_against_the_shape(written, offsets):
    header, body = parts(written[0])
    header["faces"]["data_offsets"] = offsets
    rewrite(written[0], header, body)
    refused(written[0])


@pytest.mark.parametrize("shape", [[6, -3], [-6, -3], [1 << 62, 3], [6, 2], [6, 3, 1], [18], "6", None, [6.0, 3.0]])
def test_rejects_shapes_against_the_bytes(written, shape):
    header, body = parts(written[0])
    header["faces"]["shape"] = shape
    rewrite(written[0], header, body)
    refused(written[0])


def test_rejects_overlapping_tensors(written):
    header, body = parts(written[0])
    header["edge_faces"]["data_offsets"] = header["edge_vertices"]["data_offsets"]
    rewrite(written[0], header, body)
    refused(written[0])


def test_own_checks_find_gaps_and_overlaps_without_the_library(written, monkeypatch):
    monkeypatch.setattr(artifacts, "_library_check", lambda path: None)
    header, body = parts(written[0])
    overlapping = json.loads(json.dumps(header))
    overlapping["edge_faces"]["data_offsets"] = overlapping["edge_vertices"]["data_offsets"]
    for changed, bytes_ in ((overlapping, body), (header, body + b"\0" * 8)):
        rewrite(written[0], changed, bytes_)
        refused(written[0])


def test_rejects_a_misaligned_tensor(tmp_path, monkeypatch):
    monkeypatch.setattr(artifacts, "_library_check", lambda path: None)
    layout = Layout("x", {"a": ("|u1", ("k",)), "b": ("<f4", ("m",))})
    header = {
        "__metadata__": {"identity": IDENTITY, "sha256": ""},
        "a": {"dtype": "U8", "shape": [1], "data_offsets": [0, 1]},
        "b": {"dtype": "F32", "shape": [1], "data_offsets": [1, 5]},
    }
    rewrite(tmp_path / "x", header, b"12345")
    refused(tmp_path / "x", layout=layout)
