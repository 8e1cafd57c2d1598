from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from geometry.hull_sequence import MOVE, cut_hull, replay_steps
from geometry.topology import NotManifoldError, build_edges, face_components, face_normals, signed_volume
from schemas.errors import CancelledError
from tests.meshes import bumpy_sphere, cube, joined, knot, normalised, shared, sphere, torus
from tests.oracles_hull import surface_points, uncovered, winding_numbers
from worker.hull import UNREACHED_EXCESS, build_hull


def quiet(_fraction: float) -> None:
    pass


def hull_of(mesh, max_faces):
    positions, faces, _ = normalised(mesh)
    return positions, faces, build_hull(positions, faces, max_faces, quiet)


def cut(positions, faces, hull, max_faces):
    return cut_hull(positions, faces, hull.step_vertices, hull.step_positions, max_faces)


def rotated(mesh, seed=0):
    rotation = trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).uniform(size=3))[:3, :3]
    return mesh[0] @ rotation.T, mesh[1]


def plane_side(p, face, v):
    """Exact sign of the volume of the tetrahedron over a face: positive outside."""
    a, b, c, d = ([Fraction(float(x)) for x in q] for q in (*(p[i] for i in face), v))
    (ux, uy, uz), (wx, wy, wz), (dx, dy, dz) = ([q[k] - a[k] for k in range(3)] for q in (b, c, d))
    return (uy * wz - uz * wy) * dx + (uz * wx - ux * wz) * dy + (ux * wy - uy * wx) * dz


def assert_every_collapse_moves_outwards(positions, faces, hull):
    """Exact arithmetic: the invariant from which enclosure follows; after every run of moves, enclosure itself."""
    p = np.array(positions, np.float32)
    live = [list(f) for f in faces.tolist()]
    points = np.concatenate([positions, surface_points(positions, faces, 300)])
    merges = hull.step_vertices[:, 1] != MOVE
    for step, ((a, b), v) in enumerate(zip(hull.step_vertices.tolist(), hull.step_positions, strict=True)):
        if b == MOVE:
            p[a] = v
            if step + 1 == len(merges) or merges[step + 1]:
                assert not uncovered(positions, faces, p, np.array(live, np.int32), points).any()
            continue
        around = [f for f in live if a in f or b in f]
        assert any(a in f and b in f for f in around)
        assert all(plane_side(p, f, v) >= 0 for f in around)
        live = [[a if i == b else i for i in f] for f in live if not (a in f and b in f)]
        p[a] = v
        build_edges(np.array(live, np.int32))


def assert_sound(positions, faces, hull, max_faces, samples=1500):
    """Closed, oriented, without degenerate faces, and around everything."""
    hp, hf = cut(positions, faces, hull, max_faces)
    assert hp.dtype == np.float32
    assert hf.dtype == np.int32
    build_edges(hf)
    assert len(np.unique(hf)) == len(hp)
    points = np.concatenate([positions, surface_points(positions, faces, samples)])
    assert not uncovered(positions, faces, hp, hf, points).any()
    if np.all(face_normals(positions, faces).any(axis=1)):
        assert np.all(face_normals(hp, hf).any(axis=1))
    return hp, hf


MESHES = {
    "sphere": sphere(3),
    "bumpy sphere": bumpy_sphere(4, 0.3),
    "torus": torus(40, 20),
    "knot": knot(120, 10),
    "cube": rotated(cube(8)),
    "two that overlap": joined(sphere(3), sphere(3, 0.8, (0.9, 0.1, 0.0))),
    "nested": joined(sphere(3), sphere(2, 0.5)),
}


@pytest.mark.parametrize("name", MESHES)
def test_hull_encloses_every_original_vertex_and_face(name):
    positions, faces, hull = hull_of(MESHES[name], 200)
    assert len(hull.faces) <= 200
    for count in (400, 200, 60):
        assert_sound(positions, faces, hull, count)


@pytest.mark.parametrize("name", ["bumpy sphere", "torus", "cube"])
def test_volume_excess_is_the_volume_gained(name):
    positions, faces, hull = hull_of(MESHES[name], 150)
    expected = signed_volume(hull.positions, hull.faces) / signed_volume(positions, faces) - 1.0
    assert hull.volume_excess == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("name", ["bumpy sphere", "torus", "knot"])
