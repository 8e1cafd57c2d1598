"""Directions, touching bodies, holes and faces without area: what is repaired, what is left, and what is said."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.topology import build_edges, face_components, signed_volume
from schemas.errors import MeshRejectedError
from tests.meshes import bumpy_sphere, cube, joined, sphere, torus
from tests.worker.loading.uploads import built
from worker.kernels.load_collinear import collinear
from worker.loading.surface import Surface, half_edges
from worker.loading.weld import drop_duplicates, weld


def shuffled_directions(mesh, seed=0, share=0.3):
    vertices, faces = mesh
    turn = np.random.default_rng(seed).random(len(faces)) < share
    return vertices, np.where(turn[:, None], faces[:, ::-1], faces)


def soup(mesh):
    """Every face with vertices of its own."""
    vertices, faces = mesh
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)


def volume(result) -> float:
    return signed_volume(result.positions, result.faces) * result.frame.scale**3


def assert_manifold(result) -> None:
    edges = build_edges(result.faces)
    np.testing.assert_array_equal(edges.vertices, result.edges.vertices)
    ring = np.bincount(result.faces.ravel(), minlength=len(result.positions))
    assert ring.min() >= 2
    euler = len(result.positions) - len(edges.vertices) + len(result.faces)
    assert euler % 2 == 0
    assert result.clip.available and result.stats.closed and result.stats.oriented


def surface(mesh) -> Surface:
    vertices, faces = mesh
    return Surface(vertices.astype(np.float32), faces.astype(np.int64), np.arange(3 * len(faces)).reshape(-1, 3))


# ---------------------------------------------------------------- weld and duplicates


def test_welding_keeps_first_appearance_and_ignores_the_sign_of_zero():
    points = np.array([[1, 0, 0], [0, 0, 0], [1, -0.0, 0], [-0.0, 0, 0], [2, 0, 0]], np.float32)
    kept, number = weld(points)
    assert kept.tolist() == [0, 1, 4] and number.tolist() == [0, 1, 0, 1, 2]


@given(st.lists(st.tuples(*[st.sampled_from([0.0, -0.0, 1.0, 1.0 + 2**-23, -1.0])] * 3), min_size=1, max_size=40))
def test_welding_joins_exactly_the_equal_points(points):
    array = np.array(points, np.float32)
    kept, number = weld(array)
    np.testing.assert_array_equal(array[kept][number], array)
    assert len(kept) == len({tuple(p + 0.0) for p in array})
    assert list(kept) == sorted(kept)


def test_a_soup_of_triangles_becomes_the_mesh_it_was():
    for mesh in (sphere(2), torus(), cube(3)):
        result = built(soup(mesh))
        assert (result.stats.vertices, result.stats.faces) == (len(mesh[0]), len(mesh[1]))
        assert_manifold(result)


def test_points_a_float32_apart_are_not_welded():
    vertices, faces = sphere(1)
    near = vertices.copy()
    near[0] *= 1.0 + 3e-7
    assert built(joined((vertices, faces), (near, faces))).repairs["welded_vertices"] == len(vertices) - 1


def test_duplicates_of_either_direction_are_dropped():
    vertices, faces = sphere(1)
    twice = np.concatenate([faces, faces[3:9], faces[20:24, ::-1]])
    result = built((vertices, twice))
    assert result.repairs["dropped_duplicate_faces"] == 10
    assert result.stats.faces == len(faces)
    assert_manifold(result)


def test_a_body_that_is_there_twice_is_there_once():
    assert built(joined(sphere(1), sphere(1))).stats.faces == 80


def test_a_fin_between_two_sheets_is_no_duplicate():
    vertices, faces = cube()
    fin = np.concatenate([vertices, [[0.5, 0.5, 3.0]]])
    root = build_edges(faces).vertices[0]
    both = np.concatenate([faces, [[root[0], root[1], 8], [root[1], root[0], 8]]])
    kept, dropped = drop_duplicates(surface((fin, both)))
    assert dropped == 0 and len(kept.faces) == 14


def test_same_faces_of_different_sheets_stay_where_dropping_would_open_them():
    """Two tetrahedra, one inside the other, that share a face in the same direction."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, 1], [0.2, 0.2, 2.0]])
    tetrahedron = lambda top: [[0, 2, 1], [0, 1, top], [1, 2, top], [2, 0, top]]  # noqa: E731
    result = built((vertices, np.array(tetrahedron(3) + tetrahedron(4))))
    assert result.repairs["dropped_duplicate_faces"] == 0 and result.stats.components == 2
    assert_manifold(result)


