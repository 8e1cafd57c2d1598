"""Meshes whose vertices are moved, against the same meshes read anew."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.errors import CapabilityError, InvalidRequestError
from schemas.lines import Lines
from schemas.render import Accuracy, Camera, Orbit, OrbitCamera, RenderRequest, Shading, SilhouetteRequest
from service.moving import Moving
from service.render.explain import explain
from service.render.frame import render_frame
from service.silhouette.describe import describe_silhouette
from tests import meshes, oracles
from tests.service.render.made import clippable
from tests.service.render.moved import bent, read, rotated

SHAPES = {
    "bumpy": lambda: meshes.bumpy_sphere(3, 0.5),
    "cube": lambda: meshes.cube(4),
    "sheet": lambda: meshes.sheet(8),
    "L": lambda: meshes.blocks((0, 0, 0), (1, 0, 0), (0, 1, 0)),
}
SHARP = {"ridge": {"color": "#ff0000"}, "valley": {"color": "#0000ff"}, "ridge_deg": 25.0, "valley_deg": 25.0}
WAYS = {
    "shaded": {},
    "flat": {"shading": Shading(mode="flat")},
    "ssaa": {"accuracy": Accuracy(source="original", antialias="ssaa")},
    "edge mesh": {"lines": Lines(**SHARP)},
    "fattened": {"lines": Lines(method="fattened", **SHARP)},
    "any": {"lines": Lines(method="wireframe", orientation="any")},
    "translated": {"lines": Lines(method="translated")},
    "charcoal": {"lines": Lines(method="fattened", charcoal=True)},
}
EYE = Camera(eye=[3.1, 2.2, 4.3], target=[0.2, 0.1, 0.3], fov_y_deg=50.0)


def picture(gpu, asset, **fields):
    fields = {"camera": EYE, "width": 160, "height": 140, "background": "#ffffff"} | fields
    return render_frame(gpu, asset, RenderRequest(**fields))


def differing(first, second, by=24):
    """Part of the pixels that differ by more."""
    return float((np.abs(first.pixels.astype(int) - second.pixels).max(axis=2) > by).mean())


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", SHAPES)
def test_a_mesh_moved_to_where_it_is_is_the_same_picture(gpu, name, way):
    asset, vertices = read(SHAPES[name]())
    moved = Moving(asset).at(vertices)
    assert np.array_equal(moved.positions, asset.positions) and np.array_equal(moved.normals, asset.normals)
    still, again = picture(gpu, asset, **WAYS[way]), picture(gpu, moved, **WAYS[way])
    assert np.array_equal(still.pixels, again.pixels)
    assert "deform" in again.plan and "deform" not in still.plan


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("move", [bent, lambda v: rotated(v, 0.8, (0.3, 0.2, -0.1))], ids=["bent", "rigid"])
def test_a_moved_mesh_is_the_picture_of_one_read_there(gpu, name, way, move):
    asset, vertices = read(SHAPES[name]())
    anew, places = read((move(SHAPES[name]()[0]), SHAPES[name]()[1]))
    assert np.allclose(places, move(vertices))
    moved, fresh = (picture(gpu, one, **WAYS[way]) for one in (Moving(asset).at(move(vertices)), anew))
    assert differing(moved, picture(gpu, asset, **WAYS[way])) > 0.02, "it moves"
    # creases are those of the mesh at rest, so that a bend beside one may be smooth where a mesh read anew has a crease
    assert differing(moved, fresh) < 0.01


def test_colours_stay_with_their_faces(gpu):
    vertices, faces = meshes.bumpy_sphere(2, 0.3)
    colors = np.column_stack([(128 + 100 * vertices).clip(0, 255), np.full(len(vertices), 255)])
    asset, places = read((vertices, faces), colors)
    anew, _ = read((bent(vertices), faces), colors)
    moved, fresh = picture(gpu, Moving(asset).at(bent(places))), picture(gpu, anew)
    assert differing(moved, fresh) < 0.01
    assert differing(moved, picture(gpu, anew, shading=Shading(use_mesh_color=False))) > 0.1


@pytest.mark.parametrize("orientation", ["trusted", "any"])
def test_a_sheet_that_is_folded_gets_a_ridge_and_unfolded_has_none(gpu, orientation):
    asset, flat = read(meshes.sheet(8, 0.0))
    folded = flat.copy()
    folded[:, 2] = -np.abs(flat[:, 0])
    lines = Lines(silhouette=None, boundary=None, ridge={"color": "#ff0000", "width": 4.0}, ridge_deg=60.0, orientation=orientation)
    view = {"camera": Camera(eye=[0.0, 0.1, 3.0]), "shading": Shading(color="#ffffff"), "lines": lines}
    red = [
        int((picture(gpu, one, **view).pixels[:, :, 1] < 100).sum())
        for one in (asset, Moving(asset).at(folded), Moving(asset).at(0.5 * flat))
    ]
    assert red[0] == red[2] == 0 and red[1] > 50
    assert asset.line_surface.sharp(60.0, None, convex=True).shape == (0, 2)
    ridge = Moving(asset).at(folded).line_surface.sharp(60.0, None, convex=True)
    assert len(ridge) == 8 and np.allclose(flat[ridge.reshape(-1), 0], 0.0)


def test_frames_of_one_move_give_the_gl_positions_alone(gpu):
    asset, vertices = read(meshes.bumpy_sphere(4, 0.5))
    moving, fields = Moving(asset), WAYS["edge mesh"]
    first, second = moving.at(vertices), moving.at(bent(vertices))
    begun = picture(gpu, first, **fields)
    moved = picture(gpu, second, **fields)
    texels = 16 * 2048 * -(-len(vertices) // 2048)
    assert moved.work.uploaded_bytes == 24 * len(asset.normals) + texels
    assert begun.work.uploaded_bytes > moved.work.uploaded_bytes + 12 * len(asset.faces)
    again = picture(gpu, second, **fields)
    assert again.work.uploaded_bytes == 0
    assert np.array_equal(again.pixels, moved.pixels)
    back = picture(gpu, first, **fields)
    assert np.array_equal(back.pixels, begun.pixels)
    assert first.line_surface.adjacency is second.line_surface.adjacency is asset.line_surface.adjacency
    assert second.line_mesh.fans is asset.line_mesh.fans
    before = len(gpu.cache)
    gpu.cache.drop(moving.id)
    assert len(gpu.cache) == before - 2


def test_a_moved_edge_mesh_outlives_the_one_it_comes_from(gpu):
    asset, vertices = read(meshes.torus())
    moving, fields = Moving(asset), WAYS["edge mesh"]
    begun = picture(gpu, moving.at(bent(vertices)), **fields)
    gpu.cache.drop(asset.id)
    picture(gpu, clippable("sphere"), **fields)
    assert np.array_equal(picture(gpu, moving.at(bent(vertices)), **fields).pixels, begun.pixels)
    gpu.cache.drop(moving.id)


def test_normals_are_those_of_the_moved_faces_with_the_creases_at_rest():
    asset, vertices = read(meshes.cube(3))
    moved = Moving(asset).at(bent(vertices))
    corners = moved.positions.astype(np.float64)[moved.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    slow = np.zeros((len(moved.normals), 3))
    for f, rows in enumerate(asset.shading_faces):
        for k, row in enumerate(rows):
            u, v = corners[f, (k + 1) % 3] - corners[f, k], corners[f, (k + 2) % 3] - corners[f, k]
            slow[row] += normal[f] * np.arccos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1.0, 1.0))
    slow /= np.linalg.norm(slow, axis=1, keepdims=True)
    assert np.allclose(moved.normals, slow, atol=1e-5)
    assert len(moved.normals) == 6 * 16, "each side of the cube has its own"


def test_silhouette_of_a_moved_mesh_is_exact():
    asset, vertices = read(meshes.bumpy_sphere(2, 0.5))
    moved = Moving(asset).at(bent(vertices))
    found = describe_silhouette(moved, SilhouetteRequest(camera=EYE))
    eye = np.append(asset.frame.to_normalised(EYE.eye), 1.0)
    assert oracles.edge_set(found.edges) == oracles.edge_set(oracles.silhouette(moved.positions, moved.faces, eye))
    assert oracles.edge_set(found.edges) != oracles.edge_set(describe_silhouette(asset, SilhouetteRequest(camera=EYE)).edges)


@pytest.mark.parametrize("name", ["bumpy", "sheet"])
def test_visible_lines_of_a_moved_mesh_are_those_of_one_read_there(name):
    (vertices, faces), wanted = SHAPES[name](), {"visible_only": True, "kinds": ["silhouette", "boundary", "ridge"], "ridge_deg": 20.0}
    asset, places = read((vertices, faces))
    anew, _ = read((bent(vertices), faces))
    request = SilhouetteRequest(camera=EYE, project={"width": 300, "height": 300}, **wanted)
    moved, fresh = (describe_silhouette(one, request).lines for one in (Moving(asset).at(bent(places)), anew))

    def length(lines):
        return sum(float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in lines.polylines())

    assert length(moved) == pytest.approx(length(fresh), rel=0.01)
    assert length(moved) > 100.0


def test_parts_moved_out_of_the_sphere_at_rest_are_drawn(gpu):
    asset, vertices = read(meshes.sphere(2))
    far = vertices + np.array([0.0, 0.0, 40.0])
    wanted = {"camera": Camera(eye=[0.0, 0.0, 44.0], target=[0.0, 0.0, 40.0])}
    drawn = picture(gpu, Moving(asset).at(far), **wanted)
    anew, _ = read((far, asset.faces))
    assert differing(drawn, picture(gpu, anew, **wanted)) < 0.01
    assert (drawn.pixels[:, :, 0] < 250).mean() > 0.2
    outline = SilhouetteRequest(camera=Camera(eye=[0.0, 0.0, 40.0], target=[0.0, 0.0, 39.0]), project={"width": 64, "height": 64})
    assert len(describe_silhouette(Moving(asset).at(far), outline).edges) == 0
    assert not describe_silhouette(Moving(asset).at(far), outline).outline.offsets[1:].size, "all round the eye there is inside, no contour"


def test_a_mesh_turned_inside_out_is_seen_from_both_sides(gpu):
    asset, vertices = read(meshes.bumpy_sphere(3, 0.5))
    mirrored = vertices * [-1.0, 1.0, 1.0]
    anew, _ = read((mirrored, asset.faces[:, ::-1]))
    for asked in ({}, {"lines": Lines()}, {"lines": Lines(method="fattened")}):
        moved, fresh = picture(gpu, Moving(asset).at(mirrored), **asked), picture(gpu, anew, **asked)
        assert differing(moved, fresh) < 0.01, asked


def test_a_mesh_at_one_point_is_nothing_and_no_error(gpu):
    asset, vertices = read(meshes.cube(2))
    drawn = picture(gpu, Moving(asset).at(np.zeros_like(vertices)), **WAYS["edge mesh"])
    assert (drawn.pixels == 255).mean() > 0.99
    lines = describe_silhouette(
        Moving(asset).at(np.zeros_like(vertices)), SilhouetteRequest(project={"width": 64, "height": 64}, visible_only=True)
    ).lines
    assert all(np.isfinite(points).all() for points in lines.polylines())


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda v: v[:-1], "has 26 vertices, but there are positions of 25"),
        (lambda v: np.concatenate([v, v]), "positions of 52"),
        (lambda v: v[:, :2], "an array of"),
        (
            lambda v: np.where(np.arange(26)[:, None] == 5, np.nan, v),
            "1 of 26 positions are not finite, .* vertex 5",
        ),
        (lambda v: np.where(np.arange(26)[:, None] > 20, np.inf, v), "5 of 26 positions are not finite"),
        (lambda v: v * 1e9, "farther than 1,000,000 radii"),
        (lambda v: v.astype(np.float64) * 1e308 * 1e10, "not finite"),
    ],
)
def test_positions_that_cannot_be_used_are_refused(spoil, says):
    asset, vertices = read(meshes.cube(2))
    with pytest.raises(InvalidRequestError, match=says) as refused, np.errstate(over="ignore", invalid="ignore"):
        Moving(asset).at(spoil(vertices))
    assert refused.value.where["field"] == "positions"


@pytest.mark.parametrize("accuracy", [{"source": "clipped"}, {"smooth": True}])
def test_hulls_do_not_go_along(gpu, accuracy):
    asset = clippable("sphere")
    moved = Moving(asset).at(asset.frame.to_model(asset.positions))
    with pytest.raises(CapabilityError, match="hull is that of the mesh at rest"):
        picture(gpu, moved, accuracy=Accuracy(**accuracy))
    drawn = picture(gpu, moved)
    assert drawn.rung == "original/msaa"
    gpu.cache.drop(moved.id)


def test_plan_tells_of_the_move(gpu):
    asset, vertices = read(meshes.cube(2))
    moved = explain(RenderRequest(camera=EYE), Moving(asset).at(vertices), gpu.costs)
    still = explain(RenderRequest(camera=EYE), asset, gpu.costs)
    assert "deform" in [step.name for step in moved.passes] and "deform" in [step.name for step in still.left_out]
    assert next(step for step in moved.passes if step.name == "deform").predicted_ms > 0.0


def test_an_orbit_turns_about_the_mesh_at_rest(gpu):
    asset, vertices = read(meshes.sphere(2))
    orbit = OrbitCamera(orbit=Orbit(azimuth_deg=0.0, elevation_deg=0.0))
    beside = Moving(asset).at(vertices + np.array([0.3, 0.0, 0.0]))
    columns = [(picture(gpu, one, camera=orbit).pixels[:, :, 0] < 250).any(axis=0) for one in (asset, beside)]
    middles = [float(np.average(np.nonzero(column)[0])) for column in columns]
    assert middles[1] - middles[0] > 8.0
