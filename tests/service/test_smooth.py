import json
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import load
from scipy.ndimage import distance_transform_edt

from geometry.shading import shading_normals
from geometry.topology import build_edges
from schemas.errors import InvalidRequestError
from schemas.render import Camera, Orbit, OrbitCamera, ProjectTo, SilhouetteRequest
from service.camera import resolve_camera
from service.silhouette.coverage import coverage_mask
from service.silhouette.describe import describe_silhouette
from service.silhouette.document import silhouette_binary, silhouette_json, silhouette_svg
from service.silhouette.project import following, pixel_matrix, project_edges
from service.silhouette.smooth import SmoothSurface
from service.silhouette.smooth_mask import smooth_mask
from tests import meshes
from tests.service.oracles import silhouette
from tests.service.render.made import clippable

SIDE = 256
TURNS = ((30, 20), (140, -10), (250, 50), (0, 0))
INSIDE_TORUS = Camera(eye=[0.0, 0.0, 0.0], target=[1.0, 0.2, 0.1], up=[0.0, 0.1, 1.0], fov_y_deg=60.0)
OVER_TORUS = Camera(eye=[1.0, 0.0, 0.6], target=[0.0, 1.0, 0.0], up=[0.0, 0.1, 1.0], fov_y_deg=60.0)


class Shape:
    """A mesh with the shading normals that loading would give it."""

    def __init__(self, mesh, frame=None):
        self.positions, self.faces, self.frame = meshes.normalised(mesh)
        if frame is not None:
            self.frame, self.positions = frame, frame.to_normalised(mesh[0]).astype(np.float32)
        self.shading = shading_normals(self.positions, self.faces)
        self.table = build_edges(self.faces)
        rows = (self.shading.normals, self.shading.normal_vertices, self.shading.corner_normals)
        self.surface = SmoothSurface((self.positions, self.faces), rows, (self.table.vertices, self.table.faces))

    def view(self, azimuth=30, elevation=20, camera=None, side=SIDE):
        camera = camera or OrbitCamera(orbit=Orbit(azimuth_deg=azimuth, elevation_deg=elevation))
        return resolve_camera(camera, self.frame, side, side)

    def mask(self, view):
        segments = project_edges(view, self.positions, silhouette(self.positions, self.faces, view.eye))
        return coverage_mask(segments, view.width, view.height).mask

    def smooth(self, view):
        return smooth_mask(self.surface.contours(view), view, self.mask(view))


def wrong_area(mask, true):
    """Pixels."""
    return np.abs(mask.astype(float) - true).sum() / 255.0


def cylinder(sections, height=2.0):
    made = trimesh.creation.cylinder(1.0, height, sections=sections)
    return np.asarray(made.vertices), np.asarray(made.faces, np.int32)


def node_pixels(contours):
    return contours.corners[:, :2] / contours.corners[:, 2:]


def turns_at_nodes(contours):
    """(k,) radians between the end of the piece before each node and the beginning of the one after it."""
    at, after = node_pixels(contours), following(contours.offsets)
    leaving = contours.inner[:, 0] - at
    arriving = np.empty_like(leaving)
    arriving[after] = at[after] - contours.inner[:, 1]
    across = leaving[:, 0] * arriving[:, 1] - leaving[:, 1] * arriving[:, 0]
    return np.abs(np.arctan2(across, (leaving * arriving).sum(axis=1)))


@pytest.mark.parametrize(("subdivisions", "factor"), [(1, 50.0), (2, 10.0), (3, 15.0)])
def test_outline_of_a_coarse_sphere_is_a_circle(subdivisions, factor):
    """Of 80, 320 and 1280 faces; how far the outline is from the circle, against the mesh's own."""
    shape = Shape(meshes.sphere(subdivisions))
    worst = {"mesh": 0.0, "smooth": 0.0}
    for azimuth, elevation in TURNS:
        view = shape.view(azimuth, elevation)
        radius = view.pixel_scale / np.sqrt(view.eye[:3] @ view.eye[:3] - 1.0)
        segments = project_edges(view, shape.positions, silhouette(shape.positions, shape.faces, view.eye))
        middles = (segments[:, :2] + segments[:, 2:]) / 2.0
        corners, _ = shape.surface.contours(view).flattened(SIDE, SIDE)
        for name, points in (("mesh", middles), ("smooth", corners[:, :2] / corners[:, 2:])):
            worst[name] = max(worst[name], np.abs(np.linalg.norm(points - SIDE / 2.0, axis=1) - radius).max())
    assert worst["mesh"] > factor * worst["smooth"]