# ---------------------------------------------------------------- directions


@pytest.mark.parametrize("mesh", [sphere(2), torus(), cube(2), bumpy_sphere(2)])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 1.0])
def test_any_directions_become_outward(mesh, share):
    result = built(shuffled_directions(mesh, share=share))
    assert_manifold(result)
    assert volume(result) == pytest.approx(signed_volume(*mesh), rel=1e-5)


def test_an_inside_out_body_is_turned_and_counted():
    vertices, faces = torus()
    result = built((vertices, faces[:, ::-1]))
    assert result.repairs["flipped_components"] == 1 and volume(result) > 0


def test_each_of_several_bodies_is_turned_outward_alone():
    one, two = sphere(1), sphere(1, centre=(5, 0, 0))
    result = built(joined(one, (two[0], two[1][:, ::-1])))
    assert result.repairs["flipped_components"] == 1
    assert volume(result) == pytest.approx(2 * signed_volume(*one), rel=1e-5)


def inward(mesh):
    return mesh[0], mesh[1][:, ::-1]


def test_a_deliberate_cavity_stays_a_cavity():
    result = built(joined(sphere(2, 2.0), inward(sphere(2, 1.0))))
    assert result.repairs["flipped_components"] == 0
    assert volume(result) == pytest.approx(7 * signed_volume(*sphere(2)), rel=1e-5)


@pytest.mark.parametrize("seed", range(8))
def test_a_cavity_that_touches_the_wall_at_its_first_vertex_stays_a_cavity(seed):
    rng = np.random.default_rng(seed)
    outer, faces = cube()
    outer, inward = outer - 0.5, faces[:, ::-1]
    inner = outer * 0.5
    first = inward[0, 0]
    inner[first] = [*rng.uniform(-0.3, 0.3, 2), np.copysign(0.5, inner[first, 2])]
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    vertices, all_faces = joined((outer, faces), (inner, inward))
    result = built((vertices @ turn.T, all_faces))
    assert result.repairs["flipped_components"] == 0
    assert volume(result) < 0.95


def test_an_inside_out_file_keeps_its_cavities():
    result = built(joined(inward(sphere(2, 2.0)), sphere(2, 1.0)))
    assert result.repairs["flipped_components"] == 2
    assert volume(result) == pytest.approx(7 * signed_volume(*sphere(2)), rel=1e-5)


def test_an_inward_body_inside_a_cavity_is_turned():
    shells = joined(sphere(2, 3.0), inward(sphere(2, 2.0)), inward(sphere(2, 1.0)))
    result = built(shells)
    assert result.repairs["flipped_components"] == 1
    assert volume(result) == pytest.approx((27 - 8 + 1) * signed_volume(*sphere(2)), rel=1e-5)


def test_nested_bodies_of_random_directions_are_all_turned_outward():
    result = built(shuffled_directions(joined(sphere(2, 2.0), sphere(2, 1.0)), share=0.3))
    assert volume(result) == pytest.approx(9 * signed_volume(*sphere(2)), rel=1e-5)


def test_a_moebius_strip_is_left_alone_and_said_to_be_open():
    n = 30
    t = np.arange(n) / n * 2 * np.pi
    ring = np.column_stack([np.cos(t), np.sin(t), 0 * t])
    out = np.column_stack([np.cos(t) * np.cos(t / 2), np.sin(t) * np.cos(t / 2), np.sin(t / 2)]) * 0.3
    vertices = np.concatenate([ring + out, ring - out])
    faces = []
    for i in range(n):
        a, b = i, i + n
        c, d = (i + 1, i + 1 + n) if i + 1 < n else (n, 0)
        faces += [[a, c, b], [b, c, d]]
    result = built((vertices, np.array(faces)))
    assert result.repairs["one_sided_patches"] == 1 and result.edges is None
    assert not result.stats.closed and "boundary edges" in result.clip.reason


