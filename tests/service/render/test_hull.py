"""The hull drawn on the CPU against the same hull drawn by the GL, and against brute force."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from schemas.render import Accuracy, Camera, Orbit, OrbitCamera, RenderRequest, Shading
from service.camera import resolve_camera
from service.kernels.hull_bands import place_hull
from service.kernels.hull_rim import LEAST_HALF_WIDTH, draw_rim
from service.kernels.hull_visible import EMPTY, FACE_MASK, PLANES, SLACK, draw_faces
from service.render.bands import palette
from service.render.frame import render_view
from service.render.hull_cache import HullCache, hull_surface
from service.scene.place import own_view, place
from tests.service.render.conftest import VIEWS
from tests.service.render.made import SHAPES, clippable, prepared

BESIDE = {"eye": [1.42, 0.0, 0.1], "target": [1.2, 1.0, 0.0], "fov_y_deg": 100}
"""A part of the torus is behind this eye."""


@cache
def colored():
    mesh = SHAPES["sphere"]()
    corners = mesh[0][mesh[1]]
    color = np.concatenate([255 * (corners * 0.4 + 0.5).clip(0, 1), np.full((*corners.shape[:2], 1), 255)], axis=2)
    return prepared("many colours", mesh, 200, {"corner_color": color.astype(np.uint8)})


@pytest.mark.parametrize("mode", ["lambert", "normal"])
@pytest.mark.parametrize(
    ("name", "view"), [(name, view) for name in ("torus", "knot", "colored") for view in VIEWS] + [("torus", "beside")]
)
def test_colours_are_those_that_the_gl_gives(draw, name, mode, view):
    asset = colored() if name == "colored" else name
    camera = VIEWS.get(view, BESIDE)
    ours, gl = (draw(asset, "clipped", rung, shading={"mode": mode}, camera=camera).pixels for rung in ("coverage", "none"))
    both = (ours[:, :, 3] == 255) & (gl[:, :, 3] == 255)
    off = np.abs(ours.astype(int) - gl)[both].max(axis=1)
    assert both.sum() > 1000
    assert (off > 2).sum() <= 3  # pixels whose centre lies on the border of two faces


@pytest.mark.parametrize("mode", ["lambert", "normal"])
def test_colours_of_a_mesh_placed_askew_are_those_that_the_gl_gives(gpu, mode):
    asset = clippable("bumpy")
    askew = np.array([[1.0, 0.5, 0.0, 2.0], [0.0, -2.0, 0.3, -1.0], [0.4, 0.0, 0.7, 0.5], [0.0, 0.0, 0.0, 1.0]])
    placement = place(asset, askew, "")
    view = own_view(asset, placement, OrbitCamera(orbit=Orbit(azimuth_deg=30.0)), (128, 128), placement.frame)
    assert view.mirrored
    ours, gl = (
        render_view(gpu, asset, RenderRequest(accuracy=Accuracy(antialias=rung), shading=Shading(mode=mode)), view).pixels
        for rung in ("coverage", "none")
    )
    both = (ours[:, :, 3] == 255) & (gl[:, :, 3] == 255)
    off = np.abs(ours.astype(int) - gl)[both].max(axis=1)
    assert both.sum() > 1000
    assert (off > 2).sum() <= 3


def camera_points(asset, camera, width, height):
    """(v, 4) u, v, z, w of the hull's vertices, straight from the matrix, and the matrix that makes them."""
    view = resolve_camera(Camera(**camera), asset.frame, width, height, asset.radius)
    m = view.matrix
    matrix = np.stack([(m[0] + m[3]) * 0.5 * width, (m[3] - m[1]) * 0.5 * height, m[2], m[3]])
    positions = asset.hull["positions"].astype(np.float64)
    return np.column_stack([positions, np.ones(len(positions))]) @ matrix.T, matrix