@pytest.mark.parametrize("side", ["outer", "inner"])
def test_moves_against_the_original_take_volume_from_the_hull_and_leave_it_enclosing(name, side):
    positions, faces, _ = normalised(MESHES[name])
    hull = build_hull(positions, faces, 200, quiet, side)
    moves = np.flatnonzero(hull.step_vertices[:, 1] == MOVE)
    assert len(moves)
    sign = 1.0 if side == "outer" else -1.0
    for first, last in ((moves[0], moves[0] + 1), (moves[-1], moves[-1] + 1)):
        before = replay_steps(positions, faces, hull.step_vertices, hull.step_positions, int(first))
        after = replay_steps(positions, faces, hull.step_vertices, hull.step_positions, int(last))
        assert sign * signed_volume(*after) < sign * signed_volume(*before)
        inside, outside = ((positions, faces), after) if side == "outer" else (after, (positions, faces))
        points = np.concatenate([inside[0], surface_points(*inside, 1500)])
        assert not uncovered(*inside, *outside, points).any()


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(["bumpy", "torus", "cube", "noise"]), st.integers(0, 10_000))
def test_every_collapse_keeps_the_new_vertex_outside_exactly(kind, seed):
    rng = np.random.default_rng(seed)
    if kind == "bumpy":
        mesh = bumpy_sphere(2, rng.uniform(0, 0.6), seed)
    elif kind == "torus":
        mesh = rotated(torus(int(rng.integers(3, 16)), int(rng.integers(3, 9)), 1.0, rng.uniform(0.05, 0.9)), seed)
    elif kind == "cube":
        mesh = rotated(cube(int(rng.integers(1, 5))), seed)
    else:
        v, f = sphere(2)
        mesh = v * rng.uniform(0.6, 1.4, (len(v), 1)) * rng.uniform(0.05, 1.0, 3), f
    positions, faces, hull = hull_of(mesh, 4)
    assert_every_collapse_moves_outwards(positions, faces, hull)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 0.45), st.integers(4, 400))
def test_random_star_shapes_are_enclosed(seed, amplitude, max_faces):
    positions, faces, hull = hull_of(bumpy_sphere(3, amplitude, seed), max_faces)
    assert_sound(positions, faces, hull, max_faces, samples=300)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_self_crossing_surfaces_stay_closed_and_outward(seed):
    rng = np.random.default_rng(seed)
    v, f = torus(20, 10)
    positions, faces, hull = hull_of((v + rng.normal(0, 0.15, v.shape), f), 60)
    assert_every_collapse_moves_outwards(positions, faces, hull)


def test_the_winding_number_falls_nowhere_even_where_the_surface_crosses_itself():
    rng = np.random.default_rng(5)
    v, f = torus(40, 20)
    positions, faces, hull = hull_of((v + rng.normal(0, 0.1, v.shape), f), 100)
    points = rng.uniform(-1, 1, (4000, 3)) * (1, 1, 0.5)
    before = winding_numbers(positions, faces, points)
    after = winding_numbers(hull.positions, hull.faces, points)
    assert len(np.unique(np.round(before))) > 2
    assert np.all(after >= before - 1e-6)


@pytest.mark.parametrize("per_side", [2, 10, 40])
def test_a_finely_meshed_cube_becomes_twelve_faces_without_any_gain(per_side):
    positions, faces, hull = hull_of(cube(per_side), 12)
    assert len(hull.faces) == 12
    assert hull.volume_excess == 0.0
    assert signed_volume(hull.positions, hull.faces) == pytest.approx(signed_volume(positions, faces), rel=1e-12)
    corner = np.abs(hull.positions)
    assert np.all(corner == corner[0, 0])


def test_a_rotated_cube_becomes_twelve_faces_with_next_to_no_gain():
    _, _, hull = hull_of(rotated(cube(40)), 12)
    assert len(hull.faces) == 12
    assert hull.volume_excess < 1e-4


def test_a_hull_larger_than_the_mesh_is_the_mesh():
    positions, faces, hull = hull_of(sphere(2), 10_000)
    assert np.array_equal(hull.positions, positions)
    assert np.array_equal(hull.faces, faces)
    assert hull.volume_excess == 0.0


