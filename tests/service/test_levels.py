"""Levels in views: the promise in pixels holds, the coarsest that keeps it is taken, and nothing is taken where none can be promised."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from geometry.topology import build_edges
from schemas.conventions import Frame
from schemas.errors import InvalidRequestError
from schemas.mesh import Capability
from schemas.render import Camera, Orbit, OrbitCamera, ProjectTo, SilhouetteRequest
from service.assets import MeshAsset
from service.camera import project, resolve_camera, to_pixels
from service.silhouette.coverage import coverage_mask
from service.silhouette.describe import describe_silhouette
from service.silhouette.document import silhouette_json
from service.silhouette.levels import SilhouetteLevel, choose_level, projected_px, rounded_up
from service.silhouette.project import project_edges
from tests.meshes import bumpy_sphere, knot, normalised
from worker.hull import build_hull
from worker.levels import build_levels

FRAME = Frame((0.0, 0.0, 0.0), 1.0)
SIDE = 96


def quiet(_):
    pass


def asset_of(mesh, hull_faces=150):
    positions, faces, _ = normalised(mesh)
    hull = build_hull(positions, faces, hull_faces, quiet)
    made = build_levels(positions, faces, (hull.step_vertices, hull.step_positions), len(hull.faces), quiet)
    edges = build_edges(faces)
    levels = tuple(SilhouetteLevel(level.tensors(), level.tree.tensors()) for level in made)
    return MeshAsset(
        id="1" * 32,
        frame=FRAME,
        positions=positions,
        faces=faces,
        normals=positions,
        appearance=None,
        edges=(edges.vertices, edges.faces),
        hull={"positions": hull.positions, "faces": hull.faces, "normals": hull.positions},
        maps=None,
        tree=None,
        clip=Capability(available=True),
        levels=levels,
    )


@pytest.fixture(scope="module", params=[bumpy_sphere(4), knot(100, 16)], ids=["bumpy", "knot"])
def asset(request):
    return asset_of(request.param)


def camera(kind, direction, distance, fov):
    eye = [float(x) * distance for x in direction]
    if kind == "orthographic":
        return Camera(eye=eye, projection="orthographic", height=3.0 * fov / 45.0)
    return Camera(eye=eye, target=[0.3 * d for d in (direction[1], direction[2], direction[0])], fov_y_deg=fov)


directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: np.linalg.norm(d) > 0.1 and np.hypot(d[0], d[2]) > 0.05)


@settings(max_examples=150, deadline=None)
@given(
    kind=st.sampled_from(["perspective", "orthographic"]),
    direction=directions,
    distance=st.floats(1.2, 30.0),
    fov=st.floats(5.0, 140.0),
    bound=st.sampled_from([1e-4, 0.01, 0.3]),
    seed=st.integers(0, 2**32 - 1),
)
def test_points_within_the_bound_are_within_the_promise_in_the_image(kind, direction, distance, fov, bound, seed):
    view = resolve_camera(camera(kind, np.array(direction) / np.linalg.norm(direction), distance, fov), FRAME, 200, 120)
    low, high = np.array([-0.6, -0.5, -0.4]), np.array([0.6, 0.4, 0.5])
    corners = np.array([[high[k] if i >> k & 1 else low[k] for k in range(3)] for i in range(8)])
    promised = projected_px(view, corners, bound)
    assume(np.isfinite(promised))
    rng = np.random.default_rng(seed)
    inside = np.concatenate([corners, rng.uniform(low, high, (2000, 3))])
    away = rng.normal(size=inside.shape)
    moved = inside + bound * away / np.linalg.norm(away, axis=1, keepdims=True)
    here, there = to_pixels(view, project(view, inside)), to_pixels(view, project(view, moved))
    seen = np.all((there >= 0.0) & (there <= [200.0, 120.0]), axis=1)
    assert np.isfinite(there).all()
    assert (np.linalg.norm(here - there, axis=1)[seen] <= promised).all()


@pytest.mark.parametrize("distance", [0.2, 0.6, 0.9])
def test_nothing_is_promised_of_what_comes_near_the_eye_plane(distance):
    corners = np.array([[0.6 if i >> k & 1 else -0.6 for k in range(3)] for i in range(8)])
    view = resolve_camera(Camera(eye=[0.0, 0.0, distance]), FRAME, 100, 100)
    assert np.isfinite(projected_px(view, corners, 0.05)) == (distance == 0.9)
    assert not np.isfinite(projected_px(view, corners, 0.31))


def test_the_promise_is_exact_for_an_orthographic_camera():
    corners = np.array([[0.6 if i >> k & 1 else -0.6 for k in range(3)] for i in range(8)])
    view = resolve_camera(Camera(eye=[1.0, 2.0, 3.0], projection="orthographic", height=4.0), FRAME, 300, 200)
    assert projected_px(view, corners, 0.1) == pytest.approx(0.1 * 200 / 4.0, rel=1e-6)


def shape(view, positions, edges):
    return coverage_mask(project_edges(view, positions, edges), view.width, view.height).mask


def exact_edges(asset, view):
    return describe_silhouette(asset, SilhouetteRequest(camera=VIEWS[view], project=ProjectTo(width=SIDE, height=SIDE))).edges


VIEWS = [
    OrbitCamera(orbit=Orbit(azimuth_deg=30.0, elevation_deg=20.0)),
    OrbitCamera(orbit=Orbit(azimuth_deg=200.0, elevation_deg=-50.0, distance=1.7, fov_y_deg=70.0)),
    Camera(eye=[0.5, 3.0, 1.0], projection="orthographic", height=2.2),
    Camera(eye=[0.4, 0.3, 8.0], target=[0.2, 0.1, 0.0], fov_y_deg=12.0),
]


@pytest.mark.parametrize("camera", range(len(VIEWS)))
def test_the_levels_shape_holds_the_meshes_and_is_beyond_it_by_no_more_than_promised(asset, camera):
    view = resolve_camera(VIEWS[camera], FRAME, SIDE, SIDE)
    own = shape(view, asset.positions, exact_edges(asset, camera))
    rows, columns = np.nonzero(own)
    for level in asset.levels:
        error_px = projected_px(view, asset.corners, level.bound)
        assert np.isfinite(error_px)
        other = shape(view, level.positions, level.tree.extract(view.eye).edges)
        assert (other.astype(int) - own >= -1).all()  # of 255
        for y, x in zip(*np.nonzero((other > 0) & (own == 0)), strict=True):
            # a point of this pixel is within error_px of a point of one of those, however the points lie in them
            gap = np.hypot(np.maximum(np.abs(rows - y) - 1, 0), np.maximum(np.abs(columns - x) - 1, 0)).min()
            assert gap <= error_px


def test_the_coarsest_level_that_keeps_the_promise_is_taken(asset):
    view = resolve_camera(VIEWS[0], FRAME, SIDE, SIDE)
    errors = {len(level.faces): projected_px(view, asset.corners, level.bound) for level in asset.levels}
    for most_px in [1e-9, *(error * factor for error in errors.values() for factor in (0.999, 1.0))]:
        chosen = choose_level(asset.levels, view, asset.corners, most_px)
        keep = [faces for faces, error in errors.items() if error <= most_px]
        assert (chosen is None) == (not keep)
        if chosen is not None:
            assert len(chosen.level.faces) == min(keep)
            assert chosen.error_px == errors[min(keep)]


def described(asset, **fields):
    return describe_silhouette(asset, SilhouetteRequest(camera=VIEWS[0], project=ProjectTo(width=SIDE, height=SIDE), **fields))


def test_a_silhouette_within_an_error_is_the_levels_and_says_so(asset):
    found = described(asset, max_error_px=1e3)
    level = asset.levels[-1]
    assert found.level.level is level and found.faces == len(level.faces)
    assert len(found.edges) < len(described(asset).edges)
    assert set(map(tuple, found.edges)) == set(map(tuple, level.tree.extract(resolve_camera(VIEWS[0], FRAME, SIDE, SIDE).eye).edges))
    assert np.array_equal(found.positions, level.positions[found.vertices].astype(np.float64))
    assert b'"surface":{"level":true,"faces":%d' % len(level.faces) in silhouette_json(found)


def test_without_an_error_and_with_one_too_small_the_silhouette_is_the_meshes(asset):
    exact, strict = described(asset), described(asset, max_error_px=1e-9)
    assert exact.level is None and strict.level is None
    assert np.array_equal(exact.edges, strict.edges)
    assert b'"surface":{"level":false,"faces":%d,"error_px":0.0}' % len(asset.faces) in silhouette_json(strict)


def test_an_error_needs_an_image_and_no_curves(asset):
    with pytest.raises(InvalidRequestError) as refused:
        describe_silhouette(asset, SilhouetteRequest(max_error_px=1.0))
    assert refused.value.where["field"] == "max_error_px"
    with pytest.raises(InvalidRequestError):
        described(asset, max_error_px=1.0, smooth=True)


@pytest.mark.parametrize("value", [0.1, 1 / 3, 0.123456789, 1e-7, 12345.678, 2.0])
def test_rounded_bounds_are_not_less(value):
    assert value <= float(rounded_up(value)) <= value * 1.00002
