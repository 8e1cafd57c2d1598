"""Random closed meshes, most of them full of coplanar faces, seen from random places: what must hold for every mesh and every eye."""

from __future__ import annotations

from collections import Counter
from contextlib import nullcontext
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geometry.hull_sequence import replay_steps
from geometry.silhouettes import silhouette_scalar
from geometry.topology import build_edges
from schemas.errors import InvalidRequestError
from schemas.render import Camera
from service.camera import resolve_camera
from service.silhouette.contours import link_contours
from service.silhouette.coverage import coverage_mask
from service.silhouette.extract import SilhouetteTree
from service.silhouette.project import TOUCHING, project_edges, surrounding_layers
from tests import eye_cases, oracles
from tests.hard import fields
from tests.hard.examples import examples
from tests.hard.standing import UNIT, standpoints
from tests.oracles_hull import distance, points_outside, surface_points, winding_numbers
from tests.oracles_integer import Facing
from tests.rays import layers
from tests.service.render.made import grown, quiet
from worker.hull import build_hull

WIDTH, HEIGHT = 14, 11
UNDECIDED_PX = 1e-6
"""A pixel's middle so near to an edge of the silhouette is on neither side of it."""


def body(rng):
    """A sphere, box or torus, often with its middle and faces on nodes of the grid."""
    p = fields.grid()
    centre = rng.integers(-3, 4, 3) / 16.0 if rng.random() < 0.6 else rng.uniform(-0.2, 0.2, 3)
    kind = rng.integers(3)
    if kind == 0:
        return fields.sphere(p, centre, rng.uniform(0.15, 0.4))
    if kind == 1:
        return fields.box(p, centre, rng.integers(2, 7, 3) / 16.0 - 1e-3 * rng.integers(2))
    return fields.torus(p, centre, rng.uniform(0.2, 0.3), rng.uniform(0.08, 0.15), int(rng.integers(3)))


def solid(rng):
    """Unions, intersections and differences of bodies, one after the other."""
    made = body(rng)
    for _ in range(rng.integers(4)):
        other = body(rng)
        made = [np.minimum(made, other), np.maximum(made, other), np.maximum(made, -other)][rng.integers(3)]
    return made


@lru_cache(16)
def made(seed, parts):
    """(positions, faces) of a random field; without faces when it has no inside."""
    rng = np.random.default_rng(seed)
    return fields.marched(solid(rng) if seed % 4 else fields.waves(fields.grid(), rng, rng.uniform(-0.2, 0.3)), parts)


random_meshes = (
    st.tuples(st.integers(0, 10**6), st.sampled_from([None, 2, 4, 4, 8])).map(lambda drawn: made(*drawn)).filter(lambda m: len(m[1]))
)


def eyes_about(mesh):
    """Eyes anywhere and on the grid, and where the mesh itself makes signs zero."""
    return st.one_of(eye_cases.strategy(), st.sampled_from(list(standpoints(*mesh).values())), _on(mesh))


def _on(mesh):
    """Exact combinations of a face's corners: in its plane, along its edges, at its corners."""
    corners = mesh[0][mesh[1]].astype(np.float64)
    weights = st.tuples(st.integers(-4, 8), st.integers(-4, 8)).map(lambda w: np.array([4 - w[0] - w[1], *w]) / 4.0)
    return st.builds(lambda f, w: np.append(w @ corners[f], 1.0), st.integers(0, len(corners) - 1), weights)


def tree_of(positions, faces):
    edges = build_edges(faces)
    mesh = {"positions": positions, "faces": faces, "edge_vertices": edges.vertices, "edge_faces": edges.faces}
    return SilhouetteTree(mesh, grown(positions, faces, edges))