@pytest.mark.parametrize(
    ("coarse", "fine", "factor"),
    [
        (meshes.sphere(2), meshes.sphere(5), 20.0),
        (meshes.torus(20, 10), meshes.torus(200, 100), 8.0),
        (meshes.torus(32, 16), meshes.torus(320, 160), 10.0),
        (meshes.bumpy_sphere(3), meshes.bumpy_sphere(5), 4.0),
        (cylinder(12), cylinder(240), 8.0),
    ],
    ids=["sphere of 320", "torus of 400", "torus of 1024", "bumpy sphere of 1280", "cylinder of 48"],
)
def test_area_between_a_coarse_outline_and_the_fine_one_shrinks(coarse, fine, factor):
    shape = Shape(coarse)
    reference = Shape(fine, shape.frame)
    mesh, smooth = 0.0, 0.0
    for azimuth, elevation in TURNS:
        view = shape.view(azimuth, elevation)
        true = reference.mask(view)
        mesh += wrong_area(shape.mask(view), true)
        smooth += wrong_area(shape.smooth(view), true)
    assert mesh > factor * smooth


@pytest.mark.parametrize("mesh", [meshes.sphere(2), meshes.torus(20, 10), meshes.bumpy_sphere(3), meshes.knot(80, 12)])
def test_pieces_meet_with_the_same_tangent_or_turn_back_in_a_cusp(mesh):
    shape = Shape(mesh)
    assert not shape.shading.creased
    for azimuth, elevation in TURNS:
        turns = turns_at_nodes(shape.surface.contours(shape.view(azimuth, elevation)))
        assert np.minimum(turns, np.pi - turns).max() < 1e-5


def test_convex_outline_never_turns_abruptly():
    shape = Shape(meshes.sphere(2))
    for azimuth, elevation in TURNS:
        corners, offsets = shape.surface.contours(shape.view(azimuth, elevation)).flattened(SIDE, SIDE)
        assert len(offsets) == 2
        points = corners[:, :2] / corners[:, 2:]
        side = np.roll(points, -1, axis=0) - points
        side = side[np.linalg.norm(side, axis=1) > 1e-3]
        turn = np.diff(np.unwrap(np.arctan2(side[:, 1], side[:, 0])))
        assert np.abs(turn).max() < np.radians(10.0)
        polygon_turn = 2.0 * np.pi / len(silhouette(shape.positions, shape.faces, shape.view(azimuth, elevation).eye))
        assert np.abs(turn).max() < 2.0 * polygon_turn


@pytest.mark.parametrize("turn", TURNS)
def test_cube_is_as_it_was(turn):
    shape = Shape(meshes.cube(3))
    view = shape.view(*turn)
    assert np.abs(shape.smooth(view).astype(int) - shape.mask(view)).max() <= 1
    contours = shape.surface.contours(view)
    assert contours.reach_px < 1e-3
    corners = np.flatnonzero(np.abs(np.abs(shape.positions).max(axis=1) - np.abs(shape.positions).min(axis=1)) < 1e-6)
    assert len(corners) == 8
    seen = [p for p in view_pixels(view, shape.positions[corners]) if np.linalg.norm(node_pixels(contours) - p, axis=1).min() < 1e-6]
    assert len(seen) >= 4


def view_pixels(view, positions):
    clip = positions.astype(float) @ view.matrix[:, :3].T + view.matrix[:, 3]
    return np.column_stack([(clip[:, 0] / clip[:, 3] + 1) * view.width / 2, (1 - clip[:, 1] / clip[:, 3]) * view.height / 2])


def test_cylinder_keeps_its_corners_and_its_straight_sides():
    """From the side: two rims, seen as lines, and two rulings, at right angles."""
    shape = Shape(cylinder(16))
    assert shape.shading.creased
    camera = Camera(eye=[9.0, 0.3, 0.0], up=[0.0, 0.0, 1.0], projection="orthographic", height=3.0)
    view = shape.view(camera=camera)
    smooth, mesh = shape.smooth(view), shape.mask(view)
    rows = np.flatnonzero(mesh.max(axis=1))
    assert np.array_equal(np.flatnonzero(smooth.max(axis=1)), rows)
    assert np.array_equal(smooth.max(axis=1)[rows], mesh.max(axis=1)[rows])
    width = smooth[rows[2:-2]].sum(axis=1) / 255.0
    radius = SIDE / 3.0
    assert np.ptp(width) < 0.05
    assert abs(width.mean() - 2.0 * radius) < 0.05
    sharp = turns_at_nodes(shape.surface.contours(view))
    assert (np.abs(sharp - np.pi / 2.0) < 0.1).sum() >= 4


