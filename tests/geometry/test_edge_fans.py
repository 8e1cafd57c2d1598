import numpy as np
import pytest

from geometry.edge_fans import NO_EDGE, edge_fans, faces_about_vertices
from geometry.topology import build_edges, directed_edges
from tests import meshes

ANY = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4], [5, 6, 7], [6, 5, 8], [9, 9, 10]], np.int32)


@pytest.mark.parametrize("faces", [meshes.knot(20, 6)[1], ANY])
def test_every_half_edge_is_with_its_edge_once(faces):
    fans = edge_fans(faces)
    half = directed_edges(faces)
    assert sorted(fans.halves.tolist()) == np.flatnonzero(half[:, 0] != half[:, 1]).tolist()
    for e, (low, high) in enumerate(fans.vertices.tolist()):
        about = fans.halves[fans.starts[e] : fans.starts[e + 1]]
        assert len(about) and low < high
        assert {tuple(sorted(h)) for h in half[about].tolist()} == {(low, high)}
        assert (fans.of_half[about] == e).all()


def test_edges_of_a_closed_mesh_are_those_of_its_edge_table():
    faces = meshes.knot(20, 6)[1]
    fans = edge_fans(faces)
    assert np.array_equal(fans.vertices, build_edges(faces).vertices)
    assert (np.diff(fans.starts) == 2).all()


def test_edges_of_one_three_and_no_length_are_told_apart():
    fans = edge_fans(ANY)
    sizes = {tuple(v): n for v, n in zip(fans.vertices.tolist(), np.diff(fans.starts).tolist(), strict=True)}
    assert (sizes[0, 1], sizes[5, 6], sizes[1, 2], sizes[9, 10]) == (3, 2, 1, 2)
    assert fans.of_half[15] == NO_EDGE


def test_faces_about_a_vertex_are_those_that_have_it():
    faces = meshes.knot(20, 6)[1]
    starts, about = faces_about_vertices(faces, 125)
    assert len(starts) == 126
    for v in range(125):
        assert sorted(about[starts[v] : starts[v + 1]].tolist()) == np.flatnonzero((faces == v).any(axis=1)).tolist()