def drawn(surface, matrix, width, height, half=None):
    """(planes, front, words) of the hull in an image of this size, drawn in bands of 23 rows; with the rim when it has a width."""
    faces, edges = len(surface.faces), len(surface.edge_faces)
    points, front = np.empty((len(surface.positions), 4)), np.empty(faces, bool)
    seen, rows, ends, places = np.empty(faces, np.int32), np.empty((faces, 2), np.int32), np.empty((edges, 4)), np.empty((edges, 4))
    mesh = (surface.positions, surface.faces, surface.uv, surface.edge_vertices, surface.edge_faces)
    shown, around = place_hull(matrix, mesh, 1.0, 0, height, points, front, seen, rows, ends, places)
    planes, words = np.full((faces + edges, PLANES), np.nan), np.empty((height, width + SLACK), np.int64)
    for top in range(0, height, 23):
        end = min(top + 23, height)
        band, own = words[top:end], np.full((faces + edges, PLANES), np.nan)
        draw_faces(points, surface.faces, surface.uv, 1.0, seen[:shown], rows[:shown], 0, top, width, end, band, own)
        if half is not None:
            draw_rim(ends[:around], places[:around], half, faces, 0, top, width, end, band, own)
        planes = np.where(np.isnan(planes), own, planes)
    return planes, front, words


