import math

import numpy as np
import pytest

from schemas.conventions import Frame
from schemas.errors import InvalidRequestError
from schemas.render import Camera, Orbit, OrbitCamera
from service.camera import project, resolve_camera, to_pixels

UNIT = Frame((0.0, 0.0, 0.0), 1.0)
HARD_FRAMES = [Frame((1e7, -1e7, 1e7), 1.0), Frame((0.0, 0.0, 0.0), 1e-12), Frame((5.0, 0.0, -3.0), 1e12), Frame((1e-9, 0.0, 0.0), 1e-12)]
DIRECTIONS = np.vstack([np.eye(3), -np.eye(3)])


def orbit(**values):
    return OrbitCamera(orbit=Orbit(**values))


def pixels(view, points):
    return to_pixels(view, project(view, np.atleast_2d(points)))


def sphere_points(count=4000, seed=0):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_target_is_the_middle_of_the_image_and_up_is_up():
    view = resolve_camera(Camera(eye=[3, 4, 5], target=[0.3, -0.2, 0.1], up=[0, 0, 1]), UNIT, 640, 480)
    middle, above = pixels(view, [[0.3, -0.2, 0.1], [0.3, -0.2, 0.4]])
    assert np.allclose(middle, [320, 240])
    assert above[0] == pytest.approx(320)
    assert above[1] < 240


def test_right_of_the_viewer_is_right_in_the_image():
    view = resolve_camera(Camera(eye=[0, 0, 5]), UNIT, 100, 100)
    assert pixels(view, [[1, 0, 0]])[0, 0] > 50


@pytest.mark.parametrize(("width", "height"), [(512, 512), (800, 200), (200, 800)])
@pytest.mark.parametrize("fov", [20.0, 45.0, 120.0])
def test_fov_is_vertical_and_pixels_are_square(width, height, fov):
    view = resolve_camera(Camera(eye=[0, 0, 10], fov_y_deg=fov), UNIT, width, height)
    edge = 10 * math.tan(math.radians(fov) / 2)
    top, right = pixels(view, [[0, edge, 0], [edge, 0, 0]])
    assert top[1] == pytest.approx(0.0, abs=1e-9 * height)
    assert right[0] - width / 2 == pytest.approx(height / 2)
    assert view.pixel_scale / 10 * edge == pytest.approx(height / 2)


@pytest.mark.parametrize(("width", "height"), [(512, 512), (800, 200), (200, 800), (8192, 1), (1, 1)])
@pytest.mark.parametrize("fov", [0.001, 1.0, 45.0, 120.0, 179.9])
def test_fit_just_fits_the_sphere_into_the_smaller_side(width, height, fov):
    view = resolve_camera(orbit(azimuth_deg=33.0, elevation_deg=-20.0, fov_y_deg=fov), UNIT, width, height)
    # the outline of the sphere: the cone of half angle asin(1 / d) against half the field of view
    half = math.atan(math.tan(math.radians(fov) / 2) * min(1.0, width / height))
    distance = float(np.linalg.norm(view.eye[:3]))
    assert distance == pytest.approx(1.02 / math.sin(half), rel=1e-6)
    p = pixels(view, sphere_points())
    ahead = ~np.isnan(p[:, 0])
    assert p[ahead].min() >= -1e-6
    assert np.all(p[ahead] <= (width + 1e-6, height + 1e-6))


def test_fit_ignores_the_radius_that_is_drawn():
    a, b = (resolve_camera(orbit(), UNIT, 64, 64, radius) for radius in (1.0, 1.4))
    assert np.array_equal(a.eye, b.eye)
    assert b.near < a.near < a.far < b.far


@pytest.mark.parametrize(
    ("azimuth", "elevation", "towards"), [(0, 0, (0, 0, 1)), (90, 0, (1, 0, 0)), (-90, 0, (-1, 0, 0)), (180, 0, (0, 0, -1))]
)
def test_azimuth_turns_from_z_to_x(azimuth, elevation, towards):
    view = resolve_camera(orbit(azimuth_deg=azimuth, elevation_deg=elevation, distance=3.0), UNIT, 10, 10)
    assert np.array_equal(view.eye, np.append(np.multiply(towards, 3.0), 1.0))


