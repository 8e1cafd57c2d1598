"""A mesh in the shape that its placement gives it, and what is drawn of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.topology import signed_volume
from schemas.scene import matrix_of
from service.assets import MeshAsset
from service.scene.place import place
from service.scene.stretch import KEPT, in_shape
from tests import meshes
from tests.service.render.made import clippable, without_hull
from tests.service.scene.lined import CAMERAS, asked, differing, drawn, planned, shape
from tests.service.scene.test_place import matrices

STRETCHES = {
    "flat": {"scale": [1.2, 1.0, 0.3], "rotate": {"axis": [1, 1, 0], "angle_deg": 60}},
    "mirrored": {"scale": [-1.4, 0.5, 1.0], "rotate": {"axis": [0, 1, 1], "angle_deg": 35}},
    "sheared": [[0.7, 0.5, 0.0, -0.2], [0.0, -1.0, 0.3, 0.1], [0.4, 0.0, 0.7, 0.0], [0.0, 0.0, 0.0, 1.0]],
}
LINES = {
    "edge mesh": {"method": "edge_mesh", "ridge": {"color": "#b03020"}, "valley": {"color": "#2050b0"}, "ridge_deg": 40, "valley_deg": 40},
    "wireframe": {"method": "wireframe", "ridge": {"color": "#b03020"}, "valley": {"color": "#2050b0"}, "ridge_deg": 40, "valley_deg": 40},
    "translated": {"method": "translated", "pull": {"by": "offset", "amount": 8}},
    "charcoal": {"method": "fattened", "charcoal": True},
    "fattened": {"method": "fattened", "silhouette": {"width": 5}, "ridge": {}, "ridge_deg": 40},
}


def in_place(name: str, transform, suffix: str) -> MeshAsset:
    """The same mesh with vertices where the transform takes them."""
    matrix = matrix_of(asked([(name, transform)]).objects[0].transform)
    asset = shape(name)
    vertices = asset.frame.to_model(asset.positions) @ matrix[:3, :3].T + matrix[:3, 3]
    faces = asset.faces[:, [0, 2, 1]] if np.linalg.det(matrix[:3, :3]) < 0 else asset.faces
    made = without_hull(f"{name} {suffix}", (vertices, np.ascontiguousarray(faces)))
    normals = asset.normals.astype(np.float64) @ np.linalg.inv(matrix[:3, :3])
    return replace(made, normals=(normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32))


@given(matrices)
@settings(max_examples=60, deadline=None)
def test_points_and_normals_of_a_stretched_mesh_are_where_the_placement_has_them(matrix):
    if np.linalg.cond(matrix[:3, :3]) > 1e4:
        return
    asset = clippable("bumpy")
    placement = place(asset, matrix, "")
    stretched, rest = in_shape(asset, placement)
    assert np.allclose(rest.points(stretched.positions, rest.frame), placement.points(asset.positions, placement.frame), atol=1e-6)
    assert np.allclose(rest.linear @ rest.linear.T, np.eye(3), atol=1e-9)
    assert rest.mirrored == placement.mirrored
    assert np.linalg.norm(stretched.positions, axis=1).max() <= 1.0 + 1e-6
    assert signed_volume(stretched.positions, stretched.faces) > 0.0
    expected = asset.normals.astype(np.float64) @ np.linalg.inv(placement.linear)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.allclose(stretched.normals @ rest.linear.T, expected, atol=1e-6)


@pytest.mark.parametrize("linear", [np.eye(3), 4.0 * np.eye(3), -0.2 * np.eye(3), 3.0 * np.eye(3)[[1, 0, 2]]])
def test_what_is_turned_or_mirrored_or_scaled_stays_itself(linear):
    matrix = np.eye(4)
    matrix[:3, :3] = linear
    asset = shape("ring")
    placement = place(asset, matrix, "")
    assert in_shape(asset, placement) == (asset, placement)


def test_the_latest_shapes_of_a_mesh_are_kept_with_it_and_counted():
    asset = without_hull("often stretched", meshes.torus(12, 6))
    bare = asset.nbytes
    placements = [place(asset, np.diag([1.0, 1.0, 0.5 - 0.05 * k, 1.0]), "") for k in range(KEPT + 2)]
    made = [in_shape(asset, placement)[0] for placement in placements]
    assert len({one.id for one in made}) == KEPT + 2
    assert len(asset.stretched) == KEPT
    assert asset.nbytes == bare + KEPT * (asset.positions.nbytes + asset.normals.nbytes)
    assert in_shape(asset, placements[-1])[0] is made[-1]
    assert in_shape(asset, placements[0])[0] is not made[0]


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("transform", STRETCHES.values(), ids=STRETCHES)
@pytest.mark.parametrize("name", LINES)
def test_a_stretched_object_is_drawn_as_a_mesh_of_that_shape(gpu, name, transform, camera):
    """Ridges, what is seen edge-on, and what faces gain by being fatter are those of the scene; beside it another object."""
    other = ("ball", {"translate": [0.8, 0.6, -1.5], "scale": 0.5})
    more = {"lines": LINES[name], "camera": CAMERAS[camera], "shading": {"color": "#d0c0a0"}}
    placed = drawn(gpu, [("corner", transform), other], **more).pixels
    made = drawn(gpu, [("corner", {}), other], [in_place("corner", transform, f"of {transform}"), shape("ball")], **more).pixels
    assert (placed != placed[0, 0]).any(axis=2).mean() > 0.05
    assert differing(placed, made, 24) < 0.01


def test_ridges_are_those_of_the_stretched_shape():
    """The edges of a box stay at right angles along its axes, and are sheared to others otherwise."""
    plan = planned([("box", {"scale": [1, 1, 0.2]}), ("box", STRETCHES["sheared"])], lines={"ridge": {}})
    for part in plan.layers[0].parts:
        turns = {round(float(np.degrees(np.arccos(cosine)))) for cosine in part.asset.line_surface.features.turn}
        assert (turns == {0, 90}) == (part.index == 0)


def test_pictures_without_lines_are_drawn_from_the_mesh_itself():
    plan = planned([("box", {"scale": [1, 1, 0.2]})])
    assert plan.layers[0].parts[0].asset is shape("box")


@settings(max_examples=20, deadline=None)
@given(st.floats(-6.0, 6.0))
def test_a_mesh_flattened_a_million_times_keeps_its_faces_where_they_are(exponent):
    asset = shape("ring")
    placement = place(asset, np.diag([1.0, 10.0**exponent, 1.0, 1.0]), "")
    stretched, rest = in_shape(asset, placement)
    where, there = rest.points(stretched.positions, rest.frame), placement.points(asset.positions, placement.frame)
    assert np.allclose(where, there, rtol=2e-7, atol=1e-13)
