"""Each fault of an upload has its own stable code."""

from __future__ import annotations

import json
import struct
from itertools import pairwise

import numpy as np
import pytest

from schemas.errors import MeshRejectedError, TooLargeError, UnknownFormatError
from tests.meshes import cube, shared, sphere
from tests.worker.loading.uploads import FORMATS, archive, as_bytes, extension, glb, loaded, parsed
from worker.loading.limits import LoadLimits

PLY_HEAD = "ply\nformat {format} 1.0\nelement vertex {v}\nproperty float x\nproperty float y\nproperty float z\n"
PLY_FACES = "element face {f}\nproperty list uchar int vertex_indices\nend_header\n"
MODEL = b'<?xml version="1.0"?>%s<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">%s</model>'


def code(data: bytes, kind: str, limits: LoadLimits | None = None) -> str:
    with pytest.raises(MeshRejectedError) as caught:
        parsed(data, kind, limits or LoadLimits())
    message = caught.value.message
    assert message[0].isupper() and message.endswith(".") and message.isprintable()
    assert not any(word in message for word in ("/tmp", "Error", "Traceback", "None", "0x"))
    return caught.value.code


@pytest.mark.parametrize("kind", FORMATS)
def test_an_empty_file_is_refused(kind):
    assert code(b"", kind) == "empty-file"
    assert code(b" \n\n", kind) == "not-a-mesh"


@pytest.mark.parametrize("kind", FORMATS)
def test_a_web_page_is_not_a_mesh(kind):
    assert code(b"<!DOCTYPE html><html><body>404 solid</body></html>" * 9, kind) == "not-a-mesh"


@pytest.mark.parametrize("kind", FORMATS)
def test_random_bytes_are_not_a_mesh(kind):
    noise = bytes(np.random.default_rng(1).integers(1, 256, 4096, dtype=np.uint8))
    assert code(b"\xf1" + noise, kind) in ("not-a-mesh", "truncated")


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "ply", "ply_ascii", "off", "glb", "3mf"])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_cut_off_file_is_truncated(kind, share):
    data = as_bytes(sphere(1), kind)
    assert code(data[: int(len(data) * share)], kind) == "truncated"