def test_a_tetrahedron_stays_what_it_is():
    mesh = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    positions, faces, hull = hull_of(mesh, 1)
    assert len(hull.step_vertices) == 0
    assert np.array_equal(hull.faces, faces)
    assert np.array_equal(hull.positions, positions)


def test_a_count_that_cannot_be_reached_gives_a_tight_hull_and_the_whole_sequence():
    positions, faces, hull = hull_of(joined(*(sphere(2, 0.3, (x, 0, 0)) for x in range(5))), 10)
    assert hull.volume_excess <= UNREACHED_EXCESS
    assert 20 <= len(hull.faces) < len(faces) / 4
    fewest = assert_sound(positions, faces, hull, 10)[1]
    assert len(fewest) == len(faces) - 2 * np.count_nonzero(hull.step_vertices[:, 1] != MOVE)
    assert 20 <= len(fewest) < len(hull.faces)


@pytest.mark.parametrize(("side", "left"), [("outer", 0.7), ("inner", 1.0)])
def test_a_hull_that_stops_short_of_its_count_is_shrunk_where_it_stops(side, left):
    positions, faces, _ = normalised(joined(*(sphere(3, 0.3, (x, 0, 0)) for x in range(5))))
    hull = build_hull(positions, faces, 10, quiet, side)
    level, volume = int(hull.level_steps[0]), signed_volume(positions, faces)
    collapses = np.flatnonzero(hull.step_vertices[:, 1] != MOVE)
    last = int(collapses[collapses < level][-1])
    assert level - last > 5
    before, after = (
        abs(signed_volume(*replay_steps(positions, faces, hull.step_vertices, hull.step_positions, k)) / volume - 1.0)
        for k in (last + 1, level)
    )
    assert 0.9 * UNREACHED_EXCESS < before <= UNREACHED_EXCESS
    assert after < left * before
    assert abs(hull.volume_excess) == pytest.approx(after, abs=1e-9)


def test_components_and_genus_are_kept():
    mesh = joined(torus(24, 12), sphere(2, 0.3, (3.0, 0, 0)), torus(20, 10, 0.5, 0.1))
    positions, faces, hull = hull_of(mesh, 80)
    hp, hf = cut(positions, faces, hull, 80)

    def euler(v, f):
        return len(v) - len(build_edges(f).vertices) + len(f)

    assert euler(hp, hf) == euler(positions, faces)
    assert face_components(hf, len(hp))[1] == 3


def test_zero_area_faces_of_the_original_break_nothing():
    v, f = cube(6)
    v = v.copy()
    v[10] = v[f[np.any(f == 10, axis=1)][0]][0]  # a vertex slid onto its neighbour or left where it is
    needle = v[f[30]]
    v[f[30, 0]] = 0.5 * (needle[1] + needle[2])
    positions, faces, hull = hull_of((v, f), 40)
    assert_every_collapse_moves_outwards(positions, faces, hull)


def degenerate_meshes():
    v, f = sphere(2)
    heap = v.copy()
    heap[:80] = heap[0]
    cylinder = trimesh.creation.cylinder(1.0, 2.0, sections=700)
    return {
        "back to back": (np.array([[0, 0, 0], [1, 0, 0], [0, 1.0, 0]]), np.array([[0, 1, 2], [0, 2, 1]])),
        "flat": (v * (1, 1, 0), f),
        "nearly flat": (v * (1, 1, 1e-7), f),
        "nearly a line": (v * (1, 1e-6, 1e-6), f),
        "a line": (v * (1, 0, 0), f),
        "many vertices in one place": (heap, f),
        "on a coarse grid": (np.round(v * 3) / 3, f),
        "fans of 700 slivers": (np.asarray(cylinder.vertices), np.asarray(cylinder.faces)),
    }


@pytest.mark.parametrize("name", degenerate_meshes())
def test_degenerate_meshes_collapse_outwards_or_not_at_all(name):
    v, f = degenerate_meshes()[name]
    positions, faces, hull = hull_of((v, f.astype(np.int32)), 4)
    if len(faces) < 1000:
        assert_every_collapse_moves_outwards(positions, faces, hull)
    else:
        assert_sound(positions, faces, hull, 40)


