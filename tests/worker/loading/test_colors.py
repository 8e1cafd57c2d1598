"""Colours reach the surface points they belong to, whatever the file calls them."""

from __future__ import annotations

import base64
import io
import zipfile

import numpy as np
import pytest
import trimesh
from PIL import Image

from schemas.artifacts import APPEARANCE
from schemas.mesh import PreprocessOptions
from tests.meshes import cube, shared, sphere
from tests.worker.loading.test_refusals import TRIANGLE, gltf
from tests.worker.loading.uploads import as_bytes, glb, loaded, parsed
from worker.load import build
from worker.loading.limits import LoadLimits
from worker.loading.parsed import Parsed

RNG = np.random.default_rng(0)


def sample(appearance, face, weights):
    """(4,) sRGB at a surface point, as the layout's comment defines it; nearest texel."""
    color = np.ones(4)
    if "corner_color" in appearance:
        color = color * (weights @ (appearance["corner_color"][face] / 255.0))
    if "texture" in appearance:
        texture = appearance["texture"]
        u, v = weights @ appearance["corner_uv"][face].astype(float)
        u, v = u - np.floor(u), v - np.floor(v)
        height, width = texture.shape[:2]
        color = color * texture[min(int((1 - v) * height), height - 1), min(int(u * width), width - 1)] / 255.0
    return color


def colored_points(appearance, positions, faces, count=50):
    """Surface points and their colours."""
    chosen = RNG.integers(0, len(faces), count)
    weights = RNG.dirichlet([2, 2, 2], count)
    points = np.einsum("ij,ijk->ik", weights, np.asarray(positions, float)[faces[chosen]])
    return points, np.array([sample(appearance, f, w) for f, w in zip(chosen, weights, strict=True)])


def exported(mesh_or_scene, kind: str) -> bytes:
    data = mesh_or_scene.export(file_type=kind)
    return data.encode() if isinstance(data, str) else bytes(data)


def check_layout(appearance, faces) -> None:
    for name, tensor in appearance.items():
        dtype, shape = APPEARANCE.tensors[name]
        assert tensor.dtype == np.dtype(dtype) and tensor.ndim == len(shape) and tensor.flags.c_contiguous
        assert name == "texture" or len(tensor) == len(faces)


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "off", "glb", "3mf"])
def test_a_mesh_without_colour_has_no_appearance(kind, tmp_path):
    assert loaded(tmp_path, as_bytes(cube(), kind), kind).appearance is None


@pytest.mark.parametrize("kind", ["ply", "obj", "glb"])
def test_vertex_colours_survive(kind, tmp_path):
    vertices, faces = sphere(2)
    colors = np.column_stack([np.rint((vertices + 1) * 127.5), np.full(len(vertices), 255)]).astype(np.uint8)
    mesh = trimesh.Trimesh(vertices, faces, vertex_colors=colors, process=False)
    result = loaded(tmp_path, exported(mesh, kind), kind)
    check_layout(result.appearance, result.faces)
    model = result.frame.to_model(result.positions)
    shown = result.appearance["corner_color"][..., :3] / 255.0
    expected = (model[result.faces] + 1) / 2
    if kind == "glb":  # glTF's vertex colours are linear
        expected = np.where(expected <= 0.0031308, expected * 12.92, 1.055 * np.maximum(expected, 1e-9) ** (1 / 2.4) - 0.055)
    assert np.abs(shown - expected).max() < (0.03 if kind == "glb" else 0.006)
    assert (result.appearance["corner_color"][..., 3] == 255).all()


def test_face_colours_survive_and_stay_with_their_faces(tmp_path):
    vertices, faces = cube()
    colors = RNG.integers(0, 256, (len(faces), 4), dtype=np.uint8)
    mesh = trimesh.Trimesh(vertices, faces[:, [0, 2, 1]], face_colors=colors, process=False)
    result = loaded(tmp_path, exported(mesh, "ply"), "ply")
    assert result.repairs["flipped_components"] == 1
    np.testing.assert_array_equal(result.appearance["corner_color"], np.repeat(colors[:, None], 3, axis=1))


def test_the_colour_of_a_polygon_is_that_of_its_triangles():
    head = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    head += "property list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    data = head + "0 0 0\n1 0 0\n2 1 0\n1 2 0\n0 1 0\n5 0 1 2 3 4 9 8 7\n"
    result = parsed(data.encode(), "ply")
    assert result.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4]]
    assert (result.appearance["corner_color"] == (9, 8, 7, 255)).all()