def test_a_cut_off_obj_breaks_off_in_a_line_or_lacks_what_its_faces_name():
    data = as_bytes(sphere(1), "obj")
    assert code(data[: data.index(b"\nf ") + 1], "obj") == "no-faces"
    assert code(data[: data.index(b"\nf ") - 20].rsplit(b" ", 1)[0], "obj") == "truncated"
    head, faces = data.split(b"\nf ", 1)
    assert code(head[: len(head) // 2].rsplit(b"\n", 1)[0] + b"\nf " + faces, "obj") == "index-out-of-range"


def test_bytes_of_another_format_are_named():
    for kind in ("stl", "obj", "ply", "off", "glb", "3mf"):
        for other in ("ply", "off", "glb", "stl"):
            if other == kind:
                continue
            with pytest.raises(MeshRejectedError) as caught:
                parsed(as_bytes(cube(), other), kind)
            assert caught.value.code == "format-mismatch"
            assert kind.upper() in caught.value.message and other.upper() in caught.value.message


@pytest.mark.parametrize("name", ["txt", "", "fbx", "gltf", "zip", "stl.gz", "../stl"])
def test_an_unknown_format_is_refused(name, tmp_path):
    with pytest.raises(UnknownFormatError) as caught:
        loaded(tmp_path, as_bytes(cube(), "stl"), name)
    assert caught.value.code == "unknown-format"


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        ("stl", b"\0" * 84),
        ("stl", b"solid nothing\nendsolid nothing\n"),
        ("off", b"OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n"),
        ("obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        ("ply", (PLY_HEAD + PLY_FACES).format(format="ascii", v=1, f=0).encode() + b"0 0 0\n"),
        ("glb", glb(b'{"asset":{"version":"2.0"}}')),
        ("3mf", archive({"3D/3dmodel.model": MODEL % (b"", b"<resources/><build/>")})),
    ],
    ids=["stl", "stl_ascii", "off", "obj", "ply", "glb", "3mf"],
)
def test_a_file_without_faces_is_refused(kind, data):
    assert code(data, kind) == "no-faces"


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "obj", "ply", "ply_ascii", "off", "3mf", "glb"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_coordinates_that_are_not_finite_are_refused(kind, bad):
    vertices, faces = sphere(1)
    spoilt = vertices.copy()
    spoilt[7, 1] = bad
    data = as_bytes((vertices, faces), kind) if kind == "glb" else as_bytes((spoilt, faces), kind)
    if kind == "glb":
        where = data.index(np.float32(vertices[7]).tobytes())
        data = data[: where + 4] + np.float32(bad).tobytes() + data[where + 8 :]
    assert code(data, kind) == "non-finite-vertices"


def test_coordinates_beyond_doubles_are_refused():
    assert code(b"v 1e400 0 0\nv 0 0 0\nv 0 1 0\nf 1 2 3\n", "obj") == "non-finite-vertices"


@pytest.mark.parametrize("index", [-1, 3, 2**31 - 1])
def test_an_index_out_of_range_is_refused_in_ply(index):
    head = (PLY_HEAD + PLY_FACES).format(format="binary_little_endian", v=3, f=1).encode()
    data = head + np.eye(3, dtype="<f4").tobytes() + struct.pack("<Biii", 3, 0, 1, index)
    assert code(data, "ply") == "index-out-of-range"


@pytest.mark.parametrize("index", ["0", "4", "-4", "99999999999999"])
def test_an_index_out_of_range_is_refused_in_obj(index):
    assert code(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {index}\n".encode(), "obj") == "index-out-of-range"


def test_an_index_out_of_range_is_refused_in_off_3mf_and_glb():
    assert code(b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "off") == "index-out-of-range"
    data = as_bytes(cube(), "glb")
    faces = cube()[1].astype("<u4")
    spoilt = faces.copy()
    spoilt[3, 1] = 4_000_000_000
    assert code(data.replace(faces.tobytes(), spoilt.tobytes()), "glb") == "index-out-of-range"
    mesh = b'<mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/></vertices>'
    mesh += b'<triangles><triangle v1="0" v2="1" v3="3"/></triangles></mesh>'
    body = b'<resources><object id="1" type="model">%s</object></resources><build><item objectid="1"/></build>' % mesh
    assert code(archive({"3D/3dmodel.model": MODEL % (b"", body)}), "3mf") == "index-out-of-range"


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(("v", "f"), [(10**15, 1), (3, 10**15), (10**17, 10**17)])
def test_absurd_counts_of_a_ply_header_are_refused_before_anything_is_made(encoding, v, f):
    data = (PLY_HEAD + PLY_FACES).format(format=encoding, v=v, f=f).encode() + b"0 0 0\n" * 60
    assert code(data, "ply") == "truncated"


@pytest.mark.parametrize("counts", ["1000000000000 1 0", "3 1000000000000 0"])
def test_absurd_counts_of_an_off_header_are_refused(counts):
    assert code(f"OFF\n{counts}\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n".encode(), "off") == "truncated"


def test_a_broken_ply_header_is_refused():
    for line in ("element face", "property float", "property list uchar nothing x", "format binary", "nonsense here", "element face -3"):
        data = (PLY_HEAD.format(format="ascii", v=3) + line + "\nend_header\n").encode()
        assert code(data, "ply") == "not-a-mesh"
    assert code(b"ply\nformat ascii 1.0\nelement vertex 3\n", "ply") == "truncated"


def test_a_binary_stl_of_the_wrong_size_is_refused():
    data = as_bytes(cube(), "stl")
    assert code(data + b"\0", "stl") == "not-a-mesh"
    assert code(data[:80] + b"\xff\xff\xff\xff" + data[84:], "stl") == "truncated"


def zip_bomb() -> bytes:
    return archive({"3D/3dmodel.model": MODEL % (b"", b" " * (200 << 20))})


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path):
    bomb = zip_bomb()
    assert len(bomb) < 1 << 20
    assert code(bomb, "3mf") == "decompression-limit"
    with pytest.raises(MeshRejectedError) as caught:
        loaded(tmp_path, bomb, "3mf")
    assert caught.value.code == "decompression-limit"


def test_an_archive_beyond_the_unpacked_limit_is_refused():
    noise = np.random.default_rng(0).integers(0, 256, 3 << 20, dtype=np.uint8).tobytes()
    assert code(archive({"3D/3dmodel.model": MODEL % (b"", noise)}), "3mf", LoadLimits(unpacked_mib=2)) == "decompression-limit"


def test_an_archive_of_very_many_members_is_refused():
    assert code(archive({f"{i}": b"" for i in range(5000)}), "3mf") == "decompression-limit"


def test_an_archive_without_a_model_is_refused():
    assert code(archive({"holiday.jpg": b"\xff\xd8\xff"}), "3mf") == "not-a-mesh"


def test_an_xml_entity_bomb_is_refused():
    names = "abcdefgh"
    levels = [f'<!ENTITY {name} "{f"&{before};" * 10}">' for before, name in pairwise(names)]
    entities = f'<!DOCTYPE m [<!ENTITY a "0000000000">{"".join(levels)}]>'.encode()
    assert code(archive({"3D/3dmodel.model": MODEL % (entities, b"&h;")}), "3mf") == "forbidden-xml"
    wide = (MODEL % (entities, b"&h;")).decode().encode("utf-16")
    assert code(archive({"3D/3dmodel.model": wide}), "3mf") == "forbidden-xml"


def gltf(**changes) -> bytes:
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    }
    return json.dumps(tree | changes).encode()


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()