def test_vertices_where_two_sheets_touch_are_left_alone():
    a, b = sphere(2), sphere(2, 1.0, (2.0, 0, 0))
    v, f = joined(a, b)
    east, west = int(np.argmax(a[0][:, 0])), len(a[0]) + int(np.argmin(b[0][:, 0]))
    f = np.where(f == west, east, f).astype(np.int32)
    positions, faces, hull = hull_of((v, f), 40)
    assert east not in hull.step_vertices
    assert_every_collapse_moves_outwards(positions, faces, hull)


def test_cutting_again_gives_the_same_hull_at_every_size():
    positions, faces, hull = hull_of(bumpy_sphere(3), 100)
    again = build_hull(positions, faces, 100, quiet)
    assert np.array_equal(again.step_positions, hull.step_positions)
    assert np.array_equal(cut(positions, faces, hull, 100)[0], hull.positions)
    level = replay_steps(positions, faces, hull.step_vertices, hull.step_positions, int(hull.level_steps[0]))
    assert np.array_equal(level[0], hull.positions)
    assert hull.level_faces.tolist() == [len(level[1])]
    volumes = [signed_volume(*cut(positions, faces, hull, n)) for n in range(len(faces), 20, -50)]
    assert np.all(np.diff(volumes) >= -1e-12)


def test_progress_never_falls_when_edges_are_costed_again(monkeypatch):
    monkeypatch.setattr("worker.hull._PIECE", 100)
    seen: list[float] = []
    positions, faces, _ = normalised(bumpy_sphere(4))
    hull = build_hull(positions, faces, 400, seen.append)
    assert np.any(hull.step_vertices[:, 1] == MOVE)
    assert seen == sorted(seen)


def test_progress_rises_to_one_and_cancelling_stops():
    positions, faces, _ = normalised(bumpy_sphere(5))
    seen: list[float] = []
    build_hull(positions, faces, 100, seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert len(seen) > 5

    def cancel(fraction: float) -> None:
        if fraction > 0.3:
            raise CancelledError("gone")

    with pytest.raises(CancelledError):
        build_hull(positions, faces, 100, cancel)


@pytest.mark.parametrize("name", ["sphere", "bumpy sphere", "torus", "cube"])
def test_an_inner_hull_is_enclosed_by_the_original(name):
    positions, faces, _ = normalised(MESHES[name])
    inner = build_hull(positions, faces, 120, quiet, side="inner")
    assert 4 <= len(inner.faces) <= 120
    build_edges(inner.faces)
    assert inner.volume_excess <= 0.0
    expected = signed_volume(inner.positions, inner.faces) / signed_volume(positions, faces) - 1.0
    assert inner.volume_excess == pytest.approx(expected, abs=1e-9)
    points = np.random.default_rng(2).uniform(-1, 1, (4000, 3))
    assert np.all(winding_numbers(inner.positions, inner.faces, points) <= winding_numbers(positions, faces, points) + 1e-6)
    cut_again = cut_hull(positions, faces, inner.step_vertices, inner.step_positions, 120)
    assert np.array_equal(cut_again[1], inner.faces)


def test_an_open_mesh_is_refused():
    v, f = sphere(1)
    positions, faces, _ = normalised((v, f[1:]))
    with pytest.raises(NotManifoldError):
        build_hull(positions, faces, 10, quiet)


def test_the_gain_on_a_sphere_is_near_that_of_the_best_polyhedron():
    # a ball in f equilateral triangles, each tangent at its middle: an excess of 2 pi / (sqrt(3) f)
    _, _, hull = hull_of(sphere(5), 320)
    assert hull.volume_excess < 3.0 * 2.0 * np.pi / (np.sqrt(3.0) * 320)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("name", "max_faces", "excess"),
    [
        ("bunny_closed.ply", 1000, 0.07),
        ("bunny_closed.ply", 500, 0.13),
        ("fandisk.ply", 500, 0.01),
        ("bones.ply", 1000, 0.2),
        ("trim-star.off", 1000, 0.02),
    ],
)
def test_real_meshes_are_enclosed_tightly(name, max_faces, excess):
    mesh = trimesh.load(shared(name), process=False, force="mesh")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    positions, faces, hull = hull_of((np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)), max_faces)
    assert len(hull.faces) <= max_faces
    assert hull.volume_excess < excess
    assert_sound(positions, faces, hull, max_faces, samples=3000)
