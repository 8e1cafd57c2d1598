"""Shading normals: smooth where the surface is, separate along creases."""

import numpy as np
import pytest

from geometry.shading import shading_normals
from geometry.topology import face_normals, vertex_normals
from tests.meshes import bumpy_sphere, cube, joined, knot, sphere, torus


@pytest.mark.parametrize("mesh", [sphere(3), torus(), knot(), bumpy_sphere(4, 0.05)], ids=["sphere", "torus", "knot", "bumpy"])
def test_smooth_mesh_has_one_normal_a_vertex_under_its_own_number(mesh):
    positions, faces = mesh
    made = shading_normals(positions, faces)
    assert not made.creased
    assert np.array_equal(made.corner_normals, faces)
    assert np.array_equal(made.normal_vertices, np.arange(len(positions)))
    assert np.allclose(made.normals, vertex_normals(positions, faces), atol=1e-6)
    assert set(made.tensors()) == {"normals"}


@pytest.mark.parametrize("per_side", [1, 4])
def test_cube_is_shaded_flat(per_side):
    positions, faces = cube(per_side)
    made = shading_normals(positions, faces)
    assert made.creased
    across = face_normals(positions, faces)
    assert np.allclose(made.normals[made.corner_normals], across[:, None, :], atol=1e-6)
    assert len(made.normals) == 6 * (per_side + 1) ** 2


def test_every_corner_has_a_normal_of_its_own_vertex():
    positions, faces = joined(cube(3), sphere(1), torus(8, 5))
    made = shading_normals(positions, faces)
    assert np.array_equal(made.normal_vertices[made.corner_normals], faces)
    assert np.all(np.diff(made.normal_vertices) >= 0)
    assert np.allclose(np.linalg.norm(made.normals, axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize(("angle", "creased"), [(np.radians(44), True), (np.radians(46), False)])
def test_crease_angle_decides(angle, creased):
    t = np.arange(8) * np.pi / 4
    ring = np.column_stack([np.cos(t), np.sin(t)])
    positions = np.concatenate([np.column_stack([ring, np.full(8, z)]) for z in (0.0, 1.0)])
    i, j = np.arange(8), (np.arange(8) + 1) % 8
    faces = np.concatenate([np.column_stack([i, j, j + 8]), np.column_stack([i, j + 8, i + 8])]).astype(np.int32)
    assert shading_normals(positions, faces, angle).creased is creased


def test_faces_without_area_and_edges_of_three_faces_are_survived():
    positions = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [1, 0, 5]], np.int32)
    made = shading_normals(positions, faces)
    assert np.isfinite(made.normals).all()
    assert np.allclose(np.linalg.norm(made.normals, axis=1), 1.0)


def test_order_of_faces_does_not_change_a_corners_normal():
    positions, faces = joined(cube(2), bumpy_sphere(2, 0.6))
    order = np.random.default_rng(1).permutation(len(faces))
    first, second = shading_normals(positions, faces), shading_normals(positions, faces[order])
    assert np.allclose(first.normals[first.corner_normals][order], second.normals[second.corner_normals], atol=1e-6)
