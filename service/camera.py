"""Cameras: from a request to the numbers that draw it.

All mathematics is float64 in the normalised frame, so that a model at offset 1e7 or of size 1e-12 projects as well as one
of size 1 at the origin. Three places would lose digits for a distant or far-off eye if they were written the obvious way:

- the viewing direction comes from the difference of eye and target in model units, before either is normalised;
- the lateral position of the frame's origin is measured from eye or target, whichever is nearer to it (both lie on the axis);
- the depth row of the matrix is composed by hand: multiplying projection and view cancels d^2 / radius against itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from schemas.conventions import F8, Array, Frame
from schemas.errors import InvalidRequestError
from schemas.render import AnyCamera, Camera, Orbit

FIT_MARGIN = 1.02
"""A fitted sphere is this much smaller than the field of view."""
DEPTH_MARGIN = 1.001
"""The depth range is this much larger than the sphere that is drawn."""
NEAREST_PART = 1e-4
"""near >= this part of far: with 24 bits of depth, a thousandth of the range still resolves at the near end."""
LEAST_FOCAL = 1e-7
"""A wider field of view is refused: what is seen at the image's border would lie in the eye plane as far as can be computed."""
FARTHEST = 1e30
"""Radii, pixels per unit and their inverses beyond this are refused: matrices must survive a cast to float32."""


@dataclass(frozen=True)
class View:
    """A camera resolved for one mesh and one image.

    eye: (4,) f8 homogeneous in the normalised frame (`schemas.conventions`). matrix: (4, 4) f8, clip from normalised, for
    column vectors and OpenGL clip space (-w <= x, y, z <= w, y up). view: (4, 4) f8, camera from normalised: a rotation and a
    shift. width, height: pixels. near, far: depths in normalised units along the viewing direction, 0 < near < far (equal
    when the eye is so far away that float64 cannot tell them apart; the matrix can). pixel_scale: pixels one normalised unit
    covers, at depth one (perspective) or at every depth (orthographic).
    Of a mesh that a scene places (`service.scene.place`), the matrix and the eye are still those of its own normalised frame; view
    turns the scene's axes into the camera's; pixel_scale is the largest in any direction; mirrored: the placement turns
    counter-clockwise into clockwise; normal_matrix: (3, 3) f8 from normals to normals along the scene's axes, None for none.
    depth_unit: radii of the mesh in a unit of near, far and w, which are of a frame that all meshes of a picture may share.
    nearness: (4,) f8 row that says how near a point of the mesh's frame is, from 1 to -1 over the sphere of all that is drawn;
    middle_depth: w of its middle; None for the mesh's own sphere.
    """

    eye: F8
    matrix: F8
    view: F8
    width: int
    height: int
    near: float
    far: float
    pixel_scale: float
    mirrored: bool = False
    normal_matrix: F8 | None = None
    depth_unit: float = 1.0
    nearness: F8 | None = None
    middle_depth: float | None = None

    @cached_property
    def pixels(self) -> F8:
        """(4, 4) f8: homogeneous pixels u, v (down), depth and w from the normalised frame; u / w to the right."""
        x, y, z, w = self.matrix.tolist()
        across, down = 0.5 * self.width, 0.5 * self.height
        return np.array([[(a + b) * across for a, b in zip(x, w, strict=True)], [(b - a) * down for a, b in zip(y, w, strict=True)], z, w])

    @property
    def depth_pixels(self) -> float:
        """Pixels that one unit of depth covers, at depth one (perspective) or at every depth (orthographic)."""
        return self.pixel_scale * self.depth_unit

    @property
    def orthographic(self) -> bool:
        """Whether the eye is a direction."""
        return bool(self.eye[3] == 0.0)


Vector = tuple[float, float, float]
"""Of numbers alone: for three of them numpy takes longer to be called than to count."""


class _Pose(NamedTuple):
    """Rotation with rows right, up, backward; origin: the frame's origin seen from the camera; eye: homogeneous."""

    rotation: tuple[Vector, Vector, Vector]
    origin: Vector
    eye: tuple[float, float, float, float]


def resolve_camera(camera: AnyCamera, frame: Frame, width: int, height: int, radius: float = 1.0, around: Frame | None = None) -> View:
    """The view of a mesh with this frame through `camera` in an image of width x height pixels.

    radius: of a sphere about the frame's origin that holds everything that will be drawn, normalised units (the original's
    is 1, a hull's a little more). It sets near and far only; `fit` always fits the original. Parts of the mesh may lie
    behind the eye, and the eye may lie inside the mesh: near is then a small part of far. An orthographic camera has no
    place along its axis: nothing is ever behind it. around: the frame whose sphere an orbit turns about and fits, when it is not
    the mesh's own.
    Raises InvalidRequestError, with the field, when numbers overflow (an eye 1e30 radii away, a field of view of 1e-40).
    """
    if isinstance(camera, Camera):
        pose = _eye_target_pose(camera, frame)
        if camera.projection == "orthographic":
            return _orthographic(pose, _positive(float(camera.height or 0.0) / frame.scale, "camera.height"), (width, height), radius)
        return _perspective(pose, _focal(camera.fov_y_deg, "camera.fov_y_deg"), (width, height), radius)
    focal = _focal(camera.orbit.fov_y_deg, "camera.orbit.fov_y_deg")
    pose = _seen_from(_orbit_pose(camera.orbit, around or frame, focal, width / height), around or frame, frame)
    return _perspective(pose, focal, (width, height), radius)


