import numpy as np
import pytest

from geometry.topology import (
    NotManifoldError,
    build_edges,
    directed_edges,
    face_components,
    face_normals,
    signed_volume,
    vertex_normals,
)
from tests import meshes


@pytest.mark.parametrize("mesh", [meshes.cube(2), meshes.torus(), meshes.joined(meshes.sphere(1), meshes.cube())])
def test_every_edge_has_its_left_face_in_its_direction_and_its_right_face_against_it(mesh):
    _, faces = mesh
    table = build_edges(faces)
    half = {tuple(edge): face for face in range(len(faces)) for edge in directed_edges(faces[face : face + 1]).tolist()}
    assert len(table.vertices) * 2 == len(half)
    for (a, b), (left, right) in zip(table.vertices.tolist(), table.faces.tolist(), strict=True):
        assert half[a, b] == left
        assert half[b, a] == right
        assert a < b


def test_edges_are_sorted():
    table = build_edges(meshes.torus()[1])
    order = np.lexsort((table.vertices[:, 1], table.vertices[:, 0]))
    assert np.array_equal(order, np.arange(len(order)))


def test_an_open_mesh_has_no_edge_table_and_the_error_names_the_edge():
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1]], np.int32)
    with pytest.raises(NotManifoldError) as caught:
        build_edges(faces)
    assert {tuple(sorted(e)) for e in caught.value.edges.tolist()} == {(1, 2), (2, 3), (1, 3)}


def test_faces_of_one_direction_at_an_edge_are_refused():
    faces = meshes.cube()[1].copy()
    faces[0] = faces[0, ::-1]
    with pytest.raises(NotManifoldError):
        build_edges(faces)


def test_an_edge_of_four_faces_is_refused():
    _, a = meshes.cube()
    with pytest.raises(NotManifoldError):
        build_edges(np.concatenate([a, a]))


def test_components_are_counted_and_numbered_in_order():
    _, faces = meshes.joined(meshes.cube(), meshes.sphere(1), meshes.cube())
    labels, count = face_components(faces, int(faces.max()) + 1)
    assert count == 3
    assert np.array_equal(labels, np.repeat([0, 1, 2], [12, 80, 12]))


def test_volume_is_signed_and_does_not_depend_on_the_place():
    v, faces = meshes.cube(3)
    assert signed_volume(v, faces) == pytest.approx(1.0)
    assert signed_volume(v, faces[:, ::-1]) == pytest.approx(-1.0)
    assert signed_volume(v + 1e6, faces) == pytest.approx(1.0, rel=1e-6)
    assert signed_volume(v, faces[:0]) == 0.0


def test_normals_are_unit_and_outward():
    v, faces = meshes.sphere(3)
    middle = v[faces].mean(axis=1)
    normals = face_normals(v, faces)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert np.all(np.einsum("ij,ij->i", normals, middle) > 0.9)
    assert np.allclose(vertex_normals(v, faces), v, atol=0.02)


def test_the_corner_of_a_cube_has_its_diagonal_as_normal_however_it_is_cut_into_faces():
    v, faces = meshes.cube()
    assert np.allclose(vertex_normals(v, faces), (v - 0.5) * 2.0 / np.sqrt(3.0), atol=1e-6)


def test_faces_without_area_have_no_normal_and_do_not_break_those_of_vertices():
    v = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    faces = np.array([[0, 1, 2]], np.int32)
    assert not face_normals(v, faces).any()
    assert np.array_equal(vertex_normals(v, faces), np.tile([0, 0, 1], (3, 1)).astype(np.float32))