@pytest.mark.parametrize("azimuth", [0.0, 40.0, 725.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_poles_of_the_orbit_are_the_limit_of_what_is_near_them(azimuth, sign):
    at = resolve_camera(orbit(azimuth_deg=azimuth, elevation_deg=90.0 * sign), UNIT, 100, 100)
    near = resolve_camera(orbit(azimuth_deg=azimuth, elevation_deg=89.9999 * sign), UNIT, 100, 100)
    assert np.allclose(pixels(at, DIRECTIONS * 0.5), pixels(near, DIRECTIONS * 0.5), atol=1e-2)
    assert at.eye[1] == sign * np.linalg.norm(at.eye[:3])


@pytest.mark.parametrize(
    "camera", [orbit(elevation_deg=30.0), orbit(distance=1.2), orbit(fov_y_deg=0.001), orbit(distance=1e9), orbit(distance=1e15)]
)
@pytest.mark.parametrize("radius", [1.0, 1.3])
def test_depth_of_the_drawn_sphere_is_within_the_clip_range(camera, radius):
    view = resolve_camera(camera, UNIT, 64, 64, radius)
    clip = project(view, sphere_points() * radius)
    far_enough = clip[:, 3] > view.near
    z = clip[far_enough, 2] / clip[far_enough, 3]
    assert far_enough.mean() > 0.7
    assert np.all(np.abs(z) <= 1.0 + 1e-9)
    if view.near > radius * 1e-2:
        assert z.min() < -0.9
        assert z.max() > 0.9
    order = np.argsort(-(sphere_points() @ view.eye[:3])[far_enough])
    assert np.all(np.diff(z[order]) >= -1e-9)


def test_matrix_survives_a_cast_to_float32_for_a_distant_eye():
    """Composed carelessly, the depth row would cancel to nothing."""
    view = resolve_camera(orbit(distance=1e6, fov_y_deg=1e-4), UNIT, 64, 64)
    single = sphere_points().astype(np.float32) @ view.matrix.astype(np.float32)[:, :3].T + view.matrix.astype(np.float32)[:, 3]
    double = project(view, sphere_points())
    assert np.abs(single[:, :3] / single[:, 3:] - double[:, :3] / double[:, 3:]).max() < 1e-5


@pytest.mark.parametrize("eye", [(0.0, 0.0, 0.0), (0.5, 0.1, 0.0), (0.0, 0.0, 3.0)])
@pytest.mark.parametrize("target", [(0.1, 0.2, 1.0), (0.0, 0.0, 9.0)])
def test_near_is_positive_wherever_the_eye_is(eye, target):
    view = resolve_camera(Camera(eye=list(eye), target=list(target)), UNIT, 10, 10)
    assert 0.0 < view.near < view.far
    assert np.all(np.isfinite(view.matrix))


def test_orthographic_height_is_the_image_and_depth_does_not_matter():
    for distance in (0.1, 5.0, 1e6):
        view = resolve_camera(Camera(eye=[distance, 0, 0], projection="orthographic", height=4.0), UNIT, 80, 40, 1.2)
        assert view.orthographic
        assert np.array_equal(view.eye, [1.0, 0.0, 0.0, 0.0])
        assert np.allclose(pixels(view, [[0.7, 2.0, 0.0], [-0.7, 0.0, -4.0]]), [[40, 0], [80, 20]])
        assert view.pixel_scale == 10.0
        clip = project(view, sphere_points() * 1.2)
        assert np.all(clip[:, 3] == 1.0)
        assert np.abs(clip[:, 2]).max() <= 1.0
        assert 0.0 < view.near < view.far


@pytest.mark.parametrize("frame", HARD_FRAMES)
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_offset_and_scale_change_nothing(frame, projection):
    def at(f):
        eye, target = f.to_model([[1.0, 0.5, 2.5], [0.25, -0.125, 0.5]])
        camera = Camera(eye=list(eye), target=list(target), projection=projection, height=2.0 * f.scale)
        return resolve_camera(camera, f, 512, 512)

    expected, view = at(UNIT), at(frame)
    # an ulp of the offset, seen from the frame
    rounding = 8.0 * np.spacing(max(map(abs, frame.centre))) / frame.scale + 1e-12
    assert np.allclose(view.eye, expected.eye, rtol=0, atol=rounding)
    assert np.abs(pixels(view, sphere_points()) - pixels(expected, sphere_points())).max() <= 2000 * rounding


@pytest.mark.parametrize("frame", HARD_FRAMES)
def test_fitted_orbits_of_all_meshes_are_the_same(frame):
    assert np.array_equal(
        resolve_camera(orbit(azimuth_deg=10.0), frame, 9, 9).matrix, resolve_camera(orbit(azimuth_deg=10.0), UNIT, 9, 9).matrix
    )


def test_a_distant_eye_keeps_the_target_in_the_middle_to_the_last_digit():
    view = resolve_camera(Camera(eye=[3e14, 1e14, 7e14], target=[0.1, 0.2, 0.3], fov_y_deg=1e-12), UNIT, 512, 512)
    assert np.allclose(pixels(view, [[0.1, 0.2, 0.3]]), 256, atol=1e-6)


def test_view_is_a_rotation_that_looks_down_its_negative_z():
    view = resolve_camera(Camera(eye=[1, 2, 3], target=[0, 1, 0]), UNIT, 10, 10)
    rotation = view.view[:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3))
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert np.allclose(view.view @ [1, 2, 3, 1], [0, 0, 0, 1])
    assert np.allclose((view.view @ [0, 1, 0, 1])[:2], 0.0)
    assert (view.view @ [0, 1, 0, 1])[2] < 0


def test_points_behind_the_eye_have_no_pixel():
    view = resolve_camera(Camera(eye=[0, 0, 2]), UNIT, 10, 10)
    assert np.all(np.isnan(pixels(view, [[0, 0, 3]])))


@pytest.mark.parametrize(
    ("camera", "frame", "field"),
    [
        (Camera(eye=[1e300, 0, 0]), UNIT, "camera.eye"),
        (Camera(eye=[1e-3, 0, 0]), Frame((0.0, 0.0, 0.0), 1e-300), "camera.eye"),
        (Camera(eye=[-1e308, 1, 0], target=[0, 0, 0]), Frame((1.7e308, 0.0, 0.0), 1.0), "camera.eye"),
        (Camera(eye=[0, 0, 3], fov_y_deg=1e-300), UNIT, "camera.fov_y_deg"),
        (Camera(eye=[0, 0, 3], projection="orthographic", height=1e-300), UNIT, "camera.height"),
        (orbit(distance=1e300), UNIT, "camera.orbit.distance"),
        (orbit(distance=1e-300), UNIT, "camera.orbit.distance"),
        (orbit(fov_y_deg=1e-300), UNIT, "camera.orbit.fov_y_deg"),
        (Camera(eye=[0, 0, 1e20], target=[1e18, 0, 0], fov_y_deg=1e-20), UNIT, "camera"),
    ],
)
def test_numbers_that_cannot_be_used_name_their_field(camera, frame, field):
    with pytest.raises(InvalidRequestError) as caught:
        resolve_camera(camera, frame, 16, 16)
    assert caught.value.where["field"] == field