def project(view: View, points: Array) -> F8:
    """(n, 3) points in the normalised frame -> (n, 4) f8 clip coordinates."""
    p = np.asarray(points, np.float64).reshape(-1, 3)
    return np.asarray(p @ view.matrix[:, :3].T + view.matrix[:, 3])


def to_pixels(view: View, clip: F8) -> F8:
    """(n, 4) clip coordinates -> (n, 2) f8 pixels: x to the right, y down, (0, 0) the corner of the top left pixel.

    Points with w <= 0 are behind the eye; their rows are NaN.
    """
    w = np.where(clip[:, 3] > 0.0, clip[:, 3], np.nan)
    return np.column_stack([(clip[:, 0] / w + 1.0) * (0.5 * view.width), (1.0 - clip[:, 1] / w) * (0.5 * view.height)])


def _eye_target_pose(camera: Camera, frame: Frame) -> _Pose:
    backward = _unit(_minus(camera.eye, camera.target))
    right = _unit(_cross(_unit(camera.up), backward))
    rotation = (right, _cross(backward, right), backward)
    eye, target = _normalised(camera.eye, frame), _normalised(camera.target, frame)
    if camera.projection == "orthographic":
        return _Pose(rotation, _seen(rotation, _nearer(eye, target, "camera.eye")), (*backward, 0.0))
    _near_enough(eye, "camera.eye")
    across = _seen(rotation, _nearer(eye, target, "camera.eye"))
    return _Pose(rotation, (across[0], across[1], _seen(rotation, eye)[2]), (*eye, 1.0))


def _orbit_pose(orbit: Orbit, frame: Frame, focal: float, aspect: float) -> _Pose:
    """The exact basis of the sphere's coordinates; unlike one made from "up", it has no pole."""
    sin_a, cos_a = _sin_cos(orbit.azimuth_deg)
    sin_e, cos_e = _sin_cos(orbit.elevation_deg)
    backward = (cos_e * sin_a, sin_e, cos_e * cos_a)
    up = (-sin_e * sin_a, cos_e, -sin_e * cos_a)
    right = (cos_a, 0.0, -sin_a)
    if orbit.distance == "fit":
        distance = _positive(_fit_distance(focal, aspect), "camera.orbit.fov_y_deg")
    else:
        distance = _positive(orbit.distance / frame.scale, "camera.orbit.distance")
    eye = (backward[0] * distance, backward[1] * distance, backward[2] * distance, 1.0)
    return _Pose((right, up, backward), (0.0, 0.0, -distance), eye)


def _seen_from(pose: _Pose, around: Frame, frame: Frame) -> _Pose:
    """A pose about one frame as a pose in another."""
    if around == frame:
        return pose
    shift = _normalised(around.centre, frame)
    ratio = around.scale / frame.scale
    moved = _seen(pose.rotation, shift)
    origin = (pose.origin[0] * ratio + moved[0], pose.origin[1] * ratio + moved[1], pose.origin[2] * ratio + moved[2])
    eye = (pose.eye[0] * ratio + shift[0], pose.eye[1] * ratio + shift[1], pose.eye[2] * ratio + shift[2], 1.0)
    return _Pose(pose.rotation, _near_enough(origin, "camera"), eye)


def _fit_distance(focal: float, aspect: float) -> float:
    """Where the unit sphere's outline is FIT_MARGIN inside the narrower field of view: radius / sin(half angle)."""
    narrow = focal / min(aspect, 1.0)
    return FIT_MARGIN * math.hypot(1.0, narrow)


def _perspective(pose: _Pose, focal: float, size: tuple[int, int], radius: float) -> View:
    width, height = size
    near, far, forwards, shift = _depths(-pose.origin[2], radius * DEPTH_MARGIN)
    rows = (
        _row(pose, 0, focal * height / width),
        _row(pose, 1, focal),
        (*_scaled(pose.rotation[2], forwards), shift),
        _row(pose, 2, -1.0),
    )
    return _checked(pose, rows, size, (near, far), focal * height / 2.0)


def _depths(depth: float, reach: float) -> tuple[float, float, float, float]:
    """(near, far, forwards, shift): the range of depths, and the matrix row forwards * (backward . p) + shift that takes it to -w ... w.

    depth: of the middle of a sphere of radius `reach` that holds everything; it may be behind the eye.
    """
    if depth + reach <= 0.0:
        # any range will do, nothing is visible
        near, far = reach * NEAREST_PART, reach
        forwards = -(far + near) / (far - near)
        return near, far, forwards, -forwards * depth - 2.0 * far * near / (far - near)
    far, beyond = depth + reach, reach
    near, before = depth - reach, reach
    if near < far * NEAREST_PART:
        near, before = far * NEAREST_PART, depth - far * NEAREST_PART
    # -(f + n) / (f - n) z - 2 f n / (f - n) with z = r.p - depth, n = depth - before, f = depth + beyond, cancelled by hand
    return near, far, -(far + near) / (before + beyond), (2.0 * before * beyond - depth * (beyond - before)) / (before + beyond)


