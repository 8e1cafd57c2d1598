"""Enclosure is decided right: winding numbers against solid angles, crossings against rational arithmetic, dents however hidden."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.boxes import build_boxes
from tests import oracles
from tests.meshes import bumpy_sphere, cube, joined, knot, normalised, sphere, torus
from worker.enclosure import NotEnclosedError, UnprovenError, enclosure_fault
from worker.kernels import verify_enclosure


def quiet(_):
    """Progress that nobody watches."""


def boxed(mesh):
    positions, faces = np.asarray(mesh[0], np.float32), mesh[1]
    return positions, faces, *build_boxes(positions, faces)


def solid_angle_winding(positions, faces, points):
    """Winding numbers as sums of signed solid angles (van Oosterom and Strackee)."""
    a, b, c = (positions[faces[:, k]].astype(np.float64)[None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
    dot = [np.einsum("pfi,pfi->pf", x, y) for x, y in ((a, b), (b, c), (c, a))]
    det = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    return np.rint(np.arctan2(det, la * lb * lc + dot[0] * lc + dot[1] * la + dot[2] * lb).sum(axis=1) / (2 * np.pi))


@pytest.mark.parametrize(
    "mesh",
    [
        torus(20, 10),
        knot(40, 8),
        joined(sphere(2), sphere(2, centre=(0.7, 0.1, 0))),
        joined(sphere(2), (sphere(1, 0.5)[0], sphere(1)[1][:, ::-1])),
    ],
)
def test_winding_numbers_are_the_sums_of_solid_angles(mesh):
    positions, faces, order, boxes = boxed(mesh)
    rng = np.random.default_rng(0)
    points = rng.uniform(positions.min(axis=0), positions.max(axis=0), (400, 3))
    winding, on = verify_enclosure.winding_numbers(positions, faces, order, boxes, points)
    assert np.array_equal(winding, solid_angle_winding(positions, faces, points))
    assert not on.any()


def test_winding_numbers_hold_where_rays_run_through_edges_and_vertices():
    positions, faces, order, boxes = boxed(cube(4))
    grid = np.stack(np.meshgrid(*[np.arange(-2, 11) / 8.0] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    winding, on = verify_enclosure.winding_numbers(positions, faces, order, boxes, grid)
    inside = np.all((grid > 0) & (grid < 1), axis=1)
    outside = np.any((grid < 0) | (grid > 1), axis=1)
    assert np.all(winding[inside] == 1)
    assert np.all(winding[outside] == 0)
    assert not on[inside | outside].any()
    caps = np.all((grid[:, :2] > 0) & (grid[:, :2] < 1), axis=1) & np.isin(grid[:, 2], [0, 1])
    assert on[caps].all()


def test_a_mesh_encloses_itself():
    for mesh in (cube(3), bumpy_sphere(3), knot(60, 8)):
        positions, faces, _ = normalised(mesh)
        assert enclosure_fault(positions, faces, positions, faces) == 0


def test_parts_that_go_through_each_other_are_enclosed_by_hulls_that_do_too():
    inner, outer = (joined(sphere(2, r), sphere(2, r, centre=(1.1, 0.2, 0))) for r in (1.0, 1.1))
    assert enclosure_fault(np.float32(inner[0]), inner[1], np.float32(outer[0]), outer[1]) == 0


def test_a_part_turned_inside_out_bounds_nothing_and_needs_no_hull():
    ball, hull = sphere(2), sphere(2, 1.1)
    far = sphere(1, 0.2, centre=(3, 0, 0))
    original = joined(ball, (far[0], far[1][:, ::-1]))
    assert enclosure_fault(np.float32(original[0]), original[1], np.float32(hull[0]), hull[1]) == 0
    with pytest.raises(NotEnclosedError):
        enclosure_fault(np.float32(joined(ball, far)[0]), joined(ball, far)[1], np.float32(hull[0]), hull[1])


@pytest.mark.parametrize("gap", [1e-6, 4e-7, 5e-5])
def test_a_sheet_turned_inside_out_close_above_the_surface_is_no_fault(gap):
    """As where a scan folds over: what lies above a real surface by less than any step bounds no interior of its own."""
    box, slab = cube(4), cube(2)
    fold = slab[0] * [0.5, 0.5, 4e-6] + [0.25, 0.25, 1.0 + gap]
    folded = joined(box, (fold, slab[1][:, ::-1]))
    assert enclosure_fault(np.float32(folded[0]), folded[1], np.float32(box[0]), box[1]) == 0
    solid = joined(box, (fold, slab[1]))
    with pytest.raises(NotEnclosedError):
        enclosure_fault(np.float32(solid[0]), solid[1], np.float32(box[0]), box[1])


def sliver_cube(height):
    """[0, 1]^3 whose top has a face of that height along its whole diagonal."""
    vertices, faces = cube(1)
    top = [f for f in range(len(faces)) if np.all(vertices[faces[f], 2] == 1.0)]
    one, other = faces[top[0]], faces[top[1]]
    k = next(k for k in range(3) if one[(k + 2) % 3] not in other)
    a, b, c, n = *np.roll(one, -k), len(vertices)
    point = [0.5, 0.5, 1.0] + height * np.sign(vertices[c] - [0.5, 0.5, 1.0])
    split = [[a, b, n], [n, b, c], [a, n, c]]
    return np.float32(np.vstack([vertices, point])), np.vstack([np.delete(faces, top[0], axis=0), split]).astype(np.int32)


@pytest.mark.parametrize("height", [0.0, 6e-8, 1e-3])
def test_slivers_and_faces_without_area_neither_refuse_a_hull_nor_hide_a_dent(height):
    positions, faces = sliver_cube(height)
    assert enclosure_fault(positions, faces, positions, faces) == 0
    for at in ([0.25, 0.25, 1.0], [0.5, 0.5, 1.0], [0.75, 0.625, 1.0], [0.625, 0.75, 1.0]):
        assert enclosure_fault(positions, faces, *dented_cube(np.array(at), 0.0)) == 0
        for depth in (0.3, 0.0101):
            with pytest.raises(NotEnclosedError):
                enclosure_fault(positions, faces, *dented_cube(np.array(at), depth))


def dented_cube(at, depth):
    """A cube a little larger than [0, 1]^3 whose vertex nearest to `at` is pushed to it by depth along z."""
    vertices, faces = cube(16)
    vertices = vertices * 1.02 - 0.01
    nearest = np.argmin(np.linalg.norm(vertices - at, axis=1))
    vertices[nearest, 2] -= depth
    return vertices.astype(np.float32), faces


def test_a_dent_into_a_large_face_is_found():
    positions, faces = np.float32(cube(1)[0]), cube(1)[1]
    at = np.array([0.75, 0.125, 1.0])  # away from the vertices and the middles of edges and faces
    assert enclosure_fault(positions, faces, *dented_cube(at, 0.0)) == 0
    with pytest.raises(NotEnclosedError, match="goes through the original"):
        enclosure_fault(positions, faces, *dented_cube(at, 0.3))


def test_a_dent_across_a_long_edge_is_found():
    positions, faces = np.float32(cube(1)[0]), cube(1)[1]
    at = np.array([0.25, 0.0, 1.0])
    with pytest.raises(NotEnclosedError, match="an edge of the original goes through"):
        enclosure_fault(positions, faces, *dented_cube(at, 0.3))


def test_hull_edges_through_slivers_of_parts_that_overlap_are_no_fault():
    """Where parts overlap, a hull edge of one goes through faces of the other deep inside; next to a sliver is not on it."""
    needle = np.array([[-2.0, 0, 0], [2.0, 1e-6, 0], [2.0, 0, 1e-6], [2.0, 0, 0]])
    needle = (needle, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32))
    box = (cube(1)[0] * 2.0 - 1.0, cube(1)[1])
    needle, box = (np.float32(needle[0]), needle[1]), (np.float32(box[0]), box[1])
    grown = (box[0] * np.float32(1.1), box[1])
    both, around = joined(box, needle), joined(grown, needle)
    assert enclosure_fault(np.float32(both[0]), both[1], np.float32(around[0]), around[1]) == 0


def test_a_hull_that_cuts_off_a_vertex_by_more_than_a_rounding_is_found():
    positions, faces, _ = normalised(cube(2))
    for scale, grazing in ((1.0 - 1e-7, True), (1.0 - 1e-5, False)):
        hull = (positions * np.float64(scale)).astype(np.float32)
        if grazing:
            assert enclosure_fault(positions, faces, hull, faces) > 0
        else:
            with pytest.raises(NotEnclosedError, match="a vertex"):
                enclosure_fault(positions, faces, hull, faces)


def strictly_crosses(p, q, a, b, c):
    """By rational arithmetic: the ends lie strictly on two sides of the triangle's plane, and the segment meets the triangle."""
    if oracles.orientation(a, b, c, (*p, 1)) * oracles.orientation(a, b, c, (*q, 1)) >= 0:
        return False
    turns = [oracles.orientation(p, q, s, (*e, 1)) for s, e in ((a, b), (b, c), (c, a))]
    return min(turns) >= 0 or max(turns) <= 0


