"""Strokes against brute force: what discs along a line cover, lengths of dashes, noise, and what widths follow."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from schemas.lines import LineKind, Stroke
from schemas.render import ProjectTo, SilhouetteRequest
from service.camera import resolve_camera
from service.kernels import stroke_outlines, stroke_paths
from service.silhouette.lines import KINDS, VectorLines, vector_lines
from service.silhouette.strokes import depth_range, opacity_levels, outlines_of, stroked_lines, stylised, triangles_of
from tests import meshes
from tests.service.stroke_oracles import arc_length, beyond_discs, in_triangles, polygons_of, winding
from tests.service.test_lines import CORNER, crossing_cubes, drawn, made

ANGLES = {"ridge_deg": 20.0, "valley_deg": 20.0}
WIDTHS = dict.fromkeys(KINDS, 4.0)


def lines_of(*polylines, closed=False, depths=None, widths=None, opacities=None):
    """Visible silhouettes of these points."""
    count = len(polylines)
    offsets = np.cumsum([0, *map(len, polylines)]).astype(np.int32)
    points = np.concatenate(polylines).astype(float)
    return VectorLines(
        points, offsets, np.zeros(count, np.uint8), np.ones(count, bool), np.full(count, closed), None,
        np.ones(len(points)) if depths is None else np.asarray(depths, float), widths, opacities, np.zeros(count, bool),
    )  # fmt: skip


def circle(radius, count=200, centre=(100.0, 100.0)):
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle)]) * radius + centre


def styled(lines, depths=(0.0, 1.0), width=4.0, **stroke):
    return stylised(lines, Stroke(**stroke), depths, np.full(len(KINDS), width))


def on_mesh(mesh, size=300, width=4.0, kinds=tuple(LineKind), visible_only=True, **stroke):
    ready, frame = made(mesh)
    wanted = SilhouetteRequest(camera=CORNER, project=ProjectTo(width=size, height=size), kinds=kinds, visible_only=visible_only, **ANGLES)
    view = resolve_camera(wanted.camera, frame, size, size)
    return stroked_lines(ready, view, wanted, Stroke(**stroke), dict.fromkeys(KINDS, width), 0)


def shapes(points, radii, closed=False, flat=False):
    """(polygons, vertices, indices) of a stroke by the kernels."""
    starts, loops = np.array([0, len(points)], np.int32), np.array([closed])
    corners, first = stroke_outlines.sides(points, radii, starts, loops, np.array([flat]), 0.01)
    places, offsets = stroke_outlines.outlines(corners, first, starts, loops)
    return polygons_of(places, offsets), *stroke_outlines.triangles(points, corners, first, starts, loops, 1.0)


COORDINATE = st.integers(0, 24).map(float)
POLYLINE = st.lists(st.tuples(COORDINATE, COORDINATE, st.floats(0.3, 6.0)), min_size=2, max_size=7)


@settings(deadline=None, max_examples=60)
@given(POLYLINE, st.booleans())
def test_outlines_and_triangles_cover_the_discs_along_the_line_and_no_more(rows, closed):
    rows = np.array(rows)
    points, radii = np.ascontiguousarray(rows[:, :2]), rows[:, 2].copy()
    assume(arc_length(points) > 0.0 or not closed)
    ends = np.roll(rows, -1, axis=0) if closed else rows[1:]
    sizes = np.linalg.norm(ends[:, :2] - rows[: len(ends), :2], axis=1)
    if np.any(np.abs(ends[:, 2] - rows[: len(ends), 2]) > 0.9 * sizes):
        radii[:] = radii.mean()  # discs inside one another, or on one point
    polygons, vertices, indices = shapes(points, radii, closed)
    x, y = np.meshgrid(np.arange(-7.0, 32.0, 1.3), np.arange(-7.0, 32.0, 1.3))
    at = np.column_stack([x.ravel(), y.ravel()]) + 0.0137
    beyond = beyond_discs(points, radii, closed, at)
    sure, turns = np.abs(beyond) > 0.1, winding(polygons, at)
    assert np.array_equal(turns[sure] != 0, beyond[sure] < 0.0)
    assert turns.min() >= 0 or turns.max() <= 0, "parts that turn the other way would take from others"
    assert np.array_equal(in_triangles(vertices, indices, at)[sure], beyond[sure] < 0.0)


def test_a_stroke_is_as_wide_as_was_asked_at_every_point():
    found = on_mesh(meshes.torus(), width_by="depth", wobble_px=2.0, wobble_length_px=20.0, width=9.0)
    polygons = polygons_of(*outlines_of(found, 9.0))
    alone = 0
    for points, (a, b) in zip(found.polylines(), pairwise(found.offsets.tolist()), strict=True):
        for k in range(8, len(points) - 8, 9):
            tangent = points[k + 1] - points[k - 1]
            normal = np.array([-tangent[1], tangent[0]]) / np.linalg.norm(tangent)
            others = np.delete(found.points, slice(a + k - 8, a + k + 9), axis=0)
            if np.linalg.norm(others - points[k], axis=1).min() < 11.0:
                continue
            steps = np.arange(-6.0, 6.0, 0.1)
            inside = winding(polygons, points[k] + steps[:, None] * normal) != 0
            assert abs(0.1 * inside.sum() - found.widths[a:b][k]) <= 0.5
            alone += 1
    assert alone > 20


def test_flat_ends_end_at_the_points():
    polygons, vertices, indices = shapes(np.array([[10.0, 10.0], [20.0, 10.0]]), np.array([4.0, 4.0]), flat=True)
    at = np.array([[9.8, 10.3], [10.2, 6.2], [10.2, 13.8], [19.8, 13.8], [20.2, 10.3], [15.0, 14.2]])
    assert (winding(polygons, at) != 0).tolist() == [False, True, True, True, False, False]
    assert in_triangles(vertices, indices, at).tolist() == [False, True, True, True, False, False]


def test_points_along_a_line_keep_its_corners_and_are_near_to_one_another():
    points = np.array([[0.0, 0.0], [7.0, 0.0], [7.0, 0.5], [1.0, 30.0]])
    for closed in (False, True):
        places, at, starts, lengths = stroke_paths.resample(points, np.arange(4.0), np.array([0, 4], np.int32), np.array([closed]), 2.0)
        assert all((np.abs(places[:, :2] - point).max(axis=1) == 0.0).any() for point in points)
        ways = np.append(at, lengths[0]) if closed else at
        assert np.all(np.diff(ways) <= 2.0 + 1e-12) and np.all(np.diff(ways) > 0.0)
        assert lengths[0] == pytest.approx(arc_length(points, closed))
        assert starts.tolist() == [0, len(places)]


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 30.0), st.floats(2.0, 300.0), st.lists(st.tuples(*2 * [st.floats(-9e3, 9e3)]), min_size=1))
def test_a_wobble_moves_points_by_no_more_than_was_asked(seed, reach, length, places):
    before = np.array(places)
    after = before.copy()
    stroke_paths.wobble(after, seed, reach, length)
    assert np.linalg.norm(after - before, axis=1).max() <= reach * (1.0 + 1e-9)


def test_a_wobble_moves_lines_that_meet_alike_and_neighbours_nearly_alike():
    before = np.random.default_rng(3).uniform(0.0, 500.0, (400, 2))
    beside = before + 0.01
    moved, again, beside_moved = before.copy(), before.copy(), beside.copy()
    for points in (moved, again, beside_moved):
        stroke_paths.wobble(points, 5, 8.0, 30.0)
    assert np.array_equal(moved, again)
    assert np.abs((moved - before) - (beside_moved - beside)).max() < 0.05
    assert np.linalg.norm(moved - before, axis=1).mean() > 2.0


def test_the_wobble_of_a_seed_is_the_same_on_every_machine():
    points = np.array([[0.0, 0.0], [123.456, 78.9], [-40.0, 1000.0]])
    stroke_paths.wobble(points, 7, 2.0, 40.0)
    assert np.allclose(points, WOBBLED, rtol=0.0, atol=1e-12)


WOBBLED = [[1.1249782621898408, 0.7226745103355686], [122.66507948184177, 80.26546550750888], [-40.562099863971845, 1000.5819510656862]]


def test_seeds_give_other_lines_and_one_seed_the_same_bytes():
    one, again, other = (on_mesh(meshes.torus(), wobble_px=3.0, seed=seed).points for seed in (1, 1, 2))
    assert one.tobytes() == again.tobytes()
    assert np.abs(one - other).max() > 0.5


def test_lines_that_met_still_meet_and_closed_ones_stay_closed():
    plain, wobbled = (on_mesh(crossing_cubes(), wobble_px=reach, visible_only=False) for reach in (0.0, 6.0))
    assert np.array_equal(plain.offsets, wobbled.offsets) and np.array_equal(plain.closed, wobbled.closed)
    ends = np.concatenate([plain.offsets[:-1], plain.offsets[1:] - 1])
    before, after = plain.points[ends], wobbled.points[ends]
    same = np.linalg.norm(before[:, None] - before, axis=2) < 1e-9
    assert same.sum() > len(ends) + 10
    assert np.linalg.norm(after[:, None] - after, axis=2)[same].max() < 1e-6
    loop = styled(lines_of(circle(60.0), closed=True), wobble_px=5.0, width_by="curvature")
    gaps = np.linalg.norm(np.roll(loop.points, -1, axis=0) - loop.points, axis=1)
    assert loop.closed.all() and gaps[-1] < 1.5 * np.median(gaps)
    assert abs(loop.widths[-1] - loop.widths[0]) < 0.05


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.tuples(*2 * [st.floats(0.0, 200.0)]), min_size=2, max_size=8),
    st.sampled_from([(7.0, 3.0), (0.5, 40.0), (9.0, 1.0, 2.0, 5.0)]),
)
def test_dashes_are_as_long_as_was_asked_along_the_line(points, pattern):
    points = np.array(points)
    rows, starts, of = stroke_paths.dashes(points, np.array([0, len(points)], np.int32), np.array([False]), np.array(pattern))
    whole, way, expected = arc_length(points), 0.0, []
    for turn in range(10**4):
        size = pattern[turn % len(pattern)]
        if way >= whole - 1e-5:
            break
        if turn % 2 == 0:
            expected.append(min(size, whole - way))
        way += size
    found = [arc_length(rows[a:b]) for a, b in pairwise(starts.tolist())]
    assert len(of) == len(found)
    found, expected = ([size for size in sizes if size > 1e-4] for sizes in (found, expected))
    assert found == pytest.approx(expected, abs=1e-4)


def test_dashes_go_round_a_closed_line_without_a_seam():
    found = styled(lines_of(circle(60.0), closed=True), dash=[10.0, 6.0])
    sizes = [arc_length(points) for points in found.polylines()]
    assert len(sizes) == round(arc_length(circle(60.0), closed=True) / 16.0)
    assert np.ptp(sizes) < 0.05 and abs(sizes[0] - 10.0) < 0.4
    gap = np.linalg.norm(found.polylines()[0][0] - found.polylines()[-1][-1])
    assert gap == pytest.approx(sizes[0] * 0.6, rel=0.02)
    assert not found.closed.any() and found.flat.all()


def test_hidden_lines_are_not_dashed_and_come_after_the_visible_ones_of_their_kind():
    plain, cut = (on_mesh(crossing_cubes(), visible_only=False, dash=dash, width_by="depth") for dash in (None, [6.0, 4.0]))
    assert (~cut.visible).sum() == (~plain.visible).sum() and cut.visible.sum() > plain.visible.sum()
    order = list(zip(cut.kinds.tolist(), (~cut.visible).tolist(), strict=True))
    assert order == sorted(order)
    for points, old in zip(cut.chosen(~cut.visible).polylines(), plain.chosen(~plain.visible).polylines(), strict=True):
        assert np.array_equal(points, old)
    assert cut.flat[cut.visible].all() and not cut.flat[~cut.visible].any()


@pytest.mark.parametrize("by", ["depth", "curvature", "angle"])
def test_widths_are_between_the_least_and_the_whole(by):
    found = on_mesh(meshes.knot(100, 12), width_by=by, opacity_by=by, least=0.3, width=5.0)
    assert found.widths.min() >= 1.5 - 1e-9 and found.widths.max() <= 5.0 + 1e-9
    assert np.ptp(found.widths) > 1.0
    assert np.allclose(found.opacities, found.widths / 5.0)


def test_nearer_lines_are_wider():
    found = on_mesh(meshes.torus(), width_by="depth", least=0.1)
    order = np.argsort(found.depths)
    assert np.all(np.diff(found.widths[order]) <= 1e-9)
    ready, frame = made(meshes.torus())
    nearest, farthest = depth_range(ready.positions, resolve_camera(CORNER, frame, 300, 300))
    expected = 4.0 * (0.1 + 0.9 * (farthest - found.depths) / (farthest - nearest))
    assert np.abs(found.widths - np.clip(expected, 0.4, 4.0)).max() < 1e-6


def test_depths_are_those_of_the_mesh():
    for name in ("torus", "crossing"):
        lines, view, ready = drawn(meshes.torus() if name == "torus" else crossing_cubes())
        at = lines.vertices >= 0
        positions = ready.positions[lines.vertices[at]].astype(float)
        expected = -(positions @ view.view[2, :3] + view.view[2, 3])
        assert at.sum() > 20 and np.abs(lines.depths[at] - expected).max() < 1e-9
        nearest, farthest = depth_range(ready.positions, view)
        assert nearest - 1e-5 <= lines.depths.min() and lines.depths.max() <= farthest + 1e-5


def test_straight_lines_have_the_least_width_by_curvature():
    found = styled(lines_of(np.array([[5.0, 5.0], [100.0, 40.0], [195.0, 75.0]])), width_by="curvature", least=0.2)
    assert np.allclose(found.widths, 0.8)


@pytest.mark.parametrize("radius", [20.0, 60.0, 300.0])
def test_curvature_is_the_turn_within_24_pixels(radius):
    found = styled(lines_of(circle(radius, 2000), closed=True), width_by="curvature", least=0.0, width=1.0)
    turn = stroke_paths.REACH_PX / radius
    assert found.widths == pytest.approx(np.full(len(found.widths), min(1.0, turn / (np.pi / 6.0))), abs=0.03)


@pytest.mark.parametrize("direction", [0.0, 30.0, 90.0, 140.0])
@pytest.mark.parametrize("nib", [0.0, 45.0, 120.0])
def test_a_broad_pen_is_widest_across_its_nib(direction, nib):
    angle = np.radians(direction)
    line = np.array([[50.0, 50.0], [50.0 + 40.0 * np.cos(angle), 50.0 - 40.0 * np.sin(angle)]])
    found = styled(lines_of(line), width_by="angle", least=0.1, nib_deg=nib, width=1.0)
    assert found.widths == pytest.approx(np.full(len(found.widths), 0.1 + 0.9 * abs(np.sin(angle - np.radians(nib)))), abs=1e-6)


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(0.0, 1.0), min_size=3, max_size=12), st.floats(0.05, 0.95), st.booleans())
def test_parts_above_a_level_are_those_that_are(values, least, closed):
    rows = np.column_stack([10.0 * np.arange(len(values)), (np.arange(len(values)) % 2) * 3.0, values])
    parts, starts, of, loops = stroke_paths.above(rows, np.array([0, len(rows)], np.int32), np.array([closed]), 2, least)
    assert len(of) == len(loops) == len(starts) - 1
    assert parts[:, 2].min(initial=1.0) >= least - 1e-9
    total = sum(arc_length(parts[a:b, :2], bool(loop)) for (a, b), loop in zip(pairwise(starts.tolist()), loops, strict=True))
    expected = 0.0
    for k in range(len(values) if closed else len(values) - 1):
        a, b = values[k], values[(k + 1) % len(values)]
        t = np.linspace(0.0, 1.0, 4001)
        expected += np.mean(a + t * (b - a) >= least) * np.linalg.norm(rows[(k + 1) % len(values), :2] - rows[k, :2])
    assert total == pytest.approx(expected, abs=0.3)


def test_levels_of_opacity_come_to_the_opacities_of_the_lines():
    opacities = np.linspace(0.2, 0.9, 50)
    lines = lines_of(np.column_stack([np.linspace(0.0, 200.0, 50), np.full(50, 7.0)]), opacities=opacities)
    shown = np.zeros(200)
    at = np.arange(200.0) + 0.41
    for blended, level in opacity_levels(lines, 0.8):
        there = np.zeros(200, bool)
        for points in level.polylines():
            there |= (at >= points[0, 0]) & (at <= points[-1, 0])
        shown = np.where(there, shown + (1.0 - shown) * blended, shown)
    assert np.abs(shown - 0.8 * np.interp(at, lines.points[:, 0], opacities)).max() <= 0.8 * 0.5 * 0.7 / 8 + 0.01
    assert [len(level) for _, level in opacity_levels(lines_of(circle(9.0), closed=True), 0.5)] == [1]


def test_a_stroke_without_anything_is_the_line_itself():
    lines, view, ready = drawn(meshes.torus(), size=300, **ANGLES)
    wanted = SilhouetteRequest(camera=CORNER, project=ProjectTo(width=300, height=300), kinds=list(LineKind), **ANGLES)
    found = stroked_lines(ready, view, wanted, Stroke(), WIDTHS, 0)
    assert found.widths is None and found.opacities is None and len(found) == len(vector_lines(ready, view, wanted))
    for points, old, closed in zip(found.polylines(), lines.polylines(), lines.closed, strict=True):
        assert arc_length(points, closed) == pytest.approx(arc_length(old, closed), abs=0.25 + 0.02 * len(old))
    assert [name for name, _ in found.passes][-1] == "stroke"


def test_a_margin_lets_lines_come_back_over_the_border():
    ready, frame = made(meshes.torus())
    wanted = SilhouetteRequest(camera={"eye": [1.0, 0.5, 1.5]}, project=ProjectTo(width=200, height=200), visible_only=True)
    view = resolve_camera(wanted.camera, frame, 200, 200)
    inner, outer = (stroked_lines(ready, view, wanted, Stroke(), WIDTHS, margin) for margin in (0, 20))
    assert inner.points.min() >= -1e-9 and inner.points.max() <= 200.0 + 1e-9
    assert outer.points.min() < -5.0 or outer.points.max() > 205.0
    within = ((inner.points > 3.0) & (inner.points < 197.0)).all(axis=1)
    nearest = np.linalg.norm(inner.points[within][:, None] - outer.points, axis=2).min(axis=1)
    assert nearest.max() < 1.5, "the same lines where both have them"


def test_no_lines_make_no_strokes():
    none = lines_of(circle(5.0)).chosen(np.zeros(1, bool))
    found = styled(none, width_by="depth", opacity_by="angle", dash=[3.0, 3.0], wobble_px=2.0)
    assert len(found) == 0 and len(outlines_of(found, 2.0)[0]) == 0 and len(triangles_of(found, 2.0, 1.0)[1]) == 0
    assert list(opacity_levels(found, 1.0)) == []


@pytest.mark.parametrize(
    "fields",
    [
        {"dash": [4.0]},
        {"dash": [4.0, 0.1]},
        {"dash": [4.0, 2.0, 3.0]},
        {"least": 1.5},
        {"wobble_px": -1.0},
        {"seed": -1},
        {"width_by": "age"},
    ],
)
def test_strokes_that_make_no_sense_are_refused(fields):
    with pytest.raises(ValidationError):
        Stroke(**fields)
