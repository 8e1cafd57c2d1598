"""The last look at the artifacts: what is right passes, and every kind of tampering is named."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.shading import shading_normals
from geometry.topology import build_edges
from schemas.errors import CancelledError, CorruptArtifactError
from tests.meshes import bumpy_sphere, cube, joined, knot, normalised, shared, sphere, torus
from worker.bake import bake_maps, hull_normals
from worker.hull import build_hull
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


@pytest.mark.heavy
def test_the_bunny_passes_in_seconds():
    import trimesh

    bunny = trimesh.load(shared("bunny_closed.ply"), process=False)
    report = verify_artifacts(*artifacts((np.asarray(bunny.vertices), np.asarray(bunny.faces, np.int32)), 1000, 1024), quiet)
    assert report["grazing_points"] == 0
