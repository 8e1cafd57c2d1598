"""The downloadable files, read back."""

from __future__ import annotations

import io
import json
import struct
from dataclasses import dataclass

import numpy as np
import pytest
import trimesh
from PIL import Image

from geometry.topology import vertex_normals
from schemas.conventions import Frame
from tests.meshes import bumpy_sphere, normalised
from tests.worker.test_bake import convex_hull, degrees_between, lookup, quiet, weights_inside, weights_on_border
from worker.bake import Maps, bake_maps
from worker.downloads import color_png, hull_glb, normal_png


@dataclass(frozen=True)
class Hull:
    positions: np.ndarray
    faces: np.ndarray


def made(color: bool) -> tuple[Hull, Maps]:
    positions, faces, _ = normalised(bumpy_sphere(4))
    h = convex_hull(positions, 1.01)
    appearance = {"corner_color": np.full((len(faces), 3, 4), (200, 100, 50, 255), np.uint8)} if color else None
    maps = bake_maps(*h, positions, faces, vertex_normals(positions, faces), appearance, 256, quiet)
    return Hull(h[0], h[1]), maps


@pytest.fixture(scope="module")
def plain():
    return made(color=False)


@pytest.fixture(scope="module")
def coloured():
    return made(color=True)


FRAME = Frame((1e6, -20.0, 0.5), 3.0)


def parsed(data: bytes):
    """(JSON document, {attribute: values}, {image name: pixels}) of a GLB with one primitive."""
    magic, version, total = struct.unpack_from("<4sII", data)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON" and size % 4 == 0
    document = json.loads(data[20 : 20 + size])
    data_size, kind = struct.unpack_from("<I4s", data, 20 + size)
    assert kind == b"BIN\0" and 28 + size + data_size == total
    buffer = data[28 + size :]

    def view(i):
        v = document["bufferViews"][i]
        return buffer[v["byteOffset"] : v["byteOffset"] + v["byteLength"]]

    values = {}
    for name, i in document["meshes"][0]["primitives"][0]["attributes"].items():
        a = document["accessors"][i]
        values[name] = np.frombuffer(view(a["bufferView"]), "<f4").reshape(a["count"], int(a["type"][3]))
    images = {i["name"]: np.asarray(Image.open(io.BytesIO(view(i["bufferView"])))) for i in document["images"]}
    return document, values, images


def test_glb_opens_with_the_hull_in_model_units(coloured):
    hull, maps = coloured
    scene = trimesh.load(io.BytesIO(hull_glb(hull, maps, FRAME)), file_type="glb")
    mesh = scene.to_mesh()
    expected = FRAME.to_model(hull.positions)[hull.faces].reshape(-1, 3)
    assert mesh.faces.shape == hull.faces.shape
    assert np.allclose(mesh.vertices[mesh.faces].reshape(-1, 3), expected, rtol=0, atol=1e-9 * 1e6)
    (geometry,) = scene.geometry.values()
    material = geometry.visual.material
    assert material.normalTexture.size == maps.normal.shape[1::-1]
    assert np.array_equal(np.asarray(material.baseColorTexture), maps.color)
    # trimesh turns v upwards
    assert np.allclose(geometry.visual.uv * [1, -1] + [0, 1], maps.tile_uv.reshape(-1, 2), atol=1e-6)


def test_object_normals_come_back_from_the_tangent_map(plain):
    hull, maps = plain
    _, values, images = parsed(hull_glb(hull, maps, FRAME))
    count = 3000
    face = np.random.default_rng(0).integers(0, len(hull.faces), count)
    weights = np.concatenate([weights_inside(count // 2), weights_on_border(count // 2)])
    seen = lookup(images["normal"], maps.tile_uv, face, weights) / 127.5 - 1.0
    normal, tangent = values["NORMAL"][3 * face].astype(float), values["TANGENT"][3 * face].astype(float)
    bitangent = np.cross(normal, tangent[:, :3]) * tangent[:, 3:]
    turned = seen[:, :1] * tangent[:, :3] + seen[:, 1:2] * bitangent + seen[:, 2:] * normal
    expected = lookup(maps.normal, maps.tile_uv, face, weights) / 127.5 - 1.0
    assert degrees_between(turned, expected).max() < 1.5


def test_tangent_frames_are_orthonormal_and_face_up_the_picture(plain):
    hull, maps = plain
    _, values, _ = parsed(hull_glb(hull, maps, FRAME))
    normal, tangent = values["NORMAL"].astype(float), values["TANGENT"].astype(float)
    assert np.allclose(np.linalg.norm(tangent[:, :3], axis=1), 1.0, atol=1e-6)
    assert np.allclose(np.einsum("ni,ni->n", normal, tangent[:, :3]), 0.0, atol=1e-5)
    assert set(np.unique(tangent[:, 3])) <= {-1.0, 1.0}
    p, uv = values["POSITION"].reshape(-1, 3, 3).astype(float), values["TEXCOORD_0"].reshape(-1, 3, 2).astype(float)
    bitangent = (np.cross(normal, tangent[:, :3]) * tangent[:, 3:])[::3]
    for k in (1, 2):
        step = np.einsum("fi,fi->f", p[:, k] - p[:, 0], bitangent)
        # moving by d in the plane changes v by d . grad v, with grad v against the bitangent where u does not change
        only_v = np.isclose(uv[:, k, 0], uv[:, 0, 0], atol=1e-7)
        assert np.all(step[only_v] * (uv[:, k, 1] - uv[:, 0, 1])[only_v] < 0.0)


def test_glb_keeps_the_rules_of_the_format(coloured):
    hull, maps = coloured
    document, values, images = parsed(hull_glb(hull, maps, FRAME))
    position = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    assert position["min"] == values["POSITION"].min(axis=0).tolist()
    assert all(v["byteOffset"] % 4 == 0 for v in document["bufferViews"])
    assert document["samplers"][0]["minFilter"] == 9729  # no mipmaps: they would mix tiles
    assert document["materials"][0]["alphaMode"] == "OPAQUE"
    assert images["color"].shape[2] == 4 and images["normal"].shape[2] == 3


def test_a_translucent_hull_is_blended(coloured):
    hull, maps = coloured
    clear = maps.color.copy()
    clear[..., 3] //= 2
    document, _, _ = parsed(hull_glb(hull, Maps(maps.tile_uv, maps.normal, clear, 0, 1, maps.tile_side), FRAME))
    assert document["materials"][0]["alphaMode"] == "BLEND"


def test_png_files_hold_the_maps(coloured, plain):
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(normal_png(coloured[1])))), coloured[1].normal)
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(color_png(coloured[1])))), coloured[1].color)
    with pytest.raises(ValueError, match="no colour"):
        color_png(plain[1])