def test_a_small_glb_is_read():
    assert parsed(glb(gltf(), TRIANGLE), "glb").faces.tolist() == [[0, 1, 2]]


def test_an_accessor_without_bytes_that_asks_for_gigabytes_is_refused():
    huge = [{"componentType": 5126, "count": 1_000_000_000, "type": "VEC3"}]
    assert code(glb(gltf(accessors=huge), TRIANGLE), "glb") == "truncated"
    smaller = [{"componentType": 5126, "count": 3, "type": "VEC3"}]
    assert code(glb(gltf(accessors=smaller), TRIANGLE), "glb") == "truncated"


@pytest.mark.parametrize(
    "accessor",
    [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "byteOffset": 4},
    ],
)
def test_an_accessor_beyond_its_view_is_refused(accessor):
    assert code(glb(gltf(accessors=[accessor]), TRIANGLE), "glb") == "truncated"


@pytest.mark.parametrize(
    "accessor",
    [
        {"bufferView": 0, "componentType": 5126, "count": -3, "type": "VEC3"},
        {"bufferView": 7, "componentType": 5126, "count": 3, "type": "VEC3"},
        {"bufferView": 0, "componentType": 1, "count": 3, "type": "VEC3"},
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "BOX"},
        {"bufferView": 0, "componentType": 5126, "count": "3", "type": "VEC3"},
        [],
    ],
)
def test_an_accessor_that_is_none_is_refused(accessor):
    assert code(glb(gltf(accessors=[accessor]), TRIANGLE), "glb") == "parse-failed"


def test_views_and_buffers_beyond_the_file_are_refused():
    assert code(glb(gltf(bufferViews=[{"buffer": 0, "byteLength": 64}]), TRIANGLE), "glb") == "truncated"
    assert code(glb(gltf(buffers=[{"byteLength": 1 << 40}]), TRIANGLE), "glb") == "truncated"
    assert code(glb(gltf(), b""), "glb") == "truncated"


@pytest.mark.parametrize("uri", ["file:///etc/passwd", "../secret.bin", "http://127.0.0.1/x.bin"])
def test_a_buffer_in_another_file_is_refused(uri):
    assert code(glb(gltf(buffers=[{"byteLength": 36, "uri": uri}]), TRIANGLE), "glb") == "external-reference"


def test_required_extensions_that_change_the_shape_are_refused():
    assert code(glb(gltf(extensionsRequired=["KHR_draco_mesh_compression"]), TRIANGLE), "glb") == "unsupported-feature"
    sparse = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "sparse": {"count": 1}}
    assert code(glb(gltf(accessors=[sparse]), TRIANGLE), "glb") == "unsupported-feature"


@pytest.mark.parametrize("tree", [b"[]", b"{", b"[" * 100_000, b'{"meshes": 3}', b'{"meshes": [{}]}', b"\xff\xfe"])
def test_a_json_chunk_that_is_no_gltf_is_refused(tree):
    assert code(glb(tree, TRIANGLE), "glb") == "parse-failed"


def test_a_mesh_over_the_face_limit_is_too_large():
    for kind in FORMATS:
        with pytest.raises(TooLargeError) as caught:
            parsed(as_bytes(sphere(1), kind), kind, LoadLimits(max_faces=79))
        assert caught.value.where["limit"] == 79


def test_a_mesh_of_one_point_has_no_extent(tmp_path):
    with pytest.raises(MeshRejectedError) as caught:
        loaded(tmp_path, b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "obj")
    assert caught.value.code == "no-extent"


def test_faces_without_three_different_corners_are_no_faces(tmp_path):
    with pytest.raises(MeshRejectedError) as caught:
        loaded(tmp_path, b"v 0 0 0\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "obj")
    assert caught.value.code == "no-faces"


def test_faces_without_area_are_no_faces(tmp_path):
    with pytest.raises(MeshRejectedError) as caught:
        loaded(tmp_path, b"v 0 0 0\nv 1 1 1\nv 3 3 3\nf 1 2 3\n", "obj")
    assert caught.value.code == "no-faces"


@pytest.mark.parametrize(
    ("name", "expected"),
    [("empty.stl", "no-faces"), ("points_emptyface.ply", "no-faces"), ("not_a_zip.3mf", "not-a-mesh")],
)
def test_real_files_that_are_no_meshes_are_refused(name, expected):
    path = shared(name)
    assert code(path.read_bytes(), extension(path.suffix[1:])) == expected
