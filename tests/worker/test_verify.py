"""The last look at the artifacts: what is right passes, and every kind of tampering is named."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.shading import shading_normals
from geometry.topology import build_edges
from schemas.errors import CancelledError, CorruptArtifactError
from tests import oracles
from tests.meshes import bumpy_sphere, cube, joined, knot, normalised, shared, sphere, torus
from worker.bake import bake_maps, hull_normals
from worker.enclosure import NotEnclosedError, enclosure_fault
from worker.hull import build_hull
from worker.kernels import bake_boxes, verify_enclosure
from worker.tree import build_tree
from worker.verify import verify_artifacts


def quiet(_):
    pass


def artifacts(mesh, hull_faces=120, texels=128):
    """(mesh, hull, maps, tree) tensors as the stages make them."""
    positions, faces, _ = normalised(mesh)
    edges, shading = build_edges(faces), shading_normals(positions, faces)
    hull = build_hull(positions, faces, hull_faces, quiet)
    outward = hull_normals(hull.positions, hull.faces)
    appearance = {"corner_color": np.full((len(faces), 3, 4), 99, np.uint8)}
    original = (positions, faces, shading.normals, appearance)
    rows = shading.tensors().get("corner_normals")
    maps = bake_maps(hull.positions, hull.faces, outward, *original, texels, quiet, corner_normals=rows)
    return (
        {"positions": positions, "faces": faces, **shading.tensors(), "edge_vertices": edges.vertices, "edge_faces": edges.faces},
        {"positions": hull.positions, "faces": hull.faces, "normals": outward},
        {"tile_uv": maps.tile_uv, "normal": maps.normal, "color": maps.color},
        build_tree(positions, faces, edges.vertices, edges.faces, quiet).tensors(),
    )


@pytest.fixture(scope="module")
def good():
    return artifacts(bumpy_sphere(3))


@pytest.fixture
def parts(good):
    """A copy to tamper with: mesh, hull, maps, tree."""
    return tuple({name: array.copy() for name, array in part.items()} for part in good)


def refused(parts, artifact, check):
    with pytest.raises(CorruptArtifactError) as caught:
        verify_artifacts(*parts, quiet)
    assert (caught.value.where["artifact"], caught.value.where["check"]) == (artifact, check), caught.value.message
    return caught.value


@pytest.mark.parametrize("mesh", [bumpy_sphere(3), torus(40, 20), cube(6), knot(80, 10), joined(sphere(2), sphere(2, centre=(1.2, 0, 0)))])
def test_what_the_stages_make_passes(mesh):
    report = verify_artifacts(*artifacts(mesh), quiet)
    assert set(report["checks"]) == {"mesh", "edges", "hull", "enclosure", "maps", "tree", "eyes"}
    assert report["volume_excess"] >= 0.0
    assert report["texels_facing_away"] < 0.2


def test_an_open_mesh_alone_passes(good):
    mesh = {name: good[0][name] for name in ("positions", "faces", "normals")} | {"faces": good[0]["faces"][:-5]}
    assert set(verify_artifacts(mesh, None, None, None, quiet)["checks"]) == {"mesh"}


def test_progress_ends_at_one_and_may_cancel(good):
    seen = []
    verify_artifacts(*good, seen.append)
    assert seen == sorted(seen) and seen[-1] == 1.0

    def cancel(_):
        raise CancelledError("the mesh was deleted")

    with pytest.raises(CancelledError):
        verify_artifacts(*good, cancel)


# ---- one tampering each


def test_a_position_that_is_not_finite_is_named(parts):
    parts[0]["positions"][7, 1] = np.nan
    assert refused(parts, "mesh", "finite").where["vertex"] == 7


def test_a_face_with_a_vertex_that_is_not_there_is_named(parts):
    parts[1]["faces"][5, 2] = len(parts[1]["positions"])
    assert refused(parts, "hull", "indices").where["face"] == 5


def test_a_mesh_outside_its_frame_is_named(parts):
    parts[0]["positions"] *= np.float32(1.1)
    refused(parts, "mesh", "frame")


def test_a_corner_with_the_normal_of_another_vertex_is_named():
    parts = artifacts(cube(3))
    rows = parts[0]["corner_normals"]
    rows[4, 1] = rows[5, 0] if parts[0]["faces"][5, 0] != parts[0]["faces"][4, 1] else rows[5, 2]
    assert refused(parts, "mesh", "shading").where["face"] == 4


def test_a_corner_with_a_normal_that_is_not_there_is_named():
    parts = artifacts(cube(3))
    parts[0]["corner_normals"][7, 2] = len(parts[0]["normals"])
    assert refused(parts, "mesh", "shading").where["face"] == 7


def test_a_normal_that_is_not_of_unit_length_is_named(parts):
    parts[1]["normals"][3] *= np.float32(0.9)
    assert refused(parts, "hull", "normals").where["vertex"] == 3


def test_an_edge_with_its_faces_swapped_is_named(parts):
    parts[0]["edge_faces"][11] = parts[0]["edge_faces"][11, ::-1].copy()
    refused(parts, "mesh", "edges")


def test_an_edge_stored_twice_is_named(parts):
    for name in ("edge_vertices", "edge_faces"):
        parts[0][name][4] = parts[0][name][9]
    refused(parts, "mesh", "edges")


def test_a_hole_in_the_hull_is_named(parts):
    parts[1]["faces"] = parts[1]["faces"][1:].copy()
    assert "edge" in refused(parts, "hull", "closed").where


def test_a_flipped_face_of_the_hull_is_named(parts):
    parts[1]["faces"][2] = parts[1]["faces"][2, ::-1].copy()
    refused(parts, "hull", "closed")


def test_a_face_of_the_hull_without_area_is_named(parts):
    faces = parts[1]["faces"]
    parts[1]["positions"][faces[0, 0]] = parts[1]["positions"][faces[0, 1]]
    refused(parts, "hull", "degenerate")


def test_a_hull_turned_inside_out_is_named(parts):
    parts[1]["faces"] = parts[1]["faces"][:, ::-1].copy()
    refused(parts, "hull", "volume")


def test_a_hull_smaller_than_the_original_is_named(parts):
    parts[1]["positions"] *= np.float32(0.9)
    refused(parts, "hull", "volume")


def test_a_moved_hull_is_named(parts):
    parts[1]["positions"] += np.float32([0.2, 0.0, 0.0])
    fault = refused(parts, "hull", "enclosure")
    assert fault.where["distance"] > 0.05
    assert len(fault.where["point"]) == 3


def test_one_hull_vertex_pulled_in_is_named(parts):
    parts[1]["positions"][0] *= np.float32(0.8)
    refused(parts, "hull", "enclosure")


def test_a_tile_in_another_place_is_named(parts):
    parts[2]["tile_uv"][10] = parts[2]["tile_uv"][11]
    assert refused(parts, "maps", "tiles").where["face"] == 10


def test_maps_of_another_hull_are_named(parts):
    parts[2]["tile_uv"] = parts[2]["tile_uv"][:-1].copy()
    refused(parts, "maps", "tiles")


def test_a_cut_map_is_named(parts):
    parts[2]["normal"] = parts[2]["normal"][:-12].copy()
    refused(parts, "maps", "tiles")


def test_a_colour_map_of_another_size_is_named(parts):
    parts[2]["color"] = parts[2]["color"][:-1].copy()
    refused(parts, "maps", "color")


def test_an_empty_texel_is_named(parts):
    u, v = parts[2]["tile_uv"][6].mean(axis=0)
    height, width = parts[2]["normal"].shape[:2]
    parts[2]["normal"][int(v * height), int(u * width)] = 0
    assert refused(parts, "maps", "normals").where == {"artifact": "maps", "check": "normals", "face": 6, "texels": 1}


def test_flipped_normals_are_named(parts):
    parts[2]["normal"] = 255 - parts[2]["normal"]
    refused(parts, "maps", "facing")


def test_a_skip_pointer_over_its_parents_end_is_named(parts):
    skip = parts[3]["skip"]
    child = next(i for i in range(1, len(skip)) if skip[i - 1] > i and skip[i - 1] < len(skip))
    skip[child] = skip[child - 1] + 1
    assert refused(parts, "tree", "preorder").where["node"] == child


def test_a_skip_pointer_backwards_is_named(parts):
    parts[3]["skip"][3] = 3
    assert refused(parts, "tree", "preorder").where["node"] == 3


def test_an_edge_in_two_nodes_is_named(parts):
    index = parts[3]["edge_index"]
    missing = index[1]
    index[1] = index[0]
    fault = refused(parts, "tree", "edge-lists")
    assert fault.where["edge"] == min(index[0], missing)


def test_edge_lists_out_of_order_are_named(parts):
    parts[3]["edge_start"][2] = parts[3]["edge_start"][-1] + 1
    refused(parts, "tree", "edge-lists")


def test_a_cone_that_is_not_finite_is_named(parts):
    parts[3]["front_anchor"][5, 0] = np.inf
    assert refused(parts, "tree", "cones").where["node"] == 5


def with_cones(tree):
    """The node with cones over the most edges."""
    cone = np.any(tree["scaled_normal"] != 0, axis=1) & (tree["separation"] < 1e38)
    edges = tree["edge_start"][tree["skip"]] - tree["edge_start"][:-1]
    return int(np.argmax(np.where(cone, edges, 0)))


def test_a_cone_that_is_too_wide_is_named(parts):
    node = with_cones(parts[3])
    parts[3]["scaled_normal"][node] *= np.float32(1.5)
    assert refused(parts, "tree", "cones").where["node"] == node


@pytest.mark.parametrize(("anchor", "sign"), [("front_anchor", -1), ("back_anchor", 1)])
def test_a_cone_anchored_too_near_is_named(parts, anchor, sign):
    node = with_cones(parts[3])
    s = parts[3]["scaled_normal"][node]
    parts[3][anchor][node] += np.float32(sign * 0.1) * s / np.linalg.norm(s)
    assert refused(parts, "tree", "cones").where["node"] == node


def test_a_separation_that_is_too_small_is_named(parts):
    node = with_cones(parts[3])
    parts[3]["separation"][node] *= np.float32(0.9)
    assert refused(parts, "tree", "cones").where["node"] == node


def test_a_cone_over_a_foreign_edge_is_named(parts):
    tree = parts[3]
    cone = np.flatnonzero(np.any(tree["scaled_normal"] != 0, axis=1))
    start = tree["edge_start"]
    first, last = (next(start[i] for i in order if start[i + 1] > start[i]) for order in (cone, cone[::-1]))
    tree["edge_index"][[first, last]] = tree["edge_index"][[last, first]]
    refused(parts, "tree", "cones")


# ---- enclosure and winding numbers


def boxed(mesh):
    positions, faces = np.asarray(mesh[0], np.float32), mesh[1]
    return positions, faces, *bake_boxes.build_boxes(positions, faces)


def solid_angle_winding(positions, faces, points):
    """Winding numbers as sums of signed solid angles (van Oosterom and Strackee)."""
    a, b, c = (positions[faces[:, k]].astype(np.float64)[None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
    dot = [np.einsum("pfi,pfi->pf", x, y) for x, y in ((a, b), (b, c), (c, a))]
    det = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    return np.rint(np.arctan2(det, la * lb * lc + dot[0] * lc + dot[1] * la + dot[2] * lb).sum(axis=1) / (2 * np.pi))


@pytest.mark.parametrize(
    "mesh",
    [
        torus(20, 10),
        knot(40, 8),
        joined(sphere(2), sphere(2, centre=(0.7, 0.1, 0))),
        joined(sphere(2), (sphere(1, 0.5)[0], sphere(1)[1][:, ::-1])),
    ],
)
def test_winding_numbers_are_the_sums_of_solid_angles(mesh):
    positions, faces, order, boxes = boxed(mesh)
    rng = np.random.default_rng(0)
    points = rng.uniform(positions.min(axis=0), positions.max(axis=0), (400, 3))
    winding, on = verify_enclosure.winding_numbers(positions, faces, order, boxes, points)
    assert np.array_equal(winding, solid_angle_winding(positions, faces, points))
    assert not on.any()


def test_winding_numbers_hold_where_rays_run_through_edges_and_vertices():
    positions, faces, order, boxes = boxed(cube(4))
    grid = np.stack(np.meshgrid(*[np.arange(-2, 11) / 8.0] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    winding, on = verify_enclosure.winding_numbers(positions, faces, order, boxes, grid)
    inside = np.all((grid > 0) & (grid < 1), axis=1)
    outside = np.any((grid < 0) | (grid > 1), axis=1)
    assert np.all(winding[inside] == 1)
    assert np.all(winding[outside] == 0)
    assert not on[inside | outside].any()
    caps = np.all((grid[:, :2] > 0) & (grid[:, :2] < 1), axis=1) & np.isin(grid[:, 2], [0, 1])
    assert on[caps].all()


def test_a_mesh_encloses_itself():
    for mesh in (cube(3), bumpy_sphere(3), knot(60, 8)):
        positions, faces, _ = normalised(mesh)
        assert enclosure_fault(positions, faces, positions, faces) == 0


def test_parts_that_go_through_each_other_are_enclosed_by_hulls_that_do_too():
    inner, outer = (joined(sphere(2, r), sphere(2, r, centre=(1.1, 0.2, 0))) for r in (1.0, 1.1))
    assert enclosure_fault(np.float32(inner[0]), inner[1], np.float32(outer[0]), outer[1]) == 0


def test_a_part_turned_inside_out_bounds_nothing_and_needs_no_hull():
    ball, hull = sphere(2), sphere(2, 1.1)
    far = sphere(1, 0.2, centre=(3, 0, 0))
    original = joined(ball, (far[0], far[1][:, ::-1]))
    assert enclosure_fault(np.float32(original[0]), original[1], np.float32(hull[0]), hull[1]) == 0
    with pytest.raises(NotEnclosedError):
        enclosure_fault(np.float32(joined(ball, far)[0]), joined(ball, far)[1], np.float32(hull[0]), hull[1])


@pytest.mark.parametrize("gap", [1e-6, 4e-7, 5e-5])
def test_a_sheet_turned_inside_out_close_above_the_surface_is_no_fault(gap):
    """As where a scan folds over: what lies above a real surface by less than any step bounds no interior of its own."""
    box, slab = cube(4), cube(2)
    fold = slab[0] * [0.5, 0.5, 4e-6] + [0.25, 0.25, 1.0 + gap]
    folded = joined(box, (fold, slab[1][:, ::-1]))
    assert enclosure_fault(np.float32(folded[0]), folded[1], np.float32(box[0]), box[1]) == 0
    solid = joined(box, (fold, slab[1]))
    with pytest.raises(NotEnclosedError):
        enclosure_fault(np.float32(solid[0]), solid[1], np.float32(box[0]), box[1])


def sliver_cube(height):
    """[0, 1]^3 whose top has a face of that height along its whole diagonal."""
    vertices, faces = cube(1)
    top = [f for f in range(len(faces)) if np.all(vertices[faces[f], 2] == 1.0)]
    one, other = faces[top[0]], faces[top[1]]
    k = next(k for k in range(3) if one[(k + 2) % 3] not in other)
    a, b, c, n = *np.roll(one, -k), len(vertices)
    point = [0.5, 0.5, 1.0] + height * np.sign(vertices[c] - [0.5, 0.5, 1.0])
    split = [[a, b, n], [n, b, c], [a, n, c]]
    return np.float32(np.vstack([vertices, point])), np.vstack([np.delete(faces, top[0], axis=0), split]).astype(np.int32)


@pytest.mark.parametrize("height", [0.0, 6e-8, 1e-3])
def test_slivers_and_faces_without_area_neither_refuse_a_hull_nor_hide_a_dent(height):
    positions, faces = sliver_cube(height)
    assert enclosure_fault(positions, faces, positions, faces) == 0
    for at in ([0.25, 0.25, 1.0], [0.5, 0.5, 1.0], [0.75, 0.625, 1.0], [0.625, 0.75, 1.0]):
        assert enclosure_fault(positions, faces, *dented_cube(np.array(at), 0.0)) == 0
        for depth in (0.3, 0.0101):
            with pytest.raises(NotEnclosedError):
                enclosure_fault(positions, faces, *dented_cube(np.array(at), depth))


def dented_cube(at, depth):
    """A cube a little larger than [0, 1]^3 whose vertex nearest to `at` is pushed to it by depth along z."""
    vertices, faces = cube(16)
    vertices = vertices * 1.02 - 0.01
    nearest = np.argmin(np.linalg.norm(vertices - at, axis=1))
    vertices[nearest, 2] -= depth
    return vertices.astype(np.float32), faces


def test_a_dent_into_a_large_face_is_found():
    positions, faces = np.float32(cube(1)[0]), cube(1)[1]
    at = np.array([0.75, 0.125, 1.0])  # away from the vertices and the middles of edges and faces
    assert enclosure_fault(positions, faces, *dented_cube(at, 0.0)) == 0
    with pytest.raises(NotEnclosedError, match="goes through the original"):
        enclosure_fault(positions, faces, *dented_cube(at, 0.3))


def test_a_dent_across_a_long_edge_is_found():
    positions, faces = np.float32(cube(1)[0]), cube(1)[1]
    at = np.array([0.25, 0.0, 1.0])
    with pytest.raises(NotEnclosedError, match="an edge of the original goes through"):
        enclosure_fault(positions, faces, *dented_cube(at, 0.3))


def test_hull_edges_through_slivers_of_parts_that_overlap_are_no_fault():
    """Where parts overlap, a hull edge of one goes through faces of the other deep inside; next to a sliver is not on it."""
    needle = np.array([[-2.0, 0, 0], [2.0, 1e-6, 0], [2.0, 0, 1e-6], [2.0, 0, 0]])
    needle = (needle, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32))
    box = (cube(1)[0] * 2.0 - 1.0, cube(1)[1])
    needle, box = (np.float32(needle[0]), needle[1]), (np.float32(box[0]), box[1])
    grown = (box[0] * np.float32(1.1), box[1])
    both, around = joined(box, needle), joined(grown, needle)
    assert enclosure_fault(np.float32(both[0]), both[1], np.float32(around[0]), around[1]) == 0


def test_a_hull_that_cuts_off_a_vertex_by_more_than_a_rounding_is_found():
    positions, faces, _ = normalised(cube(2))
    for scale, grazing in ((1.0 - 1e-7, True), (1.0 - 1e-5, False)):
        hull = (positions * np.float64(scale)).astype(np.float32)
        if grazing:
            assert enclosure_fault(positions, faces, hull, faces) > 0
        else:
            with pytest.raises(NotEnclosedError, match="a vertex"):
                enclosure_fault(positions, faces, hull, faces)


@pytest.mark.heavy
def test_the_bunny_passes_in_seconds():
    import trimesh

    bunny = trimesh.load(shared("bunny_closed.ply"), process=False)
    report = verify_artifacts(*artifacts((np.asarray(bunny.vertices), np.asarray(bunny.faces, np.int32)), 1000, 1024), quiet)
    assert report["grazing_points"] == 0


def strictly_crosses(p, q, a, b, c):
    """By rational arithmetic: the ends lie strictly on two sides of the triangle's plane, and the segment meets the triangle."""
    if oracles.orientation(a, b, c, (*p, 1)) * oracles.orientation(a, b, c, (*q, 1)) >= 0:
        return False
    turns = [oracles.orientation(p, q, s, (*e, 1)) for s, e in ((a, b), (b, c), (c, a))]
    return min(turns) >= 0 or max(turns) <= 0


@pytest.mark.parametrize("scale", [1.0, 1e-20, 1e15])
def test_crossings_are_those_of_rational_arithmetic_whatever_touches(scale):
    """On a coarse grid segments run through corners, sides and planes all the time, and many share a corner with a face."""
    rng = np.random.default_rng(12)
    positions = (rng.integers(0, 5, (40, 3)) * scale).astype(np.float32)
    faces = rng.integers(0, 40, (60, 3)).astype(np.int32)
    ends = rng.integers(0, 40, (50, 2))
    starts, stops = positions[ends[:, 0]], positions[ends[:, 1]] + np.float32(0.5 * scale) * rng.integers(0, 2, (50, 1)).astype(np.float32)
    order, boxes = bake_boxes.build_boxes(positions, faces)
    pairs = np.empty((3000, 2), np.int32)
    count = verify_enclosure.crossings(positions, faces, order, boxes, starts, stops, pairs)
    expected = {(n, f) for n in range(50) for f in range(60) if strictly_crosses(starts[n], stops[n], *positions[faces[f]])}
    assert {tuple(pair) for pair in pairs[:count].tolist()} == expected
    assert len(expected) > 20
