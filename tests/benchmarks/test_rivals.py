from functools import partial

import numpy as np
import pytest

from benchmarks.models import AbsentError
from benchmarks.rivals import igl_hull, nested_cage, numpy_extractor, simplified, vtk_extractor
from geometry.silhouettes import silhouette_scalar
from geometry.topology import build_edges
from tests.meshes import knot, normalised, sphere
from tests.oracles_hull import points_outside


@pytest.fixture(scope="module")
def surface():
    positions, faces, *_ = normalised(knot(60, 10))
    return positions, faces


def made(maker, *arguments):
    try:
        return maker(*arguments)
    except AbsentError as absent:
        pytest.skip(str(absent))


def eyes():
    directions = np.random.default_rng(3).normal(size=(6, 3))
    return np.column_stack([3.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True), np.ones(6)])


def test_numpy_finds_the_exact_directed_silhouette(surface):
    edges = build_edges(surface[1])
    extract = numpy_extractor(*surface, edges.vertices, edges.faces)
    for eye in eyes():
        found, exact = extract(eye), silhouette_scalar(*surface, edges.vertices, edges.faces, eye)
        assert len(found) > 20
        assert {*map(tuple, found)} == {*map(tuple, exact)}


def test_vtk_finds_as_many_edges_for_each_eye(surface):
    edges = build_edges(surface[1])
    extract = made(vtk_extractor, *surface)
    for eye in eyes():
        assert extract(eye) == len(silhouette_scalar(*surface, edges.vertices, edges.faces, eye))


@pytest.mark.parametrize("maker", [igl_hull, partial(nested_cage, energy="None")], ids=["libigl", "nested_cages"])
def test_rival_hulls_enclose_have_few_faces_and_are_timed(maker):
    positions, faces, _ = normalised(sphere(2))
    hull = made(maker, positions, faces, 100)
    assert 4 <= len(hull.faces) <= 100
    assert hull.seconds > 0.0
    assert not points_outside(hull.positions, hull.faces, positions).any()


def test_simplified_mesh_is_closed_and_has_the_faces_asked_for(surface):
    positions, faces = made(simplified, *surface, 400)
    assert len(faces) == 400
    assert len(build_edges(faces).vertices) == 600
    assert positions.dtype == np.float32