# ---------------------------------------------------------------- touching


def boxes(*corners):
    return joined(*[(cube()[0] + np.array(c), cube()[1]) for c in corners])


@pytest.mark.parametrize(
    ("mesh", "components", "split_edges"),
    [
        (boxes((0, 0, 0), (1, 1, 0)), 2, 1),  # at an edge
        (boxes((0, 0, 0), (1, 1, 1)), 2, 0),  # at a vertex
        (boxes((0, 0, 0), (1, 0, 0)), 2, 5),  # at a face, whose diagonals are the same
        (boxes((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)), 4, None),  # four around an edge
        (boxes((0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)), 4, None),  # each two at an edge, all at a vertex
    ],
)
@pytest.mark.parametrize("seed", [None, 1])
def test_touching_boxes_come_apart(mesh, components, split_edges, seed):
    if seed is not None:
        order = np.random.default_rng(seed).permutation(len(mesh[1]))
        mesh = mesh[0], mesh[1][order]
    result = built(mesh)
    assert_manifold(result)
    assert result.stats.components == components
    assert split_edges is None or result.repairs["split_edges"] == split_edges
    assert volume(result) == pytest.approx(components, rel=1e-6)
    labels, _ = face_components(result.faces, len(result.positions))
    for c in range(components):
        assert signed_volume(result.positions, result.faces[labels == c]) * result.frame.scale**3 == pytest.approx(1.0, rel=1e-6)


def dented_block():
    """A block with two dents whose bottoms meet in one edge: the solid passes that edge on both sides and around its ends."""
    filled = np.ones((4, 3, 4), bool)
    filled[1, 1, 2:] = False
    filled[2, 1, :2] = False
    return filled


def voxels(filled):
    """Surface of a boolean grid."""
    padded = np.pad(filled, 1)
    index: dict[tuple[int, ...], int] = {}
    faces = []
    for cell in np.argwhere(padded):
        for axis in range(3):
            for side in (0, 1):
                step = np.eye(3, dtype=int)[axis] * (2 * side - 1)
                if padded[tuple(cell + step)]:
                    continue
                u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
                base = cell + np.eye(3, dtype=int)[axis] * side
                quad = [index.setdefault(tuple(map(int, p)), len(index)) for p in (base, base + u, base + u + v, base + v)]
                quad = quad if side else quad[::-1]
                faces += [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]
    return np.array(list(index), float), np.array(faces)


def test_a_body_that_touches_itself_along_an_edge_becomes_manifold():
    result = built(voxels(dented_block()))
    assert result.repairs["split_edges"] == 1
    assert_manifold(result)
    assert volume(result) == pytest.approx(dented_block().sum(), rel=1e-6)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**27 - 1))
def test_any_heap_of_boxes_becomes_a_closed_manifold_of_the_same_volume(bits):
    filled = np.array([bits >> i & 1 for i in range(27)], bool).reshape(3, 3, 3)
    if not filled.any():
        return
    result = built(voxels(filled))
    assert_manifold(result)
    assert volume(result) == pytest.approx(filled.sum(), rel=1e-5)
    assert not collinear(result.positions, result.faces).any()


def test_the_two_sides_of_a_lone_triangle_are_taken_out_beside_a_body():
    vertices, faces = cube()
    card = np.array([[5.0, 0, 0], [6, 0, 0], [5, 1, 0]]), np.array([[0, 1, 2], [0, 2, 1]])
    result = built(joined((vertices, faces), card))
    assert result.repairs["removed_fin_faces"] == 2 and result.stats.faces == 12
    assert_manifold(result)


def test_a_flat_closed_mesh_bounds_no_volume():
    card = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 1]])
    result = built(card)
    assert not result.clip.available and "no volume" in result.clip.reason


# ---------------------------------------------------------------- holes


def without(mesh, count, start=0):
    return mesh[0], np.delete(mesh[1], range(start, start + count), axis=0)


def fan_removed(mesh, vertex):
    vertices, faces = mesh
    return vertices, faces[~(faces == vertex).any(axis=1)]


