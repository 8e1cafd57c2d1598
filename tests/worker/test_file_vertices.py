"""Which vertex of a file each vertex of the loaded mesh is."""

import numpy as np
import pytest

from schemas.conventions import Frame
from schemas.mesh import PreprocessOptions
from tests import meshes
from worker.load import _file_vertices, build
from worker.loading.parsed import Parsed
from worker.loading.surface import Surface


def loaded(vertices, faces):
    return build(Parsed(np.asarray(vertices, np.float64), np.asarray(faces, np.int32), {}), PreprocessOptions())


def soup(mesh):
    """As an STL has it: three vertices a face."""
    vertices, faces = mesh
    return vertices[faces].reshape(-1, 3), np.arange(faces.size, dtype=np.int32).reshape(-1, 3)


def shuffled(mesh):
    """With its vertices in another order, and some that no face has."""
    vertices, faces = mesh
    order = np.random.default_rng(0).permutation(len(vertices))
    place = np.argsort(order)
    return np.concatenate([[[9.0, 9.0, 9.0]], vertices[order]]), place[faces] + 1


SHAPES = {
    "sphere": lambda: meshes.sphere(2),
    "shuffled": lambda: shuffled(meshes.bumpy_sphere(2, 0.4)),
    "soup": lambda: soup(meshes.torus(12, 8)),
    "with a hole": lambda: (meshes.cube(3)[0], meshes.cube(3)[1][2:]),
    "inside out": lambda: (meshes.sphere(2)[0], meshes.sphere(2)[1][:, ::-1]),
    "corner to corner": lambda: meshes.blocks((0, 0, 0), (1, 1, 0)),
    "open": lambda: meshes.sheet(5),
}


@pytest.mark.parametrize("name", SHAPES)
def test_every_vertex_is_one_of_the_file_at_its_place(name):
    vertices, faces = SHAPES[name]()
    mesh = loaded(vertices, faces)
    assert mesh.file_vertices.shape == (len(mesh.positions),) and mesh.file_vertices.dtype == np.int32
    assert (mesh.file_vertices >= 0).all()
    placed = mesh.frame.to_normalised(vertices).astype(np.float32)
    assert np.array_equal(placed[mesh.file_vertices], mesh.positions)


def test_bodies_that_are_cut_apart_where_they_touch_keep_their_own_vertices():
    vertices, faces = soup(meshes.blocks((0, 0, 0), (1, 1, 0)))
    mesh = loaded(vertices, faces)
    middles = vertices[faces].mean(axis=1)
    side = (middles[:, :2].sum(axis=1) > 2.0)[mesh.file_vertices // 3]
    for face in mesh.faces:
        assert len(set(side[face].tolist())) == 1, "all corners of a face are of one body"


def test_a_vertex_that_repair_makes_has_no_number():
    vertices, faces = meshes.sphere(1)
    frame = Frame.around(vertices)
    placed = frame.to_normalised(vertices).astype(np.float32)
    middle = (placed[faces[0, 0]] + placed[faces[0, 1]]) / 2
    # the first face is halved: its corners and those of the middle's are where double_edges takes them from
    parts = np.array([[faces[0, 0], len(placed), faces[0, 2]], [len(placed), faces[0, 1], faces[0, 2]]])
    corners = np.concatenate([np.arange(3, faces.size).reshape(-1, 3), [[0, 0, 2], [0, 1, 2]]])
    surface = Surface(np.concatenate([placed, [middle]]).astype(np.float32), np.concatenate([faces[1:], parts]).astype(np.int64), corners)
    found = _file_vertices(Parsed(vertices, faces, {}), frame, surface)
    assert found.tolist() == [*range(len(placed)), -1]
