"""Vector lines against brute force: rays at every face, a depth buffer, all pairs of faces."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from geometry.topology import build_edges, face_normals
from schemas.errors import CapabilityError
from schemas.lines import LineKind
from schemas.render import Camera, Orbit, OrbitCamera, ProjectTo, SilhouetteRequest
from service.camera import project, resolve_camera, to_pixels
from service.kernels import line_kinds
from service.silhouette import line_mesh
from service.silhouette import lines as lines_module
from service.silhouette.line_mesh import LineMesh
from service.silhouette.lines import KINDS, vector_lines
from tests import meshes
from tests.service.line_oracles import crossing_length, depth_buffer, distance_to, hidden_by_rays

ALL = list(LineKind)
CORNER = OrbitCamera(orbit=Orbit(azimuth_deg=33.0, elevation_deg=21.0))
FLAT_ON = Camera(eye=[2.0, 3.0, 4.0], projection="orthographic", height=4.0)


def made(mesh):
    positions, faces, frame = meshes.normalised(mesh)
    return LineMesh(positions, np.ascontiguousarray(faces, np.int32)), frame


def drawn(mesh, camera=CORNER, size=400, kinds=ALL, **more):
    """(lines, view, mesh) of a mesh of tests.meshes."""
    ready, frame = made(mesh)
    wanted = SilhouetteRequest(camera=camera, project=ProjectTo(width=size, height=size), kinds=kinds, **more)
    view = resolve_camera(wanted.camera, frame, size, size)
    return vector_lines(ready, view, wanted), view, ready


def grid(n=6):
    """A bent sheet with a boundary."""
    x, y = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1))
    v = np.column_stack([x.ravel(), y.ravel(), 0.3 * np.sin(3 * x.ravel())])
    at = np.arange(n * (n + 1)).reshape(n, n + 1)[:, :-1].ravel()
    return v, np.concatenate([np.column_stack([at, at + 1, at + n + 2]), np.column_stack([at, at + n + 2, at + n + 1])]).astype(np.int32)


def crossing_cubes():
    v, f = meshes.cube()
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    return meshes.joined((v, f), (v @ turn.T * 0.9 + [0.55, 0.21, 0.37], f))


SHAPES = {
    "knot": lambda: meshes.knot(100, 12),
    "bumpy": lambda: meshes.bumpy_sphere(3, 0.5),
    "torus": meshes.torus,
    "crossing cubes": crossing_cubes,
    "sheet": grid,
    "crossing spheres": lambda: meshes.joined(meshes.sphere(2), meshes.sphere(2, 0.8, (0.7, 0.3, 0.5))),
}
CAMERAS = {"perspective": CORNER, "orthographic": FLAT_ON, "near": Camera(eye=[1.2, 1.1, 1.6], target=[0.1, 0.0, 0.0], fov_y_deg=70.0)}


def samples(lines, step=7):
    """(points (n, 2) pixels, visible (n,), line (n,)): places along the polylines, away from their points."""
    found, flags, of = [], [], []
    for number, (points, visible, closed) in enumerate(zip(lines.polylines(), lines.visible, lines.closed, strict=True)):
        ends = np.roll(points, -1, axis=0) if closed else points[1:]
        for i, (a, b) in enumerate(zip(points[: len(ends)], ends, strict=True)):
            if (i + number) % step == 0 and np.linalg.norm(b - a) > 1e-3:
                found.append(a + (0.37 + 0.3 * ((i * 7) % 3) / 3) * (b - a))
                flags.append(visible)
                of.append(number)
    return np.array(found).reshape(-1, 2), np.array(flags, bool), np.array(of, int)


def in_space(view, ready, lines, points, of):
    """Points of polylines in space: those of the edges, or of crossing segments, of their kind that project nearest to them."""
    matrix = view.pixels[[0, 1, 3]]
    ends = ready.positions[ready.fans.vertices].astype(np.float64)
    crossing = ready.crossings().ends.reshape(-1, 2, 3)
    out, off = np.empty((len(points), 3)), np.empty(len(points))
    for n, point in enumerate(points):
        pool = crossing if KINDS[lines.kinds[of[n]]] is LineKind.INTERSECTION else ends
        h = pool @ matrix[:, :3].T + matrix[:, 3]
        # on the segment where its projection is the point: a linear equation in homogeneous pixels, along the longer axis
        a, b = h[:, 0, :2] - h[:, 0, 2:] * point, h[:, 1, :2] - h[:, 1, 2:] * point
        d = a - b
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.clip(np.einsum("ni,ni->n", a, d) / np.einsum("ni,ni->n", d, d), 0.0, 1.0)
        at = pool[:, 0] + t[:, None] * (pool[:, 1] - pool[:, 0])
        hit = at @ matrix[:, :3].T + matrix[:, 3]
        far = np.where(hit[:, 2] > 0.0, np.linalg.norm(hit[:, :2] / hit[:, 2:] - point, axis=1), np.inf)
        best = np.nanargmin(far)
        out[n], off[n] = at[best], far[best]
    assert off.max(initial=0.0) < 1e-6
    return out


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("shape", SHAPES)
def test_visibility_is_that_of_rays_at_every_face(shape, camera):
    lines, view, ready = drawn(SHAPES[shape](), CAMERAS[camera], ridge_deg=25.0, valley_deg=25.0)
    points, visible, of = samples(lines)
    hidden, sure = hidden_by_rays(view, ready.positions, ready.faces, in_space(view, ready, lines, points, of))
    assert len(points) >= 4 and sure.mean() > 0.9
    assert np.array_equal(hidden[sure], ~visible[sure])


@pytest.mark.parametrize("camera", ["perspective", "orthographic"])
def test_visibility_is_that_of_a_depth_buffer(camera):
    lines, view, ready = drawn(meshes.knot(), CAMERAS[camera], kinds=[LineKind.SILHOUETTE])
    points, visible, of = samples(lines, 1)
    scale = 4
    depth = depth_buffer(view, ready.positions, ready.faces, scale)
    space = in_space(view, ready, lines, points, of)
    own = -(space @ view.view[2, :3] + view.view[2, 3])
    agree, compared = 0, 0
    for (x, y), z, seen in zip(points * scale, own, visible, strict=True):
        block = depth[max(int(y) - 2, 0) : int(y) + 3, max(int(x) - 2, 0) : int(x) + 3]
        before, all_before = (block < z - 0.02).any(), (block < z - 0.02).all()
        if before == all_before:  # no outline of something in front passes within a pixel
            agree, compared = agree + (seen != before), compared + 1
    assert compared > 150
    assert agree / compared >= 0.99


def vertex_pairs(lines, chosen):
    """The sides of the chosen (l,) bool polylines whose ends are both vertices: sorted pairs, as often as they come."""
    found = []
    for (a, b), wanted, closed in zip(pairwise(lines.offsets), chosen, lines.closed, strict=True):
        row = lines.vertices[a:b].tolist()
        sides = zip(row, [*row[1:], row[0]], strict=True) if closed else pairwise(row)
        found += [(min(p), max(p)) for p in sides if wanted and min(p) >= 0]
    return found


def test_nine_of_twelve_edges_of_a_cube_are_visible_and_lie_where_they_project():
    lines, view, ready = drawn(meshes.cube(), kinds=[LineKind.SILHOUETTE, LineKind.RIDGE])
    assert np.abs(lines.points - to_pixels(view, project(view, ready.positions[lines.vertices]))).max() < 1e-9
    seen, hidden = vertex_pairs(lines, lines.visible), vertex_pairs(lines, ~lines.visible)
    assert (len(seen), len(hidden), len({*seen, *hidden})) == (9, 3, 12)
    lengths = [np.linalg.norm(ready.positions[a] - ready.positions[b]) for a, b in seen + hidden]
    assert np.allclose(lengths, lengths[0])  # no diagonals


@pytest.mark.parametrize("eye", [[0.5, 0.5, 5.0], [5.0, 0.5, 0.5], [0.5, 4.0, 0.5]])
def test_of_a_cube_seen_square_on_one_face_is_visible(eye):
    camera = Camera(eye=eye, target=[0.5, 0.5, 0.5], up=[0.1, 0.9, 1.0], projection="orthographic", height=2.0)
    lines, _, _ = drawn(meshes.cube(), camera, kinds=[LineKind.SILHOUETTE, LineKind.RIDGE])
    shown = [p for p, visible in zip(lines.polylines(), lines.visible, strict=True) if visible]
    corners = np.unique(np.round(np.concatenate(shown), 6), axis=0)
    assert len(corners) == 4
    total = sum(np.linalg.norm(np.diff(p, axis=0), axis=1).sum() for p in shown)
    total += sum(np.linalg.norm(p[0] - p[-1]) for p, v, c in zip(lines.polylines(), lines.visible, lines.closed, strict=True) if v and c)
    assert total == pytest.approx(4 * 200.0)


def test_a_cube_behind_another_is_hidden_exactly_where_the_other_is_before_it():
    v, f = meshes.cube()
    lines, view, ready = drawn(meshes.joined((v, f), (0.8 * v + [0.3, 0.35, 1.6], f)), kinds=[LineKind.SILHOUETTE, LineKind.RIDGE])
    front = to_pixels(view, project(view, ready.positions[8:]))
    hull = ConvexHull(front).equations
    points, visible, of = samples(lines, 1)
    space = in_space(view, ready, lines, points, of)
    behind = space[:, 2] < ready.positions[8:, 2].min() - 1e-6
    alone, _, _ = drawn((v, f), camera=CORNER)
    assert alone.visible.sum() >= 3
    outside = (points @ hull[:, :2].T + hull[:, 2]).max(axis=1)
    assert not visible[behind & (outside < -0.01)].any()
    ends = [i for a, b in pairwise(lines.offsets) for i in (a, b - 1)]
    cuts = lines.points[[i for i in ends if lines.vertices[i] < 0]]
    assert len(cuts) >= 4
    assert np.abs((cuts @ hull[:, :2].T + hull[:, 2]).max(axis=1)).max() < 1e-6


def test_the_far_inner_contour_of_a_torus_is_partly_hidden():
    lines, _, _ = drawn(meshes.torus(60, 30), Camera(eye=[0.0, -4.0, 1.6], up=[0, 0, 1]), kinds=[LineKind.SILHOUETTE])
    lengths = [np.linalg.norm(np.diff(p, axis=0), axis=1).sum() for p in lines.polylines()]
    hidden = sum(n for n, visible in zip(lengths, lines.visible, strict=True) if not visible)
    assert 0.1 < hidden / sum(lengths) < 0.5


def test_the_boundary_of_an_open_sheet_is_one_closed_visible_line():
    lines, view, ready = drawn(grid(), Camera(eye=[0.0, 0.0, 5.0]), kinds=[LineKind.BOUNDARY])
    assert (len(lines), lines.visible.tolist(), lines.closed.tolist(), len(lines.points)) == (1, [True], [True], 24)
    assert {KINDS[k] for k in lines.kinds} == {LineKind.BOUNDARY}
    assert np.allclose(lines.points, to_pixels(view, project(view, ready.positions[lines.vertices])))


def test_kinds_are_those_of_the_angles_between_faces():
    mesh = meshes.bumpy_sphere(3, 0.6)
    lines, _, ready = drawn(mesh, kinds=[LineKind.RIDGE, LineKind.VALLEY], ridge_deg=20.0, valley_deg=12.0)
    edges, normals = build_edges(ready.faces), face_normals(ready.positions, ready.faces)
    one, two = normals[edges.faces[:, 0]], normals[edges.faces[:, 1]]
    angle = np.degrees(np.arccos(np.clip(np.einsum("ei,ei->e", one, two), -1, 1)))
    third = ready.positions[ready.faces[edges.faces[:, 1]]].astype(float).sum(axis=1) - ready.positions[edges.vertices].sum(axis=1)
    convex = np.einsum("ei,ei->e", third - ready.positions[edges.vertices[:, 0]], one) < 0
    expected = {"ridge": convex & (angle > 20.0), "valley": ~convex & (angle > 12.0)}
    for kind, chosen in expected.items():
        found = set(vertex_pairs(lines, [KINDS[k] == kind for k in lines.kinds]))
        wanted = {tuple(e) for e in edges.vertices[chosen].tolist()}
        assert wanted and found <= wanted
        assert len(found) > 0.5 * len(wanted)  # the others are cut


def test_an_edge_that_is_several_kinds_comes_once():
    mesh = meshes.cube()
    both = drawn(mesh, kinds=[LineKind.SILHOUETTE, LineKind.RIDGE, LineKind.CREASE])[0]
    assert {KINDS[k] for k in both.kinds} == {LineKind.SILHOUETTE, LineKind.RIDGE}
    creases = drawn(mesh, kinds=[LineKind.CREASE])[0]
    assert len(set(vertex_pairs(creases, np.ones(len(creases), bool)))) == 12
    assert drawn(mesh, kinds=[LineKind.VALLEY])[0].kinds.tolist() == []


def test_an_edge_of_three_faces_is_a_crease():
    v = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0.5], [-1, 0.2, 0.5], [0, 1, 0.5]], float)
    lines, _, _ = drawn((v, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], np.int32)), kinds=[LineKind.CREASE])
    assert lines.vertices.tolist() in ([0, 1], [1, 0])


@pytest.mark.parametrize("shape", SHAPES)
def test_polylines_cover_every_line_once(shape):
    lines, view, ready = drawn(SHAPES[shape](), ridge_deg=25.0, valley_deg=25.0)
    covered = np.zeros(len(KINDS))
    for points, kind, closed in zip(lines.polylines(), lines.kinds, lines.closed, strict=True):
        around = np.concatenate([points, points[:1]]) if closed else points
        covered[kind] += np.linalg.norm(np.diff(around, axis=0), axis=1).sum()
    pixels = to_pixels(view, project(view, ready.positions))
    angles = np.radians([0, 0, 25.0, 25.0, 60.0, 0])
    sides = line_kinds.eye_sides(ready.positions, ready.faces, view.eye)
    fans = ready.fans
    edges, kinds = line_kinds.line_edges(sides, fans.starts, fans.halves, ready.meeting, ready.turn, ready.angle, np.ones(6, bool), angles)
    length = np.linalg.norm(pixels[fans.vertices[edges, 0]] - pixels[fans.vertices[edges, 1]], axis=1)
    expected = np.bincount(kinds, length, minlength=len(KINDS))
    crossing = ready.crossings().ends
    if len(crossing):
        a, b = (to_pixels(view, project(view, crossing[:, k : k + 3])) for k in (0, 3))
        expected[line_kinds.INTERSECTION] = np.linalg.norm(a - b, axis=1).sum()
    assert np.allclose(covered, expected, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("shape", ["crossing cubes", "crossing spheres"])
def test_intersections_are_as_long_as_those_of_all_pairs_of_faces(shape):
    ready, _ = made(SHAPES[shape]())
    ends = ready.crossings().ends
    found = np.linalg.norm(ends[:, :3] - ends[:, 3:], axis=1).sum()
    assert found == pytest.approx(crossing_length(ready.positions, ready.faces), rel=1e-9)


def test_the_intersection_of_two_spheres_is_one_closed_line_on_both():
    lines, _, ready = drawn(SHAPES["crossing spheres"](), FLAT_ON, kinds=[LineKind.INTERSECTION])
    nodes = ready.crossings().nodes
    assert np.array_equal(np.bincount(nodes.ravel() - nodes.min())[np.unique(nodes) - nodes.min()], np.full(len(np.unique(nodes)), 2))
    assert lines.visible.any() and not lines.visible.all()


def test_meshes_that_only_touch_or_are_apart_do_not_cross():
    v, f = meshes.cube()
    for shift in ([2.0, 0.0, 0.0], [1.0, 1.0, 1.0]):
        assert len(made(meshes.joined((v, f), (v + shift, f)))[0].crossings().ends) == 0


def test_a_mesh_that_crosses_itself_too_often_is_refused(monkeypatch):
    monkeypatch.setattr(line_mesh, "MOST_CROSSINGS", 3)
    with pytest.raises(CapabilityError, match="cross more than 3 times"):
        drawn(crossing_cubes())


def test_lines_that_cross_too_often_in_the_image_are_refused(monkeypatch):
    monkeypatch.setattr(lines_module, "MOST_CUTS", 3)
    with pytest.raises(CapabilityError, match="cross more than 3 times in this image"):
        drawn(meshes.knot(60, 9))


def test_only_visible_lines_are_the_visible_ones_of_all():
    every, _, _ = drawn(meshes.knot(100, 12))
    shown, _, _ = drawn(meshes.knot(100, 12), visible_only=True)
    assert shown.visible.all() and not every.visible.all()
    assert sorted(map(len, shown.polylines())) == sorted(len(p) for p, v in zip(every.polylines(), every.visible, strict=True) if v)


@pytest.mark.parametrize("tolerance", [0.3, 2.0])
def test_simple_and_smooth_lines_stay_within_their_tolerance(tolerance):
    mesh = meshes.knot(60, 9)
    exact = drawn(mesh, visible_only=True)[0]
    simple = drawn(mesh, visible_only=True, simplify_px=tolerance)[0]
    smooth = drawn(mesh, visible_only=True, smooth_px=tolerance)[0]
    assert len(simple.points) < 0.97 * len(exact.points) and len(smooth.points) > len(exact.points)
    for before, fewer, rounder, closed in zip(exact.polylines(), simple.polylines(), smooth.polylines(), exact.closed, strict=True):
        assert distance_to(fewer, closed, before).max() <= tolerance + 1e-9
        assert distance_to(before, closed, rounder).max() <= tolerance + 1e-9
        assert distance_to(rounder, closed, before).max() <= tolerance + 1e-9
        if not closed:
            assert np.array_equal(before[[0, -1]], fewer[[0, -1]]) and np.array_equal(before[[0, -1]], rounder[[0, -1]])


@pytest.mark.parametrize(
    "camera",
    [
        Camera(eye=[1.0, 0.1, 0.2], target=[0.0, 1.0, 0.1]),  # in the tube
        Camera(eye=[0.0, 0.0, 0.1], target=[1.0, 0.2, 0.0], fov_y_deg=100.0),  # in the hole
        Camera(eye=[0.0, 0.0, 4.0], target=[0.0, 0.0, 9.0]),  # all of it behind
        Camera(eye=[3.0, 0.0, 0.0], target=[0.0, 2.5, 0.0]),  # partly beside the image
    ],
)
def test_lines_are_cut_at_the_image_and_the_eye_plane(camera):
    lines, view, ready = drawn(meshes.torus(), camera, size=100)
    assert np.isfinite(lines.points).all()
    assert lines.points.min(initial=0.0) >= 0.0 and lines.points.max(initial=0.0) <= 100.0
    points, visible, of = samples(lines)
    hidden, sure = hidden_by_rays(view, ready.positions, ready.faces, in_space(view, ready, lines, points, of))
    assert np.array_equal(hidden[sure], ~visible[sure])


def test_a_mesh_of_one_face_is_its_boundary():
    v = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    lines, _, _ = drawn((v, np.array([[0, 1, 2]], np.int32)))
    assert (len(lines), lines.closed.tolist(), sorted(lines.vertices.tolist())) == (1, [True], [0, 1, 2])