def test_small_holes_are_closed_and_counted():
    mesh = fan_removed(fan_removed(sphere(3), 5), 300)
    result = built(mesh)
    assert result.repairs["closed_holes"] == 2
    assert result.repairs["closed_hole_edges"] == 5 + 6 and result.repairs["added_faces"] == 3 + 4
    assert_manifold(result)


@pytest.mark.parametrize("seed", range(4))
def test_random_small_holes_are_closed(seed):
    vertices, faces = bumpy_sphere(3)
    gone = np.random.default_rng(seed).choice(len(faces), 8, replace=False)
    result = built((vertices, np.delete(faces, gone, axis=0)))
    assert_manifold(result)
    assert result.stats.faces == len(faces)


def test_holes_that_touch_at_a_vertex_are_closed_one_by_one():
    vertices, faces = sphere(3)
    at = np.flatnonzero((faces == 300).any(axis=1))
    pair = [at[0], next(f for f in at[1:] if len(set(faces[f]) & set(faces[at[0]])) == 1)]
    result = built((vertices, np.delete(faces, pair, axis=0)))
    assert result.repairs["closed_holes"] == 2 and result.repairs["added_vertices"] == 0
    assert_manifold(result)


def test_a_hole_with_straight_rims_gets_no_face_without_area():
    vertices, faces = cube(8)
    middle = vertices[faces].mean(axis=1)
    hole = (middle[:, 2] > 0.999) & (np.abs(middle[:, :2] - 0.5) < 0.25 / 2).all(axis=1)
    result = built((vertices, faces[~hole]))
    assert result.repairs["closed_holes"] == 1
    assert_manifold(result)
    assert not collinear(result.positions, result.faces).any()
    assert volume(result) == pytest.approx(1.0)


def test_half_a_sphere_is_not_closed():
    vertices, faces = sphere(3)
    half = faces[vertices[faces].mean(axis=1)[:, 2] > 0]
    result = built((vertices, half))
    assert result.repairs["closed_holes"] == 0 and not result.stats.closed
    assert "boundary edges" in result.clip.reason and result.edges is None


def test_holes_are_closed_all_or_none():
    vertices, faces = sphere(3)
    half = faces[vertices[faces].mean(axis=1)[:, 2] > 0]
    result = built(without((vertices, half), 1, start=100))
    assert result.repairs["added_faces"] == 0


def test_lone_triangles_are_not_closed():
    triangles = [np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]) + 3 * i for i in range(5)]
    result = built((np.concatenate(triangles), np.arange(15).reshape(-1, 3)))
    assert result.stats.faces == 5 and result.stats.components == 5


def test_very_many_open_triangles_are_left_quickly():
    corners = np.random.default_rng(0).random((300_000, 3))
    result = built((corners, np.arange(300_000).reshape(-1, 3)))
    assert result.stats.components == 100_000 and not result.stats.closed


# ---------------------------------------------------------------- faces without area


def with_needle(mesh, face=0):
    """The mesh with a vertex in the middle of an edge of one side only: a T-junction closed by a face without area."""
    vertices, faces = mesh
    a, b, c = faces[face]
    middle = (vertices[a] + vertices[b]) / 2
    m = len(vertices)
    changed = np.delete(faces, face, axis=0)
    more = np.array([[a, m, c], [m, b, c], [a, b, m]])
    return np.concatenate([vertices, [middle]]), np.concatenate([changed, more])


@pytest.mark.parametrize("face", range(12))
def test_a_face_without_area_is_flipped_away_and_nothing_moves(face):
    result = built(with_needle(cube(), face))
    assert result.repairs["flipped_zero_area_faces"] == 1 and result.repairs["kept_zero_area_faces"] == 0
    assert_manifold(result)
    assert not collinear(result.positions, result.faces).any()
    assert volume(result) == pytest.approx(1.0) and result.stats.vertices == 9


def test_a_chain_of_faces_without_area_is_flipped_away():
    mesh = cube()
    for face in (0, 3, 5, 12, 13, 14):
        mesh = with_needle(mesh, face)
    result = built(mesh)
    assert_manifold(result)
    assert result.repairs["kept_zero_area_faces"] == 0 and volume(result) == pytest.approx(1.0)


