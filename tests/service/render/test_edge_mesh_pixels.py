"""Where lines of the edge mesh are in pictures, against exact silhouettes and rays to their points through every face."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, map_coordinates

from schemas.render import Shading
from service.camera import project, to_pixels
from service.render.edge_mesh import find_edges
from tests import meshes
from tests.service.oracles import silhouette
from tests.service.render.conftest import VIEWS
from tests.service.render.lined import WHITE, along_edges, asset_of, hidden, inked

SHAPES = {
    "sphere": lambda: meshes.sphere(3),
    "torus": lambda: meshes.torus(40, 20),
    "knot": lambda: meshes.knot(120, 12),
    "bumpy": lambda: meshes.bumpy_sphere(3, 0.5),
    "cube": lambda: meshes.cube(2),
    "blocks": lambda: around_origin(meshes.blocks((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))),
}
SEEN = [("sphere", "close"), ("sphere", "cropped"), ("torus", "orbit"), ("torus", "cropped"), ("torus", "orthographic"), ("knot", "above")]
SEEN += [("knot", "close"), ("bumpy", "orbit"), ("bumpy", "orthographic"), ("bumpy", "cropped"), ("cube", "orbit"), ("blocks", "above")]
"""Shapes and views; all of each shape is before the eye."""
SILHOUETTE = {"silhouette": {"width": 1.5}}
NEIGHBOURS = [(x, y) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]


def around_origin(mesh):
    return (mesh[0] - mesh[0].mean(axis=0)) * 0.7, mesh[1]


def silhouette_points(asset, view, step=0.7):
    """Points of the exact silhouette that lie in the picture, in space and in pixels, and the edge of each."""
    return points_in_picture(asset, view, silhouette(asset.positions, asset.faces, view.eye), step)


def points_in_picture(asset, view, ends, step):
    """The same of edges (e, 2)."""
    points, edge, _ = along_edges(view, asset.positions, ends, step)
    pixels = to_pixels(view, project(view, points))
    inside = np.all((pixels > 0.0) & (pixels < [view.width, view.height]), axis=1)
    return points[inside], pixels[inside], ends[edge[inside]]


def distances_to(pixels, shape, fine=8):
    """(h, w) f8: distance in pixels of each pixel's centre to the nearest of the points (n, 2)."""
    grid = np.ones((shape[0] * fine, shape[1] * fine), bool)
    at = np.floor(pixels * fine).astype(int)
    grid[at[:, 1], at[:, 0]] = False
    return distance_transform_edt(grid)[fine // 2 :: fine, fine // 2 :: fine] / fine


@pytest.mark.parametrize(("name", "view"), SEEN)
def test_silhouette_pixels_are_those_of_the_exact_silhouette(draw_lines, name, view):
    asset = asset_of(SHAPES[name](), name)
    lined = draw_lines(asset, SILHOUETTE, camera=VIEWS[view])
    ink = inked(lined.pixels)
    points, pixels, _ = silhouette_points(asset, lined.view)
    certain = ~hidden(lined.view, asset.positions, asset.faces, points)
    maybe = certain.copy()
    for shift in NEIGHBOURS:
        maybe[~maybe] = ~hidden(lined.view, asset.positions, asset.faces, points[~maybe], shift)
    explained = distances_to(pixels[maybe], ink.shape)[ink] <= 0.75 + 1.0
    assert explained.mean() >= 0.995
    assert certain.sum() > 0.6 * maybe.sum() > 50
    to_ink = distance_transform_edt(~ink)
    missed = to_ink[tuple(np.floor(pixels[certain]).astype(int).T[::-1])] > 1.0
    assert missed.mean() <= 0.005


@pytest.mark.parametrize("view", ["orbit", "close", "orthographic"])
def test_concave_folds_are_drawn_where_a_surface_crosses_itself(draw_lines, view):
    """A prism over a quadrilateral that crosses itself: one half is inside out, and its outline is of edges that are concave."""
    profile = np.array([[-1.0, -1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, 1.0]])
    vertices = np.concatenate([np.column_stack([profile, np.full(4, z)]) for z in (-1.0, 1.0)])
    sides = [[[i, j, j + 4], [i, j + 4, i + 4]] for i, j in ((k, (k + 1) % 4) for k in range(4))]
    caps = np.array([[0, 1, 2], [0, 2, 3]])
    asset = asset_of((vertices, np.concatenate([caps[:, ::-1], caps + 4, np.array(sides).reshape(-1, 3)]).astype(np.int32)), "hourglass")
    lined = draw_lines(asset, SILHOUETTE, camera=VIEWS[view])
    edges = find_edges(asset.positions, asset.faces, asset.edges)
    points, pixels, ends = silhouette_points(asset, lined.view)
    concave = {frozenset(e) for e in edges.vertices[edges.angles < 0.0, 1:3].tolist()}
    folded = np.array([frozenset(e) in concave for e in ends.tolist()]) & ~hidden(lined.view, asset.positions, asset.faces, points)
    assert folded.sum() > 30
    to_ink = distance_transform_edt(~inked(lined.pixels))
    assert (to_ink[tuple(np.floor(pixels[folded]).astype(int).T[::-1])] <= 1.0).mean() >= 0.995


@pytest.mark.parametrize("kind", ["ridge", "valley"])
@pytest.mark.parametrize(("name", "view"), [("blocks", "orbit"), ("blocks", "close"), ("bumpy", "orbit"), ("bumpy", "orthographic")])
def test_creases_are_drawn_where_they_are_seen_and_nowhere_else(draw_lines, name, view, kind):
    asset = asset_of(SHAPES[name](), name)
    lined = draw_lines(asset, {kind: {"width": 1.5}, "silhouette": None, f"{kind}_deg": 20.0}, camera=VIEWS[view])
    ink = inked(lined.pixels)
    edges = find_edges(asset.positions, asset.faces, asset.edges)
    folded = edges.angles > 20.0 if kind == "ridge" else edges.angles < -20.0
    points, pixels, _ = points_in_picture(asset, lined.view, edges.vertices[folded, 1:3], 0.7)
    seen = ~hidden(lined.view, asset.positions, asset.faces, points)
    maybe = seen.copy()
    for shift in NEIGHBOURS:
        maybe[~maybe] = ~hidden(lined.view, asset.positions, asset.faces, points[~maybe], shift)
    assert seen.sum() > 30
    assert (distances_to(pixels[maybe], ink.shape)[ink] <= 0.75 + 1.0).mean() >= 0.995
    assert (distance_transform_edt(~ink)[tuple(np.floor(pixels[seen]).astype(int).T[::-1])] <= 1.0).mean() >= 0.995


@pytest.mark.parametrize("width", [1.0, 2.5, 6.0])
@pytest.mark.parametrize(("name", "antialias"), [("sphere", "msaa"), ("torus", "msaa"), ("torus", "ssaa"), ("knot", "ssaa")])
def test_strokes_are_as_wide_as_asked(draw_lines, name, antialias, width):
    asset = asset_of(SHAPES[name](), name)
    lined = draw_lines(asset, {"silhouette": {"width": width}}, antialias=antialias, size=(300, 300), camera=VIEWS["above"])
    ink = 1.0 - (lined.pixels[:, :, 0] / 255.0) ** 2.2
    points, pixels, ends = silhouette_points(asset, lined.view, step=1.5)
    a, b = (to_pixels(lined.view, project(lined.view, asset.positions[ends[:, k]])) for k in (0, 1))
    length = np.linalg.norm(b - a, axis=1)
    normal = np.column_stack([a[:, 1] - b[:, 1], b[:, 0] - a[:, 0]]) / length[:, None]
    seen = ~hidden(lined.view, asset.positions, asset.faces, points)
    from_other = pixels[None] - pixels[:, None]
    beside = np.abs(np.einsum("ijk,ik->ij", from_other, normal))
    along = np.sqrt(np.maximum((from_other**2).sum(axis=2) - beside**2, 0.0))
    alone = ~np.any((along < 2.0) & (beside > 1.0) & (beside < 1.5 * width + 4.0), axis=1)
    clear = seen & alone & (length > 2.0) & np.all((pixels > width + 6.0) & (pixels < 294.0 - width), axis=1)
    rng = np.random.default_rng(0)
    chosen = rng.permutation(np.flatnonzero(clear))[:300]
    assert len(chosen) > 100
    across = np.arange(-width / 2.0 - 3.0, width / 2.0 + 3.0, 0.05)
    at = pixels[chosen, None] + across[None, :, None] * normal[chosen, None] - 0.5
    measured = map_coordinates(ink, [at[:, :, 1], at[:, :, 0]], order=1).sum(axis=1) * 0.05
    assert np.mean(np.abs(measured - width) <= 0.5) >= 0.95
    assert abs(np.median(measured) - width) < 0.2


def test_lines_behind_a_surface_are_hidden(draw_lines):
    back = meshes.blocks(*((x, y, 0) for x in (-1, 0) for y in (-1, 0)))
    front = (meshes.sphere(4, 1.5)[0] + np.array([0.0, 0.0, 3.0]), meshes.sphere(4)[1])
    asset = asset_of(meshes.joined(back, front), "block behind a ball")
    camera = {"eye": [0.0, 0.0, 20.0], "target": [0.0, 0.0, 0.0], "projection": "orthographic", "height": 5.0}
    lines = {"silhouette": {"width": 2.0}, "ridge": {"width": 2.0, "color": "#ff0000"}, "ridge_deg": 30.0}
    lined = draw_lines(asset, lines, camera=camera)
    at = (np.arange(200) + 0.5) / 40.0 - 2.5
    away = np.hypot(*np.meshgrid(at, at))
    ball = away < 1.5 - 0.06
    assert not np.any(lined.pixels[ball][:, 1] < 255)
    assert np.any(inked(lined.pixels)[(away > 1.45) & (away < 1.55)])


@pytest.mark.parametrize("antialias", ["none", "msaa"])
def test_kinds_of_a_block_are_where_its_edges_are(draw_lines, antialias):
    colors = {"silhouette": (0, 0, 0), "ridge": (255, 0, 0), "valley": (0, 0, 255)}
    asset = asset_of(meshes.blocks((0, 0, 0), (1, 0, 0), (0, 1, 0)), "coloured L")
    lines = {kind: {"width": 3.0, "color": "#{:02x}{:02x}{:02x}".format(*color)} for kind, color in colors.items()}
    camera = {"eye": [7.0, 5.0, 9.0], "target": [1.0, 1.0, 0.5], "fov_y_deg": 25.0}
    lined = draw_lines(asset, lines, camera=camera, antialias=antialias)

    def color_at(*point):
        u, v = to_pixels(lined.view, project(lined.view, asset.frame.to_normalised(np.array([point]))))[0]
        return tuple(int(c) for c in lined.pixels[int(v), int(u), :3])

    # front face z = 1, a notch above x = 1 .. 2 that is seen from above and from the right
    assert color_at(1.0, 1.0, 0.5) == colors["valley"]
    for ridge in ((1.5, 1.0, 1.0), (0.5, 2.0, 1.0), (1.0, 1.5, 1.0), (2.0, 0.5, 1.0), (2.0, 1.0, 0.5), (1.0, 2.0, 0.5)):
        assert color_at(*ridge) == colors["ridge"]
    for outline in ((0.0, 0.5, 1.0), (0.5, 0.0, 1.0), (2.0, 0.5, 0.0), (0.5, 2.0, 0.0)):
        assert color_at(*outline) == colors["silhouette"]
    for flat in ((0.5, 0.5, 1.0), (1.5, 0.5, 1.0), (0.5, 1.5, 1.0)):  # diagonals and seams of coplanar faces
        assert color_at(*flat) == (255, 255, 255)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_folds_of_an_open_sheet_are_seen_from_either_side_if_asked(draw_lines, side):
    vertices = np.array([[-1, -1, 0], [0, -1, 0.8], [1, -1, 0], [-1, 1, 0], [0, 1, 0.8], [1, 1, 0]], float)
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]], np.int32)
    asset = asset_of((vertices, faces), "roof")
    camera = {"eye": [0.5, 0.4, 6.0 * side], "target": [0.0, 0.0, 0.3]}
    lines = {"ridge": {"width": 3.0, "color": "#ff0000"}, "valley": {"width": 3.0, "color": "#0000ff"}}
    lines |= {"ridge_deg": 30.0, "valley_deg": 30.0, "boundary": None}
    for orientation in ("trusted", "any"):
        lined = draw_lines(asset, lines | {"orientation": orientation}, camera=camera)
        shown = {tuple(c) for c in lined.pixels[:, :, :3].reshape(-1, 3).tolist()} - {(255, 255, 255)}
        assert shown == {(0, 0, 255)} if orientation == "any" and side < 0.0 else {(255, 0, 0)}


