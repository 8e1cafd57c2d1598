from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.silhouette.contours import link_contours
from tests import meshes
from tests.service.oracles import silhouette


def edges_of(contours):
    loops = [contours.vertices[a:b] for a, b in zip(contours.offsets, contours.offsets[1:], strict=False)]
    return [tuple(int(v) for v in pair) for loop in loops for pair in zip(loop, np.roll(loop, -1), strict=True)]


def assert_links(edges, contours):
    assert contours.vertices.dtype == contours.offsets.dtype == np.int32
    assert contours.offsets[0] == 0
    assert contours.offsets[-1] == len(contours.vertices) == len(edges)
    assert np.all(np.diff(contours.offsets) > 0)
    assert Counter(edges_of(contours)) == Counter(tuple(int(v) for v in e) for e in edges)
    for a, b in zip(contours.offsets, contours.offsets[1:], strict=False):
        assert len(set(contours.vertices[a:b].tolist())) == b - a


def test_a_triangle_is_one_contour_in_its_own_order():
    contours = link_contours(np.int32([[7, 2], [9, 7], [2, 9]]))
    assert len(contours) == 1
    assert contours.vertices.tolist() == [7, 2, 9]


def test_a_figure_of_eight_is_split_where_it_meets_itself():
    contours = link_contours(np.int32([[0, 1], [1, 2], [2, 0], [0, 3], [3, 4], [4, 0]]))
    assert sorted(sorted(contours.vertices[a:b].tolist()) for a, b in zip(contours.offsets, contours.offsets[1:], strict=False)) == [
        [0, 1, 2],
        [0, 3, 4],
    ]


def test_no_edges_are_no_contours():
    contours = link_contours(np.empty((0, 2), np.int32))
    assert len(contours) == 0
    assert contours.offsets.tolist() == [0]


@settings(max_examples=100, deadline=None)
@given(st.lists(st.lists(st.integers(0, 9), min_size=1, max_size=12), min_size=1, max_size=6), st.randoms(use_true_random=False))
def test_every_edge_of_closed_walks_is_used_once_in_loops_without_repeats(walks, random):
    edges = [[a, b] for walk in walks for a, b in zip(walk, walk[1:] + walk[:1], strict=True)]
    random.shuffle(edges)
    assert_links(edges, link_contours(np.int32(edges)))


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=1, max_size=12))
def test_edges_are_refused_exactly_when_some_vertex_is_unbalanced(edges):
    balance = Counter(a for a, _ in edges)
    balance.subtract(b for _, b in edges)
    if any(balance.values()):
        with pytest.raises(ValueError, match="closed"):
            link_contours(np.int32(edges))
    else:
        assert_links(edges, link_contours(np.int32(edges)))


def test_vertex_numbers_may_be_as_large_as_they_can_be():
    edges = np.int32([[2**31 - 1, 0], [0, 2**31 - 2], [2**31 - 2, 2**31 - 1]])
    assert_links(edges, link_contours(edges))


@pytest.mark.parametrize(
    "mesh", [meshes.sphere(3), meshes.bumpy_sphere(4), meshes.torus(), meshes.knot()], ids=["sphere", "bumpy", "torus", "knot"]
)
def test_silhouettes_of_meshes_link_up(mesh):
    positions, faces, _ = meshes.normalised(mesh)
    for eye in meshes.eyes(5, orthographic=3):
        edges = silhouette(positions, faces, eye)
        assert_links(edges, link_contours(edges))


def test_many_vertices_that_meet_in_a_hash_table_are_told_apart():
    ring = np.arange(20_000, dtype=np.int32) * 4096
    edges = np.column_stack([ring, np.roll(ring, -1)])
    assert len(link_contours(np.random.default_rng(0).permutation(edges))) == 1
