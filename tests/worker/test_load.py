"""The whole stage: every format, every real mesh, and whatever else arrives."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from geometry.topology import build_edges, signed_volume
from schemas.errors import SilhouetteError, TooLargeError
from schemas.mesh import PreprocessOptions
from tests.meshes import bumpy_sphere, cube, joined, knot, shared, sphere, torus
from tests.worker.loading.uploads import FORMATS, as_bytes, built, loaded, parsed
from worker.load import LoadedMesh, build, load_mesh


def volume(result: LoadedMesh) -> float:
    return signed_volume(result.positions, result.faces) * result.frame.scale**3


def check(result: LoadedMesh) -> None:
    """What every loaded mesh promises."""
    assert result.positions.dtype == np.float32 and result.faces.dtype == np.int32 and result.shading.normals.dtype == np.float32
    assert result.positions.flags.c_contiguous and result.faces.flags.c_contiguous
    assert np.isfinite(result.positions).all() and np.linalg.norm(result.positions.astype(float), axis=1).max() <= 1.0 + 1e-6
    assert result.faces.min() >= 0 and np.unique(result.faces).size == len(result.positions) == result.stats.vertices
    assert np.abs(np.linalg.norm(result.shading.normals, axis=1) - 1).max() < 1e-5
    assert len(result.faces) == result.stats.faces > 0
    assert (result.edges is not None) == result.stats.closed and (result.stats.closed or not result.clip.available)
    assert result.clip.available == (result.clip.reason is None)
    if result.edges is not None:
        assert len(result.edges.vertices) == result.stats.edges == len(result.faces) * 3 // 2
    if result.clip.available:
        assert volume(result) > 0


# ---------------------------------------------------------------- formats


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("mesh", [cube(2), torus(), bumpy_sphere(2), joined(sphere(1), sphere(1, centre=(3, 1, 0)))])
def test_every_format_gives_the_mesh_that_was_written(kind, mesh):
    result = build(parsed(as_bytes(mesh, kind), kind), PreprocessOptions())
    check(result)
    vertices, faces = mesh
    assert (result.stats.vertices, result.stats.faces) == (len(vertices), len(faces)) and result.clip.available
    assert volume(result) == pytest.approx(signed_volume(*mesh), rel=1e-5)
    np.testing.assert_allclose(result.stats.bounds, [vertices.min(axis=0), vertices.max(axis=0)], atol=2e-6)
    written = vertices[faces].mean(axis=1)
    read = result.frame.to_model(result.positions)[result.faces].mean(axis=1)
    order = [np.lexsort(np.round(x, 4).T) for x in (written, read)]
    np.testing.assert_allclose(written[order[0]], read[order[1]], atol=1e-4)


def test_the_extension_may_be_written_in_any_way(tmp_path):
    for name in ("ply", ".ply", "PLY", ".Ply"):
        assert loaded(tmp_path, as_bytes(cube(), "ply"), name).stats.faces == 12


def test_a_big_endian_ply_with_quads_and_extra_properties_is_read():
    head = (
        "ply\nformat binary_big_endian 1.0\ncomment made here\nelement vertex 8\nproperty double x\nproperty double y\n"
        "property double z\nproperty uchar quality\nelement face 6\nproperty list uchar int vertex_index\nend_header\n"
    )
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], ">f8")
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    rows = b"".join(p.tobytes() + b"\x07" for p in corners)
    data = head.encode() + rows + b"".join(b"\x04" + np.array(q, ">i4").tobytes() for q in quads)
    result = build(parsed(data, "ply"), PreprocessOptions())
    check(result)
    assert result.stats.faces == 12 and volume(result) == pytest.approx(1.0)


def test_triangle_strips_of_a_ply_are_decoded():
    head = (
        "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
        "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    data = head + "0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 2 0\n" + "9 0 1 2 3 -1 2 3 4 -1\n"
    assert parsed(data.encode(), "ply").faces.tolist() == [[0, 1, 2], [2, 1, 3], [2, 3, 4]]


def test_relative_indices_polygons_tabs_and_comments_of_obj_are_understood():
    first = "v\t0 0 0 # a comment\nv 1 0 0\n  v 1 1 0\r\nv 0 1 0\nf -4/1/1 -3//2 \\\n -2 -1\n"
    second = "v 0 0 1\nv 1 0 1\nv 0.5 1 1\nvt 0 0\ng x\ns off\nf -3 -2 -1"
    assert parsed((first + second).encode(), "obj").faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]


def test_a_binary_stl_that_calls_itself_solid_is_read():
    data = as_bytes(torus(), "stl")
    assert len(parsed(b"solid torus" + data[11:], "stl").faces) == len(torus()[1])


def test_several_solids_of_a_text_stl_are_one_mesh(tmp_path):
    data = as_bytes(cube(), "stl_ascii") + as_bytes(sphere(1, centre=(4, 0, 0)), "stl_ascii")
    assert loaded(tmp_path, data, "stl_ascii").stats.components == 2


@pytest.mark.parametrize("kind", ["glb", "3mf"])
def test_parts_of_a_scene_are_placed_by_their_transforms(kind, tmp_path):
    box = trimesh.Trimesh(*cube(), process=False)
    scene = trimesh.Scene()
    move = np.eye(4)
    move[:3, 3] = [10, 0, 0]
    mirror = np.diag([-2.0, 1, 1, 1])
    scene.add_geometry(box, transform=move)
    scene.add_geometry(box, transform=mirror if kind == "glb" else np.diag([2.0, 1, 1, 1]))
    result = loaded(tmp_path, scene.export(file_type=kind), kind)
    check(result)
    assert result.stats.components == 2 and volume(result) == pytest.approx(3.0, rel=1e-5)
    assert result.repairs["flipped_components"] == 0
    low = -2.0 if kind == "glb" else 0.0
    np.testing.assert_allclose(result.stats.bounds, [[low, 0, 0], [11, 1, 1]], atol=1e-5)


# ---------------------------------------------------------------- frames


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1.0, 1e9, 1e30])
@pytest.mark.parametrize("offset", [0.0, 1e4])
def test_size_and_place_do_not_matter(scale, offset):
    vertices, faces = bumpy_sphere(2)
    result = built(((vertices + offset) * scale, faces))
    check(result)
    assert result.stats.vertices == len(vertices) and result.clip.available
    assert volume(result) == pytest.approx(signed_volume(vertices, faces) * scale**3, rel=1e-5)


def test_a_mesh_far_from_the_origin_keeps_its_shape_to_float32():
    vertices, faces = sphere(3)
    far = vertices + np.array([3.0e6, -2.0e6, 1.0e6])
    result = built((far, faces))
    assert np.abs(result.frame.to_model(result.positions) - far).max() < 1e-7


def test_progress_rises_to_one(tmp_path):
    path = tmp_path / "upload"
    path.write_bytes(as_bytes(cube(), "ply"))
    seen: list[float] = []
    load_mesh(path, "ply", PreprocessOptions(), progress=seen.append)
    assert seen == sorted(seen) and seen[0] == 0.0 and seen[-1] == 1.0


def test_loading_twice_gives_the_same_bytes():
    one, two = built(knot()), built(knot())
    assert one.positions.tobytes() == two.positions.tobytes() and one.faces.tobytes() == two.faces.tobytes()


def test_the_report_is_plain_json(tmp_path):
    import json

    vertices, faces = sphere(3)
    result = built((vertices, np.delete(faces, 3, axis=0)))
    assert json.loads(json.dumps(result.repairs)) == result.repairs


# ---------------------------------------------------------------- whatever arrives

SMALL = {kind: as_bytes(sphere(0), kind) for kind in FORMATS}


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(FORMATS), st.data())
def test_spoilt_files_give_a_mesh_or_a_named_error(kind, data):
    raw = bytearray(SMALL[kind])
    if data.draw(st.booleans(), "cut"):
        raw = raw[: data.draw(st.integers(0, len(raw)), "length")]
    for _ in range(data.draw(st.integers(0, 5), "flips")):
        if raw:
            near = st.integers(0, min(len(raw), 300) - 1)
            raw[data.draw(st.one_of(near, st.integers(0, len(raw) - 1)), "at")] = data.draw(st.integers(0, 255), "byte")
    try:
        check(build(parsed(bytes(raw), kind), PreprocessOptions()))
    except SilhouetteError as error:
        assert error.code != "internal" and error.message.endswith(".")


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(FORMATS), st.binary(max_size=400), st.booleans())
def test_any_bytes_give_a_mesh_or_a_named_error(kind, noise, headed):
    raw = SMALL[kind][:120] + noise if headed else noise
    try:
        check(build(parsed(raw, kind), PreprocessOptions()))
    except SilhouetteError as error:
        assert error.code != "internal"


# ---------------------------------------------------------------- real meshes

CLEAN = {
    # name: faces, genus, components
    "bunny_closed.ply": (69664, 0, 1),
    "dragon_871k.ply": (871306, 55, 1),
    "dragon_400k.ply": (400000, 55, 1),
    "armadillo_86k.ply": (86482, 0, 1),
    "nefertiti_100k.ply": (99938, 0, 1),
    "fandisk.ply": (12946, 0, 1),
    "rocker_arm.ply": (20088, 1, 1),
    "knot_25k.ply": (25600, 1, 1),
    "elephant_40k.ply": (40022, 3, 1),
    "soccerball_58k.ply": (57600, 31, 1),
    "scorpion_100k.ply": (99990, 0, 1),
    "godzilla.ply": (38864, 2, 1),
    "helmet_1k.ply": (1000, 3, 1),
    "bones.ply": (4204, 0, 26),
    "horse_97k.ply": (96966, 0, 1),
    "3holes.off": (7200, 3, 1),
    "ADIS16480.STL": (7436, 24, 1),
    "plate_holes.STL": (1252, 5, 1),
    "thingi_1063852.stl": (68548, 1, 1),
    "trim-star.off": (10384, 1, 1),
    "fuze/fuze.obj": (1000, 0, 1),
    "spot_textured.glb": (5856, 0, 1),
    "Duck.glb": (4212, 0, 1),
    "cubevc.glb": (48, 0, 1),
    "knot_vertexcolor.ply": (25600, 1, 1),
    "cube_gears.3mf": (25668, 8, 17),
    "spot_vertexcolor.ply": (5856, 0, 1),
    "casting_insideout.off": (10224, 9, 1),
    "self_intersectA.obj": (17160, 0, 1),
}
SCENES = ("glb", "3mf")
LARGE = 4 << 20
COLORED = {"spot_textured.glb", "Duck.glb", "cubevc.glb", "knot_vertexcolor.ply", "spot_vertexcolor.ply"}


def real(name: str) -> LoadedMesh:
    """One that was read in the limited child where it is large, or a scene; what the child reads of others is what is read here."""
    path, options = shared(name), PreprocessOptions()
    kind = path.suffix.lower().lstrip(".")
    if path.stat().st_size > LARGE or kind in SCENES:
        result = load_mesh(path, kind, options)
    else:
        result = build(parsed(path.read_bytes(), kind), options)
    check(result)
    return result


@pytest.mark.heavy
@pytest.mark.parametrize("name", CLEAN)
def test_a_clean_real_mesh_is_clippable_and_as_described(name):
    faces, genus, components = CLEAN[name]
    result = real(name)
    assert result.clip.available
    assert (result.stats.faces, result.stats.components) == (faces, components)
    assert result.stats.vertices - result.stats.edges + result.stats.faces == 2 * components - 2 * genus
    assert (result.appearance is not None) == (name in COLORED)
    quiet = {"welded_vertices", "ignored_references", "dropped_collapsed_faces", "flipped_zero_area_faces"}
    touched = {k for k, v in result.repairs.items() if v} - quiet
    assert touched == ({"flipped_components"} if name == "casting_insideout.off" else set())


REPAIRED = {
    # name: faces, components, what was repaired
    "bun_zipper.ply": (69664, 1, {"closed_holes": 5, "closed_hole_edges": 223, "removed_unreferenced_vertices": 1113}),
    "hippo_tristrips.ply": (46204, 3, {"closed_holes": 1, "closed_hole_edges": 4}),
    "beast.obj": (64614, 1, {"split_edges": 2}),
    "conrod.stl": (6436, 1, {"split_edges": 3}),
    "cycloidal.ply": (43368, 115, {"split_edges": 242}),
    "dragon_res2_203k.ply": (200666, 28, {"split_edges": 2534, "removed_unreferenced_vertices": 43}),
}


@pytest.mark.heavy
@pytest.mark.parametrize("name", REPAIRED)
def test_a_broken_real_mesh_is_repaired_and_says_how(name):
    faces, components, repairs = REPAIRED[name]
    result = real(name)
    assert result.clip.available
    assert (result.stats.faces, result.stats.components) == (faces, components)
    assert {k: result.repairs[k] for k in repairs} == repairs


OPEN = {
    "many_small_holes.ply": (3524, 556),
    "ogre.obj": (124008, 200),
    "laurana_open_color.ply": (50000, 318),
    "Spider_ascii.stl": (1312, 72),
    "soup.stl": (100, 300),
}


@pytest.mark.heavy
@pytest.mark.parametrize("name", OPEN)
def test_an_open_real_mesh_is_kept_and_says_why_it_cannot_be_clipped(name):
    faces, boundary = OPEN[name]
    result = real(name)
    assert result.edges is None and not result.clip.available and not result.stats.closed
    assert result.stats.faces == faces
    assert f"{boundary} boundary edges" in result.clip.reason


@pytest.mark.heavy
def test_every_real_mesh_has_an_expectation():
    known = CLEAN.keys() | REPAIRED.keys() | OPEN.keys() | {"empty.stl", "points_emptyface.ply", "not_a_zip.3mf"}
    rows = shared("MANIFEST.tsv").read_text().splitlines()[1:]
    assert {row.split("\t")[0] for row in rows} == known


@pytest.mark.heavy
def test_the_edge_table_of_a_real_mesh_is_that_of_its_faces():
    result = real("plate_holes.STL")
    edges = build_edges(result.faces)
    np.testing.assert_array_equal(edges.faces, result.edges.faces)


def test_a_mesh_of_more_faces_than_its_options_allow_is_refused(tmp_path):
    data = as_bytes(sphere(1), "ply")
    assert loaded(tmp_path, data, "ply", max_faces=80).stats.faces == 80
    with pytest.raises(TooLargeError, match="79") as error:
        loaded(tmp_path, data, "ply", max_faces=79)
    assert error.value.where["limit"] == 79