def test_border_is_drawn_where_it_passes_the_eye(draw_lines):
    long = meshes.sheet(10, 0.0)
    asset = asset_of((long[0] * [2.0, 40.0, 1.0], long[1]), "road")
    camera = {"eye": [0.2, 0.0, 0.4], "target": [0.1, 10.0, 0.0], "up": [0.0, 0.0, 1.0], "fov_y_deg": 80.0}
    lined = draw_lines(
        asset, {"boundary": {"width": 2.0}, "silhouette": None}, camera=camera, shading=Shading(color="#ffffff", ambient=1.0)
    )
    ink = inked(lined.pixels)
    y = np.geomspace(0.05, 15.0, 400)
    for x in (-1.0, 1.0):
        side = asset.frame.to_normalised(np.column_stack([np.full_like(y, x), y, 0.0 * y]))
        at = to_pixels(lined.view, project(lined.view, side))
        at = np.floor(at[np.all((at > 0.0) & (at < 200.0), axis=1)]).astype(int)
        assert len(at) > 100
        assert ink[at[:, 1], at[:, 0]].mean() > 0.97
    ahead = to_pixels(lined.view, project(lined.view, asset.frame.to_normalised(np.array([[0.0, 1.0, 0.0]]))))[0]
    assert not ink[int(ahead[1]) - 5 : int(ahead[1]) + 5, int(ahead[0]) - 5 : int(ahead[0]) + 5].any()


