"""The last resort for edges that four faces share and no numbering of vertices can take apart."""

from __future__ import annotations

import numpy as np

from geometry.topology import build_edges, signed_volume
from tests.meshes import sphere
from worker.loading.double_edges import part_double_edges
from worker.loading.surface import Surface, half_edges


def paired(mesh) -> tuple[Surface, np.ndarray]:
    """A closed mesh as a surface, and the mates of its half-edges."""
    vertices, faces = mesh
    surface = Surface(vertices.astype(np.float32), faces.astype(np.int64), np.arange(3 * len(faces)).reshape(-1, 3))
    edges = half_edges(surface.faces)
    mates = np.empty(3 * len(faces), np.int64)
    mates[edges.order[0::2]], mates[edges.order[1::2]] = edges.order[1::2], edges.order[0::2]
    return surface, mates


def assert_mates(surface: Surface, mates: np.ndarray) -> None:
    flat = surface.faces.ravel()
    end = surface.faces[:, [1, 2, 0]].ravel()
    np.testing.assert_array_equal(mates[mates], np.arange(len(mates)))
    np.testing.assert_array_equal(flat[mates], end)


def test_an_edge_of_two_pairs_gets_a_middle_vertex_for_one_of_them():
    surface, mates = paired(sphere(3))
    edges = build_edges(surface.faces.astype(np.int32)).vertices
    (a, b), (c, d) = edges[0], edges[-1]
    number = np.arange(len(surface.positions))
    number[[c, d]] = a, b
    pinched = Surface(surface.positions, number[surface.faces], surface.corners)
    parted, mates, halved, removed = part_double_edges(pinched, mates)
    assert (halved, removed) == (2, 0)
    assert len(parted.faces) == len(surface.faces) + 2 and len(parted.positions) == len(surface.positions) + 1
    build_edges(parted.faces.astype(np.int32))
    assert_mates(parted, mates)
    before = signed_volume(pinched.positions, pinched.faces)
    assert abs(signed_volume(parted.positions, parted.faces) - before) < 1e-6 * abs(before)


def test_several_edges_at_one_face_are_parted_in_rounds():
    surface, mates = paired(sphere(3))
    number = np.arange(len(surface.positions))
    number[surface.faces[700]] = surface.faces[100]
    pinched = Surface(surface.positions, number[surface.faces], surface.corners)
    for _ in range(4):
        pinched, mates, halved, removed = part_double_edges(pinched, mates)
        assert_mates(pinched, mates)
        if not halved + removed:
            break
    build_edges(pinched.faces.astype(np.int32))


def test_a_fin_is_taken_out_instead_of_halved():
    surface, mates = paired(sphere(1))
    a, b = build_edges(surface.faces.astype(np.int32)).vertices[0]
    top, n = len(surface.positions), 3 * len(surface.faces)
    fin = np.array([[a, b, top], [b, a, top]])
    corners = np.zeros((2, 3), np.int64)
    finned = Surface(np.concatenate([surface.positions, [[2, 2, 2]]]).astype(np.float32), surface.faces, surface.corners).extended(
        fin, corners
    )
    # a -> b with b -> a, b -> top with top -> b, top -> a with a -> top
    own = np.array([n + 3, n + 5, n + 4, n, n + 2, n + 1])
    parted, after, halved, removed = part_double_edges(finned, np.concatenate([mates, own]))
    assert (halved, removed) == (0, 2)
    np.testing.assert_array_equal(parted.faces, surface.faces)
    np.testing.assert_array_equal(after, mates)