def test_corners_keep_their_colours_when_a_face_is_turned_round():
    vertices, faces = cube()
    color = RNG.integers(0, 256, (len(faces), 3, 4), dtype=np.uint8)
    parsed_mesh = Parsed(vertices, np.ascontiguousarray(faces[:, ::-1]), {"corner_color": color})
    result = build(parsed_mesh, PreprocessOptions())
    at = {(f, v): color[f, k] for f, row in enumerate(faces[:, ::-1].tolist()) for k, v in enumerate(row)}
    for f, row in enumerate(result.faces):
        for k, v in enumerate(row):
            np.testing.assert_array_equal(result.appearance["corner_color"][f, k], at[f, int(v)])


def textured(mesh, image: np.ndarray, uv: np.ndarray, offset=(0, 0, 0), factor=None):
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(image), baseColorFactor=factor)
    vertices, faces = mesh
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(vertices + np.array(offset), faces, visual=visual, process=False)


def ramp(width=64, height=32) -> np.ndarray:
    """Red grows to the right, green grows upwards."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    image = np.zeros((height, width, 3), np.uint8)
    image[..., 0] = np.rint((x + 0.5) / width * 255)
    image[..., 1] = np.rint((1 - (y + 0.5) / height) * 255)
    return image


def square(n=4):
    """A flat grid in the unit square, uv = xy."""
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    vertices = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return vertices, np.concatenate([np.column_stack([i, i + 1, i + n]), np.column_stack([i + 1, i + n + 1, i + n])])


def test_a_texture_lies_the_right_way_up():
    mesh = square()
    result = parsed(exported(textured(mesh, ramp(), mesh[0][:, :2]), "glb"), "glb")
    assert set(result.appearance) == {"corner_uv", "texture"}
    points, colors = colored_points(result.appearance, result.positions, result.faces)
    assert np.abs(colors[:, :2] - points[:, :2]).max() < 0.04
    assert (colors[:, 3] == 1).all()


def test_a_base_colour_tints_the_texture():
    mesh = square()
    result = parsed(exported(textured(mesh, ramp(), mesh[0][:, :2], factor=[255, 0, 255, 255]), "glb"), "glb")
    points, colors = colored_points(result.appearance, result.positions, result.faces)
    assert np.abs(colors[:, 0] - points[:, 0]).max() < 0.04 and np.abs(colors[:, 1]).max() == 0


def test_a_base_colour_tints_vertex_colours_as_light():
    """glTF's factor and vertex colours are linear; a quarter of a quarter is a sixteenth of the light."""
    vertices, faces = square()
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=[64, 64, 64, 255])
    mesh = trimesh.Trimesh(vertices, faces, visual=trimesh.visual.TextureVisuals(material=material), process=False)
    mesh.visual.vertex_attributes["color"] = np.full((len(vertices), 4), (64, 64, 64, 255), np.uint8)
    result = parsed(exported(mesh, "glb"), "glb")
    sixteenth = (64 / 255) ** 2
    assert np.abs(result.appearance["corner_color"][..., :3] - (1.055 * sixteenth ** (1 / 2.4) - 0.055) * 255).max() <= 1.0


def test_coordinates_outside_the_texture_repeat_it():
    vertices, faces = square()
    moved = parsed(exported(textured((vertices, faces), ramp(), vertices[:, :2] + [3, -2]), "glb"), "glb")
    assert moved.appearance["corner_uv"].min() >= 0.0 and moved.appearance["corner_uv"].max() <= 1.0 + 1e-5
    points, colors = colored_points(moved.appearance, moved.positions, moved.faces)
    assert np.abs(colors[:, :2] - points[:, :2]).max() < 0.04


def test_several_textures_and_untextured_parts_become_one():
    mesh = square()
    blue = np.full((16, 16, 3), (0, 0, 255), np.uint8)
    scene = trimesh.Scene(
        {
            "ramp": textured(mesh, ramp(), mesh[0][:, :2]),
            "blue": textured(mesh, blue, mesh[0][:, :2] * 5, offset=(2, 0, 0)),
            "plain": trimesh.Trimesh(mesh[0] + [4, 0, 0], mesh[1], process=False),
        }
    )
    result = parsed(exported(scene, "glb"), "glb")
    points, colors = colored_points(result.appearance, result.positions, result.faces, 300)
    part = np.floor(points[:, 0] / 2).astype(int)
    assert set(part) == {0, 1, 2}
    assert np.abs(colors[part == 0][:, :2] - points[part == 0][:, :2]).max() < 0.05
    np.testing.assert_allclose(colors[part == 1][:, :3], [[0, 0, 1]] * (part == 1).sum(), atol=1e-6)
    assert np.abs(colors[part == 2][:, :3] - 200 / 255).max() < 1e-6