@pytest.mark.parametrize("antialias", ["none", "msaa", "ssaa"])
def test_translucent_lines_are_blended_once_in_linear_light(draw_lines, antialias):
    asset = asset_of(meshes.torus(40, 20), "glassy")
    lines = {"silhouette": {"width": 6.0, "opacity": 0.5, "color": "#000000"}}
    lines |= {"ridge": {"width": 4.0, "opacity": 0.5, "color": "#000000"}, "ridge_deg": 12.0}
    lined = draw_lines(asset, lines, antialias=antialias, background="transparent")
    alpha, red = lined.pixels[:, :, 3], lined.pixels[:, :, 0]
    assert red[alpha == 255].min() >= 187
    assert np.mean(np.isin(red[(alpha == 255) & (red < 255)], (187, 188, 189))) > 0.5
    assert np.isin(alpha, (127, 128)).sum() > 300
    assert np.all(red[np.isin(alpha, (127, 128))] <= 1)


def test_opaque_and_translucent_lines_are_in_the_same_places(draw_lines):
    asset = asset_of(meshes.knot(120, 12), "knot")
    lines = {"silhouette": {"width": 3.0, "color": "#204060"}, "ridge": {"color": "#a00000"}, "ridge_deg": 20.0}
    opaque = draw_lines(asset, lines).pixels
    almost = draw_lines(asset, {**lines, "ridge": {"color": "#a00000", "opacity": 0.999}}).pixels
    assert np.abs(opaque.astype(int) - almost).max() <= 4


