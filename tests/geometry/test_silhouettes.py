import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.silhouettes import face_planes, silhouette_edgewise, silhouette_scalar, silhouette_simd
from geometry.topology import build_edges
from tests import eye_cases, meshes, oracles

SHAPES = {
    "cube": meshes.cube(2),
    "torus": meshes.torus(9, 6),
    "bumpy sphere": meshes.bumpy_sphere(1),
    "two components": meshes.joined(meshes.sphere(1), meshes.sphere(0, 0.4, (0.3, 0.1, 0.0))),
}


def all_ways(positions, faces, eye):
    """The three brute forces as sets."""
    edges = build_edges(faces)
    planes = face_planes(positions, faces)
    table = (positions, faces, edges.vertices, edges.faces, eye)
    ways = silhouette_scalar(*table), silhouette_edgewise(planes, *table), silhouette_simd(planes, *table)
    return [oracles.edge_set(found) for found in ways]


@pytest.mark.parametrize("name", SHAPES)
def test_brute_force_is_the_rational_silhouette_for_awkward_eyes(name):
    positions, faces, _ = meshes.normalised(SHAPES[name])
    for label, eye in eye_cases.awkward(positions, faces).items():
        expected = oracles.silhouette(positions, faces, eye)
        assert all_ways(positions, faces, eye) == [expected] * 3, label


@settings(max_examples=40, deadline=None)
@given(eye_cases.strategy(), st.sampled_from(sorted(SHAPES)))
def test_brute_force_is_the_rational_silhouette(eye, name):
    positions, faces, _ = meshes.normalised(SHAPES[name])
    assert all_ways(positions, faces, eye) == [oracles.silhouette(positions, faces, eye)] * 3


def test_silhouette_edges_have_the_front_facing_side_on_the_left():
    positions, faces, _ = meshes.normalised(meshes.cube())
    eye = np.array([0.0, 0.0, 5.0, 1.0])
    found = positions[np.array(sorted(all_ways(positions, faces, eye)[0]))]
    middle, along = found.mean(axis=1), found[:, 1] - found[:, 0]
    assert len(found) == 4
    assert np.all(np.cross(middle, along)[:, 2] > 0.0)


def test_faces_too_thin_for_a_plane_are_decided_exactly():
    v, faces = meshes.bumpy_sphere(1)
    positions, faces, _ = meshes.normalised((v * (1.0, 1e-12, 1e-12), faces))
    planes = face_planes(positions, faces)
    assert np.any((planes.x == 0) & (planes.y == 0) & (planes.z == 0))
    for eye in meshes.eyes(6, orthographic=4):
        assert all_ways(positions, faces, eye) == [oracles.silhouette(positions, faces, eye)] * 3


@pytest.mark.parametrize("largest", [np.finfo(np.float32).max, 2.0**-140])
def test_positions_at_either_end_of_single_precision_have_the_rational_silhouette(largest):
    # a sphere with its poles cut off: oblique planes are farther from the centre than any coordinate
    v, faces = meshes.bumpy_sphere(1)
    positions = (np.clip(1.5 * v / np.abs(v).max(), -1.0, 1.0) * largest).astype(np.float32)
    assert np.isfinite(positions).all()
    for eye in meshes.eyes(6, orthographic=6):
        eye[:3] *= largest if eye[3] else 1.0
        assert all_ways(positions, faces, eye) == [oracles.silhouette(positions, faces, eye)] * 3


def test_an_eye_inside_a_convex_mesh_sees_no_silhouette():
    positions, faces, _ = meshes.normalised(meshes.sphere(2))
    assert all_ways(positions, faces, np.array([0.05, -0.02, 0.01, 1.0])) == [set()] * 3


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["bunny_closed.ply", "fandisk.ply"])
def test_all_brute_forces_agree_on_real_meshes(name):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.load(meshes.shared(name), process=False)
    positions, faces, _ = meshes.normalised((np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)))
    for eye in meshes.eyes(5, orthographic=3):
        first, *others = all_ways(positions, faces, eye)
        assert first
        assert others == [first] * 2