def test_a_face_without_area_at_a_boundary_is_dropped():
    vertices = np.array([[0.0, 0, 0], [2, 0, 0], [1, 2, 0], [1, 0, 0]])
    result = built((vertices, np.array([[0, 3, 2], [3, 1, 2], [0, 1, 3]])))
    assert result.repairs["dropped_zero_area_faces"] == 1 and result.stats.faces == 2


def test_collinear_is_exact():
    rng = np.random.default_rng(0)
    a, d = rng.integers(-(2**10), 2**10, (500, 3)), rng.integers(-(2**9), 2**9, (500, 3))
    points = np.stack([a, a + d, a - 3 * d], axis=1).astype(np.float32) / np.float32(2**12)
    faces = np.arange(1500).reshape(-1, 3)
    assert collinear(points.reshape(-1, 3), faces).all()
    off = points.copy()
    moved = (d != 0).all(axis=1)
    off[:, 1, 0] = np.nextafter(off[:, 1, 0], np.float32(2))
    assert not collinear(off.reshape(-1, 3), faces)[moved].any()


# ---------------------------------------------------------------- repair = never, and the half-edges


def test_without_repair_the_mesh_is_only_welded():
    vertices, faces = inward(fan_removed(sphere(3), 5))
    result = built(soup((vertices, faces)), repair="never")
    assert result.stats.faces == len(faces) and not result.stats.closed
    assert result.edges is None and "closed_holes" not in result.repairs


def test_without_repair_an_inside_out_body_cannot_be_clipped():
    result = built(inward(sphere(1)), repair="never")
    assert result.stats.closed and not result.clip.available and "inside out" in result.clip.reason


def test_without_repair_bodies_that_touch_at_a_vertex_cannot_be_clipped():
    result = built(boxes((0, 0, 0), (1, 1, 1)), repair="never")
    assert result.edges is not None and "vertex" in result.clip.reason


def test_the_reason_names_every_kind_of_fault():
    vertices, faces = cube()
    crossed = np.concatenate([faces, [[0, 1, 6]]])
    reason = built((vertices, crossed), repair="never").clip.reason
    assert reason.startswith("The surface is not closed: it has ") and reason.endswith(".")


@settings(max_examples=60, deadline=None)
@given(st.integers(4, 9), st.integers(1, 40), st.integers(0, 2**31))
def test_half_edges_are_grouped_like_a_sort_would(vertices, count, seed):
    rng = np.random.default_rng(seed)
    faces = np.array([rng.choice(vertices, 3, replace=False) for _ in range(count)])
    edges = half_edges(faces)
    half = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    low, high = half.min(axis=1), half.max(axis=1)
    np.testing.assert_array_equal(edges.order, np.lexsort((np.arange(len(half)), high, low)))
    _, inverse, counts = np.unique(low * 100 + high, return_inverse=True, return_counts=True)
    np.testing.assert_array_equal(edges.edge, inverse)
    np.testing.assert_array_equal(edges.counts, counts)
    np.testing.assert_array_equal(edges.forward, half[:, 0] < half[:, 1])


def test_a_vertex_of_very_many_edges_is_grouped():
    n = 5000
    rim = np.arange(1, n + 1)
    faces = np.column_stack([np.zeros(n, int), rim, np.roll(rim, -1)])
    edges = half_edges(faces)
    assert (np.sort(edges.counts)[:n] == 1).all() and len(edges.counts) == 2 * n


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31))
def test_random_faces_over_few_vertices_never_break_loading(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 8))
    vertices = rng.integers(0, 3, (n, 3)).astype(float) + np.arange(n)[:, None] * [1e-3, 0, 0]
    faces = np.array([rng.choice(n, 3, replace=False) for _ in range(int(rng.integers(1, 30)))])
    try:
        result = built((vertices, faces))
    except MeshRejectedError as error:
        assert error.code == "no-faces"  # all corners on one line
        return
    if result.clip.available:
        assert_manifold(result)
    assert (result.edges is None) == (not result.stats.closed)
    assert len(np.unique(result.shading.normal_vertices)) == len(result.positions) == result.stats.vertices