def test_width_by_distance_is_that_of_the_middle_and_less_behind(draw_lines):
    post = (meshes.blocks((0, 0, 0))[0] - 0.5) * [1.5, 6.0, 0.4], meshes.blocks((0, 0, 0))[1]
    places = np.array([[-3.0, 0.0, 4.0], [0.0, 0.0, 0.0], [4.5, 0.0, -4.0]])
    asset = asset_of(meshes.joined(*((post[0] + place, post[1]) for place in places)), "three posts")
    camera = {"eye": [0.0, 0.0, 12.0], "fov_y_deg": 40.0}
    lines = {"silhouette": {"width": 8.0}, "scale": "distance"}
    lined = draw_lines(asset, lines, camera=camera, antialias="msaa", size=(600, 200))
    ink = 1.0 - (lined.pixels[100, :, 0] / 255.0) ** 2.2
    fronts = places + np.array([[-0.75, 0.0, 0.2], [-0.75, 0.0, 0.2], [0.75, 0.0, 0.2]])
    outlines = to_pixels(lined.view, project(lined.view, asset.frame.to_normalised(fronts)))[:, 0]
    for x, depth, outwards in zip(outlines, 12.0 - fronts[:, 2], (-1, -1, 1), strict=True):
        half = 4.0 * (12.0 - asset.frame.centre[2]) / depth
        beyond = np.arange(len(ink)) + 0.5 - x
        assert abs(ink[(outwards * beyond > 0.0) & (outwards * beyond < half + 4.0)].sum() - half) < 1.0


def test_nothing_is_drawn_for_what_a_mesh_does_not_have(draw_lines):
    closed = asset_of(meshes.sphere(2), "closed")
    lined = draw_lines(closed, {"silhouette": None, "boundary": {}})
    assert lined.work.draws == 0
    assert not inked(lined.pixels).any()


def test_white_surface_without_lines_is_white(draw_lines):
    assert not inked(draw_lines(asset_of(meshes.cube(2), "bare"), {"silhouette": None}, shading=WHITE).pixels).any()
