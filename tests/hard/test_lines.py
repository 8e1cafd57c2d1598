"""Vector lines where things coincide: faces seen edge-on, edges behind edges, bodies that touch, share planes or lie in one another."""

import numpy as np
import pytest

from schemas.errors import InvalidRequestError
from schemas.lines import LineKind, Stroke
from schemas.render import Camera, ProjectTo, SilhouetteRequest
from service.camera import project, resolve_camera, to_pixels
from service.kernels import line_image
from service.silhouette.line_mesh import LineMesh
from service.silhouette.lines import Passes, find_pieces, vector_lines
from service.silhouette.strokes import moved_px, outlines_of, stroked_lines, triangles_of
from tests import eye_cases, meshes
from tests.service.line_oracles import distance_to, hidden_by_rays

CUBE = meshes.cube()
LEAST_PX = 1e-6


def shifted(by, scale=1.0, mesh=CUBE):
    return mesh[0] * scale + np.asarray(by, float), mesh[1]


def unwelded(mesh):
    return mesh[0][mesh[1]].reshape(-1, 3), np.arange(3 * len(mesh[1]), dtype=np.int32).reshape(-1, 3)


def square(axis):
    """Two faces across an axis, through the middle."""
    corners = np.insert(np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]), axis, 0.1 * axis, axis=1)
    return corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def heap():
    """Random triangles through each other."""
    return np.random.default_rng(5).uniform(-1, 1, (90, 3)), np.arange(90, dtype=np.int32).reshape(-1, 3)


SCENES = {
    "squares through each other": lambda: meshes.joined(*(square(axis) for axis in range(3))),
    "a heap of triangles": heap,
    "cube of many faces": lambda: meshes.cube(3),
    "cubes side by side": lambda: meshes.joined(CUBE, shifted([1, 0, 0])),
    "cubes touching along an edge": lambda: meshes.joined(CUBE, shifted([1, 1, 0])),
    "a small cube on a large one": lambda: meshes.joined(CUBE, shifted([0.25, 1.0, 0.25], 0.5)),
    "a cube in a cube that shares a plane": lambda: meshes.joined(CUBE, shifted([0.25, 0.0, 0.25], 0.5)),
    "cubes through each other on a grid": lambda: meshes.joined(CUBE, shifted([0.5, 0.5, 0.5])),
    "rows of cubes behind each other": lambda: meshes.joined(*(shifted([2.0 * i, 2.0 * j, 0.0]) for i in range(3) for j in range(3))),
    "a cube without welded corners": lambda: unwelded(CUBE),
    "the same cube twice": lambda: meshes.joined(CUBE, CUBE),
    "a cube and its inside": lambda: meshes.joined(CUBE, (CUBE[0], CUBE[1][:, ::-1])),
    "a cube without a lid": lambda: (CUBE[0], CUBE[1][2:]),
    "faces turned at random": lambda: (CUBE[0], np.where((np.arange(12) % 3 == 0)[:, None], CUBE[1][:, ::-1], CUBE[1]).astype(np.int32)),
}


def found(mesh, camera_of):
    """(pieces, view, mesh) as seen by the camera that camera_of(frame) gives."""
    positions, faces, frame = meshes.normalised(mesh)
    ready = LineMesh(positions, np.ascontiguousarray(faces, np.int32))
    wanted = SilhouetteRequest(camera=camera_of(frame), project=ProjectTo(width=200, height=200), kinds=list(LineKind))
    view = resolve_camera(wanted.camera, frame, 200, 200)
    return find_pieces(ready, view, wanted, Passes()), view, ready


def lengths(pieces):
    """(p,) f8 pixels."""
    ends = pieces.image[pieces.line]
    return np.hypot(ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1]) * (pieces.spans[:, 1] - pieces.spans[:, 0])


def check(pieces, view, ready):
    """Visibility in the middle of each piece and off it; pieces that nobody could see are let be."""
    long = lengths(pieces) > LEAST_PX
    for part in (0.5, 0.21, 0.83):
        points = []
        for line, (a, b) in zip(pieces.line, pieces.spans, strict=True):
            t = line_image.along(pieces.image, line, a + part * (b - a))
            ends = pieces.segments.ends[line]
            points.append(ends[:3] + t * (ends[3:] - ends[:3]))
        if points:
            hidden, sure = hidden_by_rays(view, ready.positions, ready.faces, np.array(points))
            assert np.array_equal(hidden[sure & long], ~pieces.visible[sure & long])


@pytest.mark.parametrize("direction", [[0, 0, 1], [1, 0, 0], [0, -1, 0], [1, 1, 0], [1, 1, 1], [0.3, 0.5, 1.0], [-2.0, 1.0, 0.5]])
@pytest.mark.parametrize("scene", SCENES)
def test_visibility_is_that_of_rays_where_things_coincide(scene, direction):
    def camera(frame):
        eye = np.array(frame.centre) + frame.scale * np.array(direction, float)
        return Camera(eye=eye.tolist(), target=list(frame.centre), up=[0.1, 0.7, -0.6], projection="orthographic", height=2.2 * frame.scale)

    check(*found(SCENES[scene](), camera))