def test_far_and_parallel_views_agree():
    shape = Shape(meshes.torus(20, 10))
    parallel = Camera(eye=[3.0, 2.0, 4.0], projection="orthographic", height=3.0)
    distant = Camera(eye=[3e4, 2e4, 4e4], fov_y_deg=np.degrees(2 * np.arctan(1.5 / np.linalg.norm([3e4, 2e4, 4e4]))))
    a, b = (shape.smooth(shape.view(camera=camera)) for camera in (parallel, distant))
    assert np.abs(a.astype(int) - b).max() <= 1


@pytest.mark.parametrize("camera", [INSIDE_TORUS, OVER_TORUS])
def test_parts_behind_the_eye_are_cut_off_like_the_mesh_own(camera):
    shape = Shape(meshes.torus(160, 80))
    view = shape.view(camera=camera, side=64)
    assert np.abs(shape.smooth(view).astype(int) - shape.mask(view)).max() <= 8


@pytest.mark.parametrize("mesh", [meshes.sphere(1), meshes.torus(12, 10), meshes.bumpy_sphere(2, 0.6), meshes.knot(60, 8), cylinder(9)])
def test_outline_stays_within_its_reach_of_the_mesh(mesh):
    shape = Shape(mesh)
    for azimuth, elevation in TURNS:
        view = shape.view(azimuth, elevation)
        reach = shape.surface.contours(view).reach_px
        mask, smooth = shape.mask(view), shape.smooth(view)
        outside, inside = distance_transform_edt(mask == 0), distance_transform_edt(mask == 255)
        assert outside[smooth > 0].max(initial=0.0) <= reach + 2.0
        assert inside[smooth < 255].max(initial=0.0) <= np.sqrt(2.0) * (reach + 4.0)


def test_slivers_that_contours_close_together_leave_inside_are_filled():
    shape = Shape(meshes.bumpy_sphere(3, 0.8))
    view = shape.view(140, -10)
    contours = shape.surface.contours(view)
    bare, mesh = coverage_mask(contours.segments(view), SIDE, SIDE).mask, shape.mask(view)
    inside = distance_transform_edt(mesh == 255) > np.sqrt(2.0) * contours.reach_px + 2.0
    assert (bare[inside] < 255).any()
    assert (shape.smooth(view)[inside] == 255).all()


@given(seed=st.integers(0, 2**32 - 1), wild=st.floats(0.0, 1.5), near=st.floats(0.05, 3.0))
@settings(deadline=None, max_examples=60)
def test_curves_of_any_normals_are_closed_finite_and_near(seed, wild, near):
    """Normals and positions as random as can be, an eye anywhere: within half a piece of nodes within half an edge of the mesh."""
    rng = np.random.default_rng(seed)
    positions, faces = meshes.sphere(1)
    positions = (positions * rng.uniform(1.0 - wild / 2.0, 1.0, (len(positions), 1))).astype(np.float32)
    shading = shading_normals(positions, faces, float(rng.uniform(0.1, 3.0)))
    normals = shading.normals + wild * rng.normal(size=shading.normals.shape)
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    table = build_edges(faces)
    rows = (normals, shading.normal_vertices, shading.corner_normals)
    surface = SmoothSurface((positions, faces), rows, (table.vertices, table.faces))
    camera = Camera(eye=list(near * rng.normal(size=3)), target=list(rng.normal(size=3)), fov_y_deg=70.0)
    view = resolve_camera(camera, meshes.normalised(meshes.sphere(1))[2], 64, 64)
    contours = surface.contours(view)
    longest = np.linalg.norm(positions[table.vertices[:, 0]] - positions[table.vertices[:, 1]], axis=1).max()
    segments = contours.segments(view)
    assert np.isfinite(segments).all()
    assert np.isfinite(contours.corners).all()
    assert np.diff(contours.offsets).min(initial=1) >= 1
    if len(contours.corners):
        matrix = pixel_matrix(view)
        places = (contours.corners - matrix[:, 3]) @ np.linalg.inv(matrix[:, :3]).T
        apart = np.linalg.norm(places[:, None] - positions[None].astype(float), axis=2).min(axis=1)
        assert apart.max() <= longest + 1e-6