def test_large_textures_are_scaled_down_together():
    mesh = square()
    scene = trimesh.Scene(
        [textured(mesh, ramp(500, 300), mesh[0][:, :2], offset=(2 * i, 0, 0), factor=[255, 255, 255 - i, 255]) for i in range(3)]
    )
    result = parsed(exported(scene, "glb"), "glb", LoadLimits(max_texture_px=256))
    assert max(result.appearance["texture"].shape) <= 256
    points, colors = colored_points(result.appearance, result.positions, result.faces, 200)
    assert np.abs(colors[:, 0] - points[:, 0] % 2).max() < 0.08
    one = parsed(exported(textured(mesh, ramp(500, 300), mesh[0][:, :2]), "glb"), "glb", LoadLimits(max_texture_px=100))
    assert one.appearance["texture"].shape == (60, 100, 4)


def test_a_broken_picture_is_left_out_and_noted():
    mesh = square()
    data = exported(textured(mesh, ramp(), mesh[0][:, :2]), "glb")
    at = data.index(b"IDAT")
    result = parsed(data[: at + 4] + b"\xff" * 60 + data[at + 64 :], "glb")
    assert "texture" not in result.appearance and result.notes["unreadable_textures"] == 1


@pytest.mark.parametrize("side", [12_000, 30_000])
def test_a_picture_bomb_is_left_out(side):
    out = io.BytesIO()
    Image.new("1", (side, side)).save(out, "PNG")
    image = {"images": [{"uri": "data:image/png;base64," + base64.b64encode(out.getvalue()).decode()}]}
    tree = gltf(
        **image,
        textures=[{"source": 0}],
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        accessors=[{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}] * 2,
        meshes=[{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
    )
    assert parsed(glb(tree, TRIANGLE), "glb").appearance == {}


def test_pictures_outside_the_file_are_noted_and_not_looked_for():
    tree = gltf(images=[{"uri": "../secret.png"}])
    assert "ignored_references" in parsed(glb(tree, TRIANGLE), "glb").notes


def test_a_material_library_outside_the_file_is_noted_and_not_looked_for(tmp_path):
    (tmp_path / "secret.mtl").write_text("newmtl a\nKd 1 0 0\n")
    data = b"mtllib secret.mtl\nusemtl a\n" + as_bytes(cube(), "obj")
    result = loaded(tmp_path, data, "obj")
    assert result.appearance is None and "ignored_references" in result.repairs


def test_patches_of_holes_take_the_colours_around_them():
    vertices, faces = sphere(3)
    color = np.zeros((len(faces) - 1, 3, 4), np.uint8)
    color[:] = (10, 20, 30, 255)
    result = build(Parsed(vertices, np.delete(faces, 5, axis=0), {"corner_color": color}), PreprocessOptions())
    assert result.repairs["closed_holes"] == 1
    assert (result.appearance["corner_color"] == (10, 20, 30, 255)).all()


def test_real_textured_meshes_keep_their_texture():
    for name, shape in (("spot_textured.glb", (1024, 1024, 4)), ("Duck.glb", (512, 512, 4))):
        result = parsed(shared(name).read_bytes(), "glb")
        assert result.appearance["texture"].shape == shape
    # the hooves of spot are dark, its nose is light: the texture is not upside down
    spot = parsed(shared("spot_textured.glb").read_bytes(), "glb")
    points, colors = colored_points(spot.appearance, spot.positions, spot.faces, 3000)
    low = points[:, 1] < points[:, 1].min() + 0.08 * np.ptp(points[:, 1])
    assert colors[low, :3].mean() < 0.45 < colors[~low, :3].mean()


QUADS = """4 2 0
0 0 0{0}
1 0 0{1}
1 1 0{2}
0 1 1{3}
4 0 1 2 3{4}
3 0 1 3{5}
"""


def off(head, *tails):
    return f"{head}\n{QUADS.format(*tails, *[''] * (6 - len(tails)))}".encode()


@pytest.mark.parametrize(
    ("head", "tails"),
    [
        ("COFF", (" 255 0 0 255", " 0 255 0 255", " 0 0 255 255", " 128 128 128 51")),
        ("COFF", (" 1 0 0 1", " 0 1 0 1.0", " 0 0 1 1", " 0.50196 0.50196 0.50196 0.2")),
        ("CNOFF", (" 0 0 1 255 0 0 255", " 0 0 1 0 255 0 255", " 0 0 1 0 0 255 255", " 0 0 1 128 128 128 51")),
        ("coff", (" 255 0 0 255 # red", " 0 255 0 255", " 0 0 255 255", " 128 128 128 51")),
    ],
)
def test_vertex_colours_of_an_off_file_are_read(head, tails):
    result = parsed(off(head, *tails), "off")
    bytes_of = np.array([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [128, 128, 128, 51]])
    np.testing.assert_array_equal(result.appearance["corner_color"], bytes_of[result.faces])
    assert result.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 3]]


def test_vertex_colours_without_alpha_are_opaque():
    result = parsed(off("COFF", " 9 0 0", " 9 0 0", " 9 0 0", " 9 0 0"), "off")
    assert (result.appearance["corner_color"] == (9, 0, 0, 255)).all()