@pytest.mark.parametrize("scene", list(SCENES)[:8:2])
def test_visibility_is_that_of_rays_from_eyes_in_awkward_places(scene):
    positions, faces, _ = meshes.normalised(SCENES[scene]())
    tried = 0
    for eye in eye_cases.awkward(positions, faces).values():

        def camera(frame, eye=eye):
            place = np.array(frame.centre) + frame.scale * eye[:3]
            more = {} if eye[3] else {"projection": "orthographic", "height": 2.2 * frame.scale}
            target = np.array(frame.centre) + frame.scale * np.array([0.001, 0.002, -0.003])
            return Camera(eye=place.tolist(), target=target.tolist(), up=[0.1, 1.0, 0.2], **more)

        try:
            pieces, view, ready = found(SCENES[scene](), camera)
        except InvalidRequestError:
            continue
        tried += 1
        check(pieces, view, ready)
    assert tried > 12


@pytest.mark.parametrize("seed", range(24))
def test_visibility_is_that_of_rays_in_random_heaps(seed):
    """Triangles with corners anywhere, or on a grid, where many coincide; cameras as well."""
    rng = np.random.default_rng(seed)
    count = 3 * int(rng.integers(2, 12))
    corners = rng.integers(-2, 3, (count, 3)).astype(float) if seed % 2 else rng.uniform(-1, 1, (count, 3))
    direction = rng.integers(1, 4, 3) * rng.choice([-1.0, 1.0], 3) if seed % 3 else rng.normal(size=3)

    def camera(frame):
        eye = np.array(frame.centre) + 1.5 * frame.scale * direction
        more = {} if seed % 4 else {"projection": "orthographic", "height": 2.2 * frame.scale}
        return Camera(eye=eye.tolist(), target=list(frame.centre), up=[0.1, 0.7, -0.6], **more)

    check(*found((corners, np.arange(count, dtype=np.int32).reshape(-1, 3)), camera))


STROKE = Stroke(width_by="depth", opacity_by="curvature", dash=[5.0, 3.0], wobble_px=4.0, wobble_length_px=9.0)


@pytest.mark.parametrize("scene", SCENES)
def test_strokes_keep_to_their_lines_from_eyes_in_awkward_places(scene):
    positions, faces, frame = meshes.normalised(SCENES[scene]())
    ready = LineMesh(positions, np.ascontiguousarray(faces, np.int32))
    drawn = 0
    for eye in eye_cases.awkward(positions, faces).values():
        place = np.array(frame.centre) + frame.scale * eye[:3]
        more = {} if eye[3] else {"projection": "orthographic", "height": 2.2 * frame.scale}
        camera = Camera(eye=place.tolist(), target=list(frame.centre + frame.scale * np.array([0.001, 0.002, -0.003])), **more)
        wanted = SilhouetteRequest(camera=camera, project=ProjectTo(width=120, height=90), kinds=list(LineKind))
        try:
            view = resolve_camera(camera, frame, 120, 90)
        except InvalidRequestError:
            continue
        lines = vector_lines(ready, view, wanted)
        strokes = stroked_lines(ready, view, wanted, STROKE, dict.fromkeys(LineKind, 3.0), 0)
        assert all(np.isfinite(part).all() for part in (strokes.points, strokes.widths, strokes.opacities))
        assert np.isfinite(outlines_of(strokes, 3.0)[0]).all() and np.isfinite(triangles_of(strokes, 3.0, 1.0)[0]).all()
        assert strokes.widths.min(initial=3.0) >= 0.25 * 0.6 * 3.0 - 1e-9 and strokes.widths.max(initial=0.0) <= 3.0 + 1e-9
        apart = [distance_to(points, closed, strokes.points) for points, closed in zip(lines.polylines(), lines.closed, strict=True)]
        if apart:
            assert np.min(apart, axis=0).max(initial=0.0) <= moved_px(STROKE) + 1e-6
            drawn += 1
    assert drawn > 4


def test_what_is_exactly_behind_a_line_is_hidden_by_it():
    """Of a row of cubes seen along it only the nearest is seen."""
    row = meshes.joined(*(shifted([0.0, 0.0, -2.0 * i]) for i in range(3)))
    eye = Camera(eye=[0.5, 0.5, 9.0], target=[0.5, 0.5, 0.0], projection="orthographic", height=1.5)
    pieces, view, ready = found(row, lambda _: eye)
    side = np.ptp(to_pixels(view, project(view, ready.positions[:8]))[:, 0])
    assert lengths(pieces)[pieces.visible].sum() == pytest.approx(4.0 * side)


def test_meshes_far_from_the_origin_have_the_same_lines():
    mesh, shift = meshes.bumpy_sphere(2, 0.5), np.array([2.0**20, -(2.0**20), 2.0**19])

    def before(frame):
        return Camera(eye=(np.array(frame.centre) + np.array([0.0, 0.0, 4.0])).tolist(), target=list(frame.centre))

    near, far = found(mesh, before)[0], found((mesh[0] + shift, mesh[1]), before)[0]
    assert lengths(near)[near.visible].sum() == pytest.approx(lengths(far)[far.visible].sum(), rel=1e-3)