def seen_faces(points, faces, width, height):
    """(h, w) front face that each pixel's centre shows, -1 for none, -2 where it is too close to tell."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    centres = np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    nearest, seen, close = np.full(x.size, 2.0), np.full(x.size, -1), np.zeros(x.size, bool)
    for f, corners in enumerate(faces):
        p = points[corners]
        if np.linalg.det(p[:, [0, 1, 3]]) >= 0.0:  # rows run down: a front face turns the other way
            continue
        part = np.linalg.solve(p[:, [0, 1, 3]].T, centres)  # barycentric coordinates over w
        depth = p[:, 2] @ part
        size = np.abs(part).max(axis=0)
        inside, edge = (part >= 0.0).all(axis=0), (np.abs(part) < 1e-9 * size).any(axis=0)
        inside &= depth >= -1.0
        close |= (edge & (part >= -1e-9 * size).all(axis=0)) | (inside & (np.abs(depth - nearest) < 1e-9))
        seen[inside & (depth < nearest)] = f
        nearest = np.where(inside, np.minimum(nearest, depth), nearest)
    seen[close] = -2
    return seen.reshape(height, width)


@pytest.mark.parametrize(
    "camera",
    [
        {"eye": [2.0, 1.5, 2.5]},
        {"eye": [3, 2, 4], "projection": "orthographic", "height": 1.6},
        BESIDE,
        {"eye": [0.3, 0.2, 0.1], "target": [1.0, 0.4, 0.0], "fov_y_deg": 120},
    ],
)
@pytest.mark.parametrize("name", ["torus", "joined"])
def test_each_pixel_shows_the_nearest_front_face(name, camera):
    asset = clippable(name)
    points, matrix = camera_points(asset, camera, 61, 47)
    _, _, words = drawn(hull_surface(asset.hulls[0]), matrix, 61, 47)
    shown = np.where(words[:, :61] == EMPTY, -1, words[:, :61] & FACE_MASK)
    expected = seen_faces(points, asset.hull["faces"], 61, 47)
    sure = expected != -2
    assert (expected >= 0).sum() > 100
    assert (~sure).sum() < 10
    assert np.array_equal(shown[sure], expected[sure])


def test_planes_find_the_place_in_the_map_of_every_pixel():
    asset = clippable("knot")
    points, matrix = camera_points(asset, {"eye": [2.0, 1.5, 2.5], "fov_y_deg": 70}, 80, 60)
    surface = hull_surface(asset.hulls[0])
    planes, _, words = drawn(surface, matrix, 80, 60)
    rows, columns = np.nonzero(words[:, :80] != EMPTY)
    for row, column in list(zip(rows, columns, strict=True))[::37]:
        f = words[row, column] & FACE_MASK
        part = np.linalg.solve(points[surface.faces[f]][:, [0, 1, 3]].T, [column + 0.5, row + 0.5, 1.0])
        expected = part @ surface.uv[f] / part.sum()
        u, v, w = planes[f].reshape(3, 3) @ [column + 0.5, row + 0.5, 1.0]
        assert np.allclose((u / w, v / w), expected, atol=1e-6)


@pytest.mark.parametrize("half", [LEAST_HALF_WIDTH, 7.5])
def test_rim_reaches_every_pixel_beside_an_outline_edge_from_the_nearest_one(half):
    asset = clippable("torus")
    points, matrix = camera_points(asset, {"eye": [2.0, 1.5, 2.5], "fov_y_deg": 60}, 70, 60)
    surface = hull_surface(asset.hulls[0])
    _, front, before = drawn(surface, matrix, 70, 60)
    _, _, words = drawn(surface, matrix, 70, 60, half)
    edges = surface.edge_vertices[front[surface.edge_faces[:, 0]] != front[surface.edge_faces[:, 1]]]
    ends = (points[:, :2] / points[:, 3:])[edges]
    y, x = np.nonzero(before[:, :70] == EMPTY)
    centres = np.column_stack([x, y]) + 0.5
    along = ends[:, 1] - ends[:, 0]
    t = ((centres[:, None] - ends[None, :, 0]) * along).sum(axis=2) / (along**2).sum(axis=1)
    away = np.linalg.norm(centres[:, None] - ends[:, 0] - t.clip(0, 1)[:, :, None] * along, axis=2)
    number = (words[:, :70] & FACE_MASK)[y, x]
    reached = away.min(axis=1) < half - 1e-6
    assert reached.sum() > 100
    assert np.array_equal(number != FACE_MASK, away.min(axis=1) <= half)
    chosen = number[reached] - len(surface.faces)
    assert np.allclose(away[reached, chosen], away[reached].min(axis=1), atol=1e-4)
    assert np.array_equal(words[:, :70][before[:, :70] != EMPTY], before[:, :70][before[:, :70] != EMPTY])


@pytest.mark.parametrize("half", [LEAST_HALF_WIDTH, 7.5])
def test_places_on_the_rim_lie_between_the_ends_of_their_edge(half):
    asset = clippable("torus")
    _, matrix = camera_points(asset, {"eye": [2.0, 1.5, 2.5], "fov_y_deg": 60}, 70, 60)
    surface = hull_surface(asset.hulls[0])
    planes, front, words = drawn(surface, matrix, 70, 60, half)
    number = words[:, :70] & FACE_MASK
    beside = front[surface.edge_faces]
    outline = np.flatnonzero(beside[:, 0] != beside[:, 1])
    rows, columns = np.nonzero((number >= len(surface.faces)) & (number != FACE_MASK))
    assert len(rows) > 100
    for row, column in zip(rows, columns, strict=True):
        e = outline[number[row, column] - len(surface.faces)]
        f = surface.edge_faces[e][beside[e]][0]
        a, b = (surface.uv[f][surface.faces[f] == v][0] for v in surface.edge_vertices[e])
        u, v, w = planes[number[row, column]].reshape(3, 3) @ [column + 0.5, row + 0.5, 1.0]
        assert w == 1.0
        low, high = np.minimum(a, b) - 1e-4, np.maximum(a, b) + 1e-4
        assert (low <= (u, v)).all()
        assert ((u, v) <= high).all()


def test_table_of_colours_is_within_a_level_of_exact():
    levels = palette((200, 100, 3)).view(np.uint8).reshape(-1, 4)
    light = np.linspace(0.0, 1.0, 50_001)
    base = np.array([200, 100, 3]) / 255.0
    linear = np.where(base <= 0.04045, base / 12.92, ((base + 0.055) / 1.055) ** 2.4) * light[:, None]
    exact = 255.0 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    shown = levels[np.floor(light * (len(levels) - 1) + 0.5).astype(int), :3]
    assert np.abs(shown - exact).max() < 1.0


def test_hulls_are_kept_within_their_bytes():
    cache = HullCache(1)
    for name in ("sphere", "torus", "knot"):
        assert cache.get(clippable(name)) is cache.get(clippable(name))
    assert len(cache) == 1
    cache = HullCache(64)
    for name in ("sphere", "torus", "knot"):
        cache.get(clippable(name))
    assert len(cache) == 3
    assert cache.nbytes <= 64 << 20