@examples(25)
@given(random_meshes)
def test_marched_meshes_are_closed_and_right_side_out(mesh):
    positions, faces = mesh
    assert len(np.unique(positions, axis=0)) == len(positions)
    assert len(build_edges(faces).vertices) * 2 == len(faces) * 3
    corners = positions[faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.linalg.norm(normals, axis=1) > 0.0).all()
    some = np.arange(0, len(faces), max(1, len(faces) // 20))
    middle, step = corners[some].mean(axis=1), 1e-4 * normals[some] / np.linalg.norm(normals[some], axis=1, keepdims=True)
    assert np.allclose(winding_numbers(positions, faces, middle - step), 1.0, atol=1e-3)
    assert np.allclose(winding_numbers(positions, faces, middle + step), 0.0, atol=1e-3)


@examples(12)
@given(random_meshes, st.data())
def test_tree_brute_force_and_whole_numbers_agree_and_contours_close(mesh, data):
    positions, faces = mesh
    tree, facing = tree_of(positions, faces), Facing(positions, faces)
    for _ in range(6):
        eye = data.draw(eyes_about(mesh))
        expected = oracles.silhouette_of(facing.front(eye), faces)
        edges = tree.extract(eye).edges
        assert oracles.edge_set(edges) == expected
        assert oracles.edge_set(silhouette_scalar(positions, faces, tree.edge_vertices, tree.edge_faces, eye)) == expected
        assert Counter(edges[:, 0].tolist()) == Counter(edges[:, 1].tolist())
        loops = link_contours(edges)
        around = [(int(a), int(b)) for begin, end in pairwise(loops.offsets) for a, b in _steps(loops.vertices[begin:end])]
        assert sorted(around) == sorted(expected)


def _steps(loop):
    return zip(loop, np.roll(loop, -1), strict=True)


@examples(10)
@given(random_meshes, st.integers(0, 10**6))
def test_hulls_enclose_the_mesh_and_each_other_as_far_as_nothing_is_moved_back(mesh, seed):
    positions, faces = mesh
    hull = build_hull(positions, faces, max(8, len(faces) // 8), quiet)
    rng = np.random.default_rng(seed)
    collapsed = (hull.step_vertices >= 0).all(axis=1)
    cuts = np.sort(rng.integers(0, len(collapsed) + 1, 3))
    levels = [(positions, faces, 0), *((*replay_steps(positions, faces, hull.step_vertices, hull.step_positions, n), n) for n in cuts)]
    for p, f, _ in [*levels, (hull.positions, hull.faces, 0)]:
        build_edges(f)
        assert not points_outside(p, f, positions).any()
        assert not points_outside(p, f, surface_points(positions, faces, 300, seed)).any()
    for (p, f, n), (q, g, m) in pairwise(levels):
        if collapsed[n:m].all():
            assert not points_outside(q, g, np.concatenate([p, surface_points(p, f, 200, seed)])).any()


def seen(mesh, eye, rng):
    """A view through this eye that looks about where the mesh is, at a slant to all that is regular."""
    slant = rng.normal(size=3)
    distance = float(np.linalg.norm(eye[:3]))
    if eye[3] == 0.0:
        camera = Camera(eye=list(eye[:3] / distance), up=list(slant), projection="orthographic", height=rng.uniform(0.4, 1.8))
    else:
        target = rng.uniform(-0.3, 0.3, 3) * min(1.0, 1e6 / max(distance, 1.0))
        fov = rng.uniform(40.0, 120.0) if distance < 2.0 else float(np.degrees(2.0 * np.arctan(rng.uniform(0.3, 0.9) / distance)))
        camera = Camera(eye=list(eye[:3]), target=list(target), up=list(slant), fov_y_deg=fov)
    return resolve_camera(camera, UNIT, WIDTH, HEIGHT)


def windings(segments, width, height):
    """(winding number, distance to the nearest segment), (h, w) each, of the middles of pixels: from the segments alone."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    a, b = segments[:, None, None, :2], segments[:, None, None, 2:]
    crossed = (a[..., 1] <= y) != (b[..., 1] <= y)
    run = np.where(b[..., 1] != a[..., 1], b[..., 1] - a[..., 1], 1.0)
    left = a[..., 0] + (y - a[..., 1]) * ((b[..., 0] - a[..., 0]) / run) < x
    number = (crossed & left) * np.sign(b[..., 1] - a[..., 1])
    along = b - a
    t = ((x - a[..., 0]) * along[..., 0] + (y - a[..., 1]) * along[..., 1]) / np.maximum((along**2).sum(axis=-1), 1e-300)
    t = np.clip(t, 0.0, 1.0)
    away = np.hypot(a[..., 0] + t * along[..., 0] - x, a[..., 1] + t * along[..., 1] - y)
    return number.sum(axis=0).astype(int), away.min(axis=0, initial=np.inf)


@examples(40)
@given(random_meshes, st.data(), st.integers(0, 10**6))
def test_winding_number_of_the_silhouette_is_the_number_of_front_layers(mesh, data, seed):
    positions, faces = mesh
    edges = build_edges(faces)
    for n in range(4):
        eye = data.draw(eyes_about(mesh).filter(lambda e: np.linalg.norm(e[:3]) < 1e15 and np.linalg.norm(e[:3]) > 1e-6))
        view = seen(mesh, eye, np.random.default_rng([seed, n]))
        segments = project_edges(view, positions, silhouette_scalar(positions, faces, edges.vertices, edges.faces, view.eye))
        base = 0
        if eye[3] and np.linalg.norm(eye[:3]) < 1.0:
            on_it = distance(positions.astype(np.float64), faces, *view.eye[:3]) <= TOUCHING
            with pytest.raises(InvalidRequestError) if on_it else nullcontext():
                base = surrounding_layers(view, positions, faces, segments)
            if on_it:
                continue
        number, away = windings(segments, WIDTH, HEIGHT)
        front, _ = layers(view, positions, faces)
        decided = away > UNDECIDED_PX
        assert np.array_equal((number + base)[decided], front[decided])
        mask = coverage_mask(segments, WIDTH, HEIGHT, base=base).mask
        whole = away > np.sqrt(0.5)
        assert np.array_equal(mask[whole], np.where(front[whole] > 0, 255, 0))