def test_face_colours_of_an_off_file_stay_with_all_triangles_of_their_polygon():
    result = parsed(off("OFF", "", "", "", "", " 10 20 30"), "off")
    assert result.appearance["corner_color"][:, 0].tolist() == [[10, 20, 30, 255], [10, 20, 30, 255], [200, 200, 200, 255]]
    result = parsed(off("OFF", "", "", "", "", " 1.0 0.0 0.0 0.2", " 0.0 0.0 1.0"), "off")
    assert result.appearance["corner_color"][:, 2].tolist() == [[255, 0, 0, 51], [255, 0, 0, 51], [0, 0, 255, 255]]


@pytest.mark.parametrize(
    ("head", "tails"), [("OFF", ()), ("NOFF", (" 0 0 1",) * 4), ("OFF", ("", "", "", "", " 3")), ("OFF", (" 7 7 7",) * 4)]
)
def test_numbers_of_an_off_file_that_are_no_colours_are_not_taken_for_some(head, tails):
    assert parsed(off(head, *tails), "off").appearance == {}


CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
MATERIALS = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"
CORNERS = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)))


def threemf(resources, objects, encoding="utf-8"):
    """objects: (attributes, the four triangles' attributes) each."""
    corners = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
    text = (
        f'<?xml version="1.0" encoding="{encoding}"?><model unit="millimeter" xmlns="{CORE}" xmlns:m="{MATERIALS}"><resources>{resources}'
    )
    for number, (attributes, picks) in enumerate(objects, start=100):
        triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}" {pick}/>' for (a, b, c), pick in zip(corners, picks, strict=True))
        text += f'<object id="{number}" type="model" {attributes}><mesh><vertices>{CORNERS}</vertices><triangles>{triangles}</triangles>'
        text += "</mesh></object>"
    items = "".join(f'<item objectid="{100 + i}" transform="1 0 0 0 1 0 0 0 1 {3 * i} 0 0"/>' for i in range(len(objects)))
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", f"{text}</resources><build>{items}</build></model>".encode(encoding))
    return out.getvalue()


PAINTS = '<basematerials id="1"><base name="a" displaycolor="#FF8000"/><base name="b" displaycolor="#0000FF80"/></basematerials>'
GROUP = '<m:colorgroup id="2"><m:color color="#FF0000"/><m:color color="#00FF00FF"/><m:color color="#0000FF"/></m:colorgroup>'
RED, GREEN, BLUE, GREY = [255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [200, 200, 200, 255]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_colours_of_a_3mf_file_are_read_for_each_corner(encoding):
    picks = ('pid="2" p1="0" p2="1" p3="2"', 'pid="2" p1="1"', "", 'p1="1"')
    result = parsed(threemf(PAINTS + GROUP, [('pid="1" pindex="0"', picks)], encoding), "3mf")
    orange, glass = [255, 128, 0, 255], [0, 0, 255, 128]
    assert result.appearance["corner_color"].tolist() == [[RED, GREEN, BLUE], [GREEN] * 3, [orange] * 3, [glass] * 3]


def test_every_object_of_a_3mf_file_has_its_own_colours():
    plain, red, blue = [""] * 4, ['pid="2" p1="0"'] * 4, [""] * 4
    result = parsed(threemf(GROUP, [("", plain), ("", red), ('pid="2" pindex="2"', blue)]), "3mf")
    side = result.positions[result.faces][:, :, 0].mean(axis=1) // 3
    for number, color in enumerate((GREY, RED, BLUE)):
        assert (result.appearance["corner_color"][side == number] == color).all()
        assert (side == number).sum() == 4


@pytest.mark.parametrize("pick", ['pid="2" p1="3"', 'pid="9" p1="0"', 'pid="2" p1="-1"', 'pid="2" p1="x"', 'pid="2" p1="99999999999"'])
def test_colours_of_a_3mf_file_that_are_not_there_are_none(pick):
    assert parsed(threemf(GROUP, [("", [pick] * 4)]), "3mf").appearance == {}
    mixed = parsed(threemf(GROUP, [("", [pick, 'pid="2" p1="0"', pick, pick])]), "3mf").appearance["corner_color"]
    assert mixed[:, 0].tolist() == [GREY, RED, GREY, GREY]


@pytest.mark.parametrize("text", ["red", "#12345", "#GG0000", ""])
def test_colour_of_a_3mf_file_that_is_none_is_grey(text):
    group = f'<m:colorgroup id="2"><m:color color="{text}"/></m:colorgroup>'
    result = parsed(threemf(group, [('pid="2" pindex="0"', [""] * 4)]), "3mf")
    assert (result.appearance["corner_color"] == GREY).all()