def _orthographic(pose: _Pose, image_height: float, size: tuple[int, int], radius: float) -> View:
    width, height = size
    reach = radius * DEPTH_MARGIN
    placed = _Pose(pose.rotation, (pose.origin[0], pose.origin[1], -2.0 * reach), pose.eye)
    rows = (
        _row(placed, 0, 2.0 / image_height * height / width),
        _row(placed, 1, 2.0 / image_height),
        (*_scaled(pose.rotation[2], -1.0 / reach), 0.0),
        (0.0, 0.0, 0.0, 1.0),
    )
    return _checked(placed, rows, size, (reach, 3.0 * reach), height / image_height)


def _checked(
    pose: _Pose, rows: tuple[tuple[float, ...], ...], size: tuple[int, int], depths: tuple[float, float], pixel_scale: float
) -> View:
    if not all(-FARTHEST <= number <= FARTHEST for row in rows for number in row):
        raise InvalidRequestError("the camera's eye, target and field of view are too extreme together", field="camera")
    turned = [(*axis, shift) for axis, shift in zip(pose.rotation, pose.origin, strict=True)]
    eye, matrix, view = np.array(pose.eye), np.array(rows), np.array([*turned, (0.0, 0.0, 0.0, 1.0)])
    for array in (eye, matrix, view):
        array.setflags(write=False)
    return View(eye, matrix, view, size[0], size[1], depths[0], depths[1], pixel_scale)


def _row(pose: _Pose, axis: int, scale: float) -> tuple[float, ...]:
    return (*_scaled(pose.rotation[axis], scale), pose.origin[axis] * scale)


def _focal(fov_y_deg: float, field: str) -> float:
    """1 / tan(half the field of view)."""
    half = math.radians(fov_y_deg) / 2.0
    focal = math.cos(half) / math.sin(half) if half > 1.0 / FARTHEST else math.inf
    if focal < LEAST_FOCAL:
        raise InvalidRequestError(f"{field} is too close to 180 degrees", field=field)
    return _positive(focal, field)


def _positive(value: float, field: str) -> float:
    """`value` when it can be used as a length in the normalised frame."""
    if not 1.0 / FARTHEST <= value <= FARTHEST:
        raise InvalidRequestError(f"{field} is too extreme for this mesh", field=field)
    return value


def _near_enough(vector: Vector, field: str) -> Vector:
    if not all(-FARTHEST <= number <= FARTHEST for number in vector):
        raise InvalidRequestError(f"{field} is too far away for this mesh", field=field)
    return vector


def _nearer(a: Vector, b: Vector, field: str) -> Vector:
    """The one of two points that is nearer to the origin, by its largest coordinate."""
    return _near_enough(a if _largest(a) <= _largest(b) else b, field)


def _normalised(point: Sequence[float], frame: Frame) -> Vector:
    x, y, z = _minus(point, frame.centre)
    return x / frame.scale, y / frame.scale, z / frame.scale


def _seen(rotation: tuple[Vector, Vector, Vector], point: Vector) -> Vector:
    """The frame's origin along the camera's axes, from a camera at this point."""
    x, y, z = point
    right, up, backward = rotation
    return (
        -(right[0] * x + right[1] * y + right[2] * z),
        -(up[0] * x + up[1] * y + up[2] * z),
        -(backward[0] * x + backward[1] * y + backward[2] * z),
    )


def _minus(a: Sequence[float], b: Sequence[float]) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _scaled(vector: Vector, by: float) -> Vector:
    return vector[0] * by, vector[1] * by, vector[2] * by


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _largest(vector: Sequence[float]) -> float:
    return max(abs(vector[0]), abs(vector[1]), abs(vector[2]))


def _unit(vector: Sequence[float]) -> Vector:
    """A unit vector, for vectors of any length; nan for zero, whose direction nobody knows."""
    largest = _largest(vector)
    if largest == 0.0:
        return math.nan, math.nan, math.nan
    scaled = vector[0] / largest, vector[1] / largest, vector[2] / largest
    length = math.sqrt(scaled[0] * scaled[0] + scaled[1] * scaled[1] + scaled[2] * scaled[2])
    return scaled[0] / length, scaled[1] / length, scaled[2] / length


def _sin_cos(degrees: float) -> tuple[float, float]:
    """Sine and cosine, exact at multiples of 90 degrees."""
    turns = math.remainder(degrees, 360.0)
    quarter = round(turns / 90.0)
    rest = math.radians(turns - 90.0 * quarter)
    s, c = math.sin(rest), math.cos(rest)
    return ((s, c), (c, -s), (-s, -c), (-c, s))[quarter % 4]