@pytest.mark.parametrize("scale", [1.0, 1e-20, 1e15])
def test_crossings_are_those_of_rational_arithmetic_whatever_touches(scale):
    """On a coarse grid segments run through corners, sides and planes all the time, and many share a corner with a face."""
    rng = np.random.default_rng(12)
    positions = (rng.integers(0, 5, (40, 3)) * scale).astype(np.float32)
    faces = rng.integers(0, 40, (60, 3)).astype(np.int32)
    ends = rng.integers(0, 40, (50, 2))
    starts, stops = positions[ends[:, 0]], positions[ends[:, 1]] + np.float32(0.5 * scale) * rng.integers(0, 2, (50, 1)).astype(np.float32)
    order, boxes = build_boxes(positions, faces)
    pairs = np.empty((3000, 2), np.int32)
    count = verify_enclosure.crossings(positions, faces, order, boxes, starts, stops, pairs, len(pairs))
    expected = {(n, f) for n in range(50) for f in range(60) if strictly_crosses(starts[n], stops[n], *positions[faces[f]])}
    assert {tuple(pair) for pair in pairs[:count].tolist()} == expected
    assert len(expected) > 20


def random_torus(rounds, around, seed):
    """A closed mesh, connected like a torus, whose vertices lie anywhere: each face goes through a tenth of the others."""
    i, j = np.meshgrid(np.arange(rounds), np.arange(around), indexing="ij")
    corner = [(i + p) % rounds * around + (j + q) % around for p, q in ((0, 0), (1, 0), (1, 1), (0, 1))]
    faces = np.concatenate([np.stack([corner[0], corner[k], corner[k + 1]], axis=-1).reshape(-1, 3) for k in (1, 2)])
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (rounds * around, 3)).astype(np.float32), faces.astype(np.int32)


def test_surfaces_that_cross_each_other_everywhere_are_refused_and_not_looked_at_for_minutes():
    mesh = random_torus(40, 25, 0)
    with pytest.raises(UnprovenError, match="too often"):
        enclosure_fault(*mesh, *mesh)
