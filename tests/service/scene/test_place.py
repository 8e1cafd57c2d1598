"""Placements: where points, eyes and pictures of a placed mesh come to be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.conventions import Frame
from schemas.errors import InvalidRequestError
from schemas.render import Accuracy, Camera, Orbit, OrbitCamera, RenderRequest, Shading
from service.camera import project, resolve_camera, to_pixels
from service.render.frame import render_frame, render_view
from service.scene.place import Placement, own_view, place, sphere_around, view_of
from tests.service.render.made import clippable

SIZE = (96, 80)
CAMERAS = (
    Camera(eye=[3.0, 2.0, 4.0], target=[0.3, 0.1, 0.0]),
    Camera(eye=[3.0, 2.0, 4.0], target=[0.3, 0.1, 0.0], projection="orthographic", height=5.0),
    OrbitCamera(orbit=Orbit(azimuth_deg=35.0, elevation_deg=-20.0)),
    OrbitCamera(orbit=Orbit(azimuth_deg=35.0, elevation_deg=90.0, distance=7.0)),
)
SHEARED = np.array([[1.0, 0.5, 0.0, 2.0], [0.0, -2.0, 0.3, -1.0], [0.4, 0.0, 0.7, 0.5], [0.0, 0.0, 0.0, 1.0]])

matrices = st.lists(st.floats(-3.0, 3.0), min_size=12, max_size=12).map(
    lambda numbers: np.vstack([np.array(numbers).reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
)


@pytest.mark.parametrize("camera", CAMERAS)
def test_identity_leaves_the_view_as_it_is_to_the_last_bit(camera):
    asset = clippable("bumpy")
    placement = place(asset, np.eye(4), "objects[0].transform")
    view = own_view(asset, placement, camera, SIZE, sphere_around([placement]))
    plain = resolve_camera(camera, asset.frame, *SIZE, asset.radius)
    assert np.array_equal(view.matrix, plain.matrix)
    assert np.array_equal(view.eye, plain.eye)
    assert (view.mirrored, view.normal_matrix) == (False, None)


@pytest.mark.parametrize("camera", CAMERAS)
def test_points_of_a_placed_mesh_are_seen_where_the_scene_has_them(camera):
    asset = clippable("torus")
    placement = place(asset, SHEARED, "objects[0].transform")
    around = Frame((0.1, 0.4, -0.2), 3.0)
    view = own_view(asset, placement, camera, SIZE, around)
    scene = asset.frame.to_model(asset.positions) @ SHEARED[:3, :3].T + SHEARED[:3, 3]
    expected = resolve_camera(camera, around, *SIZE, 3.0)
    seen, true = to_pixels(view, project(view, asset.positions)), to_pixels(expected, project(expected, around.to_normalised(scene)))
    assert np.abs(seen - true).max() < 1e-9 * SIZE[0]


@pytest.mark.parametrize("camera", CAMERAS)
def test_views_of_one_common_frame_share_their_depths(camera):
    assets = [clippable("torus"), clippable("bumpy")]
    placements = [place(assets[0], SHEARED, ""), place(assets[1], np.diag([1.0, -1.0, 0.5, 1.0]), "")]
    around = sphere_around(placements)
    base = resolve_camera(camera, around, *SIZE)
    for asset, placement in zip(assets, placements, strict=True):
        view = view_of(placement, base, around, around)
        scene = placement.points(asset.positions, around)
        assert np.allclose(project(view, asset.positions), project(base, scene), rtol=1e-12, atol=1e-12)
        assert np.all(np.linalg.norm(scene, axis=1) <= 1.0 + 1e-6)


@given(matrices, st.integers(0, 3))
@settings(max_examples=60, deadline=None)
def test_the_eye_in_the_meshs_frame_sees_each_face_from_the_side_the_scene_sees(matrix, which):
    if np.linalg.cond(matrix[:3, :3]) > 1e4:
        return
    asset = clippable("cube")
    placement = place(asset, matrix, "")
    around = sphere_around([placement])
    eye = own_view(asset, placement, CAMERAS[which], SIZE, around).eye
    outer = resolve_camera(CAMERAS[which], around, *SIZE).eye
    corners = placement.points(asset.positions, around)[asset.faces]
    a = asset.positions.astype(np.float64)[asset.faces]
    own = np.linalg.det(np.stack([a[:, 1] - a[:, 0], a[:, 2] - a[:, 0], eye[:3] - eye[3] * a[:, 0]], axis=1))
    turned = -1.0 if placement.mirrored else 1.0
    scene = turned * np.linalg.det(
        np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], outer[:3] - outer[3] * corners[:, 0]], axis=1)
    )
    sure = np.abs(own) > 1e-9 * np.abs(own).max()
    assert np.array_equal(np.sign(own[sure]), np.sign(scene[sure]))


@pytest.mark.parametrize("camera", CAMERAS)
def test_views_of_a_scene_know_its_middle_and_how_near_points_are_in_it(camera):
    """Whether they are of one common frame or each of the mesh's own; units of depth are what they are said to be."""
    assets = [clippable("torus"), clippable("bumpy")]
    placements = [place(assets[0], SHEARED, ""), place(assets[1], np.diag([1.0, -1.0, 0.5, 1.0]), "")]
    around = sphere_around(placements)
    base = resolve_camera(camera, around, *SIZE)
    for asset, placement in zip(assets, placements, strict=True):
        points = placement.points(asset.positions, around)
        for view in (view_of(placement, base, around, around), own_view(asset, placement, camera, SIZE, around)):
            near = asset.positions @ view.nearness[:3] + view.nearness[3]
            assert np.allclose(near, points @ base.view[2, :3], atol=1e-9)
            assert np.abs(near).max() <= 1.0 + 1e-6
            unit = placement.frame.scale / around.scale * view.depth_unit  # in radii of the scene
            assert view.middle_depth == pytest.approx(1.0 if view.orthographic else base.matrix[3, 3] / unit, rel=1e-9)
            pixels = base.depth_pixels * (unit if view.orthographic else 1.0)
            assert view.depth_pixels == pytest.approx(pixels, rel=1e-9)