def test_eye_inside_a_sphere_sees_no_contour():
    shape = Shape(meshes.sphere(2))
    camera = Camera(eye=[0.1, 0.0, 0.0], target=[1.0, 0.0, 0.0])
    contours = shape.surface.contours(shape.view(camera=camera))
    assert len(contours.corners) == 0
    assert contours.segments(shape.view(camera=camera)).shape == (0, 4)


ASKED = SilhouetteRequest(camera=OrbitCamera(orbit=Orbit(azimuth_deg=25.0)), project=ProjectTo(width=SIDE, height=SIDE), smooth=True)


def as_polygons(curves, steps=16):
    """Closed polygons of curves (3 n, 2)."""
    t = np.arange(steps)[:, None] / steps
    polygons = []
    for curve in curves:
        points = np.asarray(curve).reshape(-1, 3, 2)
        a, b, c, d = points[:, 0], points[:, 1], points[:, 2], np.roll(points[:, 0], -1, axis=0)
        parts = [(1 - t) ** 3 * a[k] + 3 * (1 - t) ** 2 * t * b[k] + 3 * (1 - t) * t**2 * c[k] + t**3 * d[k] for k in range(len(a))]
        polygons.append(np.concatenate(parts))
    return polygons


def mask_of(polygons):
    segments = [np.column_stack([p, np.roll(p, -1, axis=0)]) for p in polygons]
    return coverage_mask(np.concatenate(segments), SIDE, SIDE).mask


def test_curves_of_the_documents_are_those_of_the_picture():
    asset = clippable("bumpy")
    described = describe_silhouette(asset, ASKED)
    view = resolve_camera(ASKED.camera, asset.frame, SIDE, SIDE)
    drawn = coverage_mask(asset.smooth_surface.contours(view).segments(view), SIDE, SIDE).mask
    answer, tensors = json.loads(silhouette_json(described)), load(silhouette_binary(described))
    split = np.split(tensors["curves"], tensors["curve_offsets"][1:-1])
    (path,) = ElementTree.fromstring(silhouette_svg(described)).iter("{http://www.w3.org/2000/svg}path")
    loops = re.findall(r"M([^C]*)C([^Z]*)Z", path.attrib["d"])
    assert "".join(f"M{a}C{b}Z" for a, b in loops) == path.attrib["d"]
    svg = [np.array([p.split(",") for p in f"{a} {b}".split(" ")], float)[:-1] for a, b in loops]
    for curves in (answer["curves"], split, svg):
        assert np.abs(mask_of(as_polygons(curves)).astype(int) - drawn).max() <= 30
        assert wrong_area(mask_of(as_polygons(curves)), drawn) < 0.01 * wrong_area(drawn, 0.0)
    assert [len(curve) for curve in split] == [len(curve) for curve in answer["curves"]] == [len(curve) for curve in svg]


def test_edges_and_contours_stay_those_of_the_mesh():
    asset = clippable("bumpy")
    smooth, plain = (json.loads(silhouette_json(describe_silhouette(asset, ASKED.model_copy(update={"smooth": s})))) for s in (True, False))
    assert {name for name in smooth if smooth[name] != plain.get(name)} == {"curves"}


def test_curves_that_are_cut_off_come_as_polygons():
    asset = clippable("torus")
    request = SilhouetteRequest(camera=OVER_TORUS, project=ProjectTo(width=SIDE, height=SIDE), smooth=True)
    described = describe_silhouette(asset, request)
    drawn = described.outline.polygons()
    assert described.outline.inner is None
    assert np.isfinite(np.concatenate(described.curves)).all()
    assert np.abs(mask_of(as_polygons(described.curves)).astype(int) - mask_of(drawn)).max() <= 1
    assert b"C" not in silhouette_svg(described).split(b' d="')[1].split(b'"')[0]


def test_curves_without_an_image_are_refused():
    with pytest.raises(InvalidRequestError) as caught:
        describe_silhouette(clippable("torus"), SilhouetteRequest(smooth=True))
    assert caught.value.where["field"] == "smooth"