def test_sphere_around_one_is_its_own_and_around_several_holds_them():
    frames = [Frame((1e7, 2.0, 0.1), 0.3), Frame((1e7 + 2, 2.5, -3.0), 1.5), Frame((1e7 - 4, 0.0, 0.0), 0.01)]
    placements = [Placement(frame, np.eye(3)) for frame in frames]
    assert sphere_around(placements[:1]) == frames[0]
    around = sphere_around(placements)
    for frame in frames:
        assert np.linalg.norm(np.subtract(frame.centre, around.centre)) + frame.scale <= around.scale * (1 + 1e-9)


@pytest.mark.parametrize("matrix", [np.diag([1e308, 1e308, 1e308, 1.0]), np.diag([1e-320] * 3 + [1.0])])
def test_numbers_that_overflow_are_refused_by_name(matrix):
    with pytest.raises(InvalidRequestError) as caught:
        placement = place(clippable("knot"), matrix, "objects[4].transform")
        own_view(clippable("knot"), placement, CAMERAS[0], SIZE, placement.frame)
    assert caught.value.where["field"] in ("objects[4].transform", "camera", "camera.eye")


@pytest.mark.parametrize(
    ("source", "antialias"),
    [("clipped", "none"), ("clipped", "line"), ("clipped", "coverage"), ("original", "none"), ("original", "coverage")],
)
def test_mirrored_mesh_gives_the_mirrored_picture(gpu, source, antialias):
    asset = clippable("bumpy")
    request = RenderRequest(
        camera=Camera(eye=[0.0, 0.4, 3.5]),
        width=128,
        height=128,
        shading=Shading(light=[0.0, 0.7, 1.0]),
        accuracy=Accuracy(source=source, antialias=antialias),
    )
    plain = render_frame(gpu, asset, request).pixels.astype(int)
    placement = place(asset, np.diag([-1.0, 1.0, 1.0, 1.0]), "")
    view = own_view(asset, placement, request.camera, (128, 128), placement.frame)
    mirrored = render_view(gpu, asset, request, view).pixels.astype(int)[:, ::-1]
    assert view.mirrored
    assert (plain[:, :, 3] > 0).mean() > 0.1
    alpha = np.abs(plain[:, :, 3] - mirrored[:, :, 3])
    assert (alpha > 1).sum() <= 2
    inside = (plain[:, :, 3] == 255) & (mirrored[:, :, 3] == 255)
    assert np.median(np.abs(plain - mirrored)[inside][:, :3]) <= 1.0
    assert (np.abs(plain - mirrored)[inside][:, :3].max(axis=1) > 12).mean() < 0.005


@pytest.mark.parametrize("mode", ["lambert", "normal"])
def test_stretched_sphere_is_shaded_like_an_ellipsoid(gpu, mode):
    asset = clippable("sphere")
    matrix = np.diag([0.4, 1.2, 0.8, 1.0])
    placement = place(asset, matrix, "")
    camera = Camera(eye=[1.0, 2.0, 4.0], projection="orthographic", height=3.0)
    request = RenderRequest(width=128, height=128, shading=Shading(mode=mode, color="#ffffff", ambient=0.0, light=[0.2, 0.3, 1.0]))
    view = own_view(asset, placement, camera, (128, 128), placement.frame)
    pixels = render_view(gpu, asset, request, view).pixels
    rows, columns = np.nonzero(pixels[:, :, 3] == 255)
    base = resolve_camera(camera, Frame((0.0, 0.0, 0.0), 1.0), 128, 128)
    rotation, towards = base.view[:3, :3], base.eye[:3]
    start = np.column_stack([(columns + 0.5 - 64) * 3 / 128, (64 - rows - 0.5) * 3 / 128]) @ rotation[:2]
    inverse = np.diag(1.0 / np.diag(matrix)[:3])
    o, d = start @ inverse, towards @ inverse
    b, c = o @ d, (o * o).sum(axis=1) - 1.0
    hit = b**2 - (d @ d) * c > 0.02
    t = (-b + np.sqrt(np.maximum(b**2 - (d @ d) * c, 0.0))) / (d @ d)
    normal = (start + t[:, None] * towards) @ inverse @ inverse
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    drawn = pixels[rows, columns, :3][hit] / 255.0
    if mode == "normal":
        assert np.abs(drawn * 2 - 1 - normal[hit]).mean() < 0.03
        return
    light = rotation.T @ (np.array([0.2, 0.3, 1.0]) / np.linalg.norm([0.2, 0.3, 1.0]))
    lit = np.maximum(normal[hit] @ light, 0.0)
    linear = np.where(drawn <= 0.04045, drawn / 12.92, ((drawn + 0.055) / 1.055) ** 2.4)
    assert np.abs(linear[:, 0] - lit).mean() < 0.02
