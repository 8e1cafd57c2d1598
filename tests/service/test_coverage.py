import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.kernels.coverage import by_band, cut
from service.kernels.coverage_pixels import EXACT_PIECES, SLABS
from service.kernels.coverage_rows import columns_of, cover
from service.silhouette import coverage
from service.silhouette.coverage import coverage_mask
from tests.service.oracles import positive_area

ROUNDING = 0.5 / 255 + 1e-9


def polygon(*points):
    """Closed polygon as segments."""
    p = np.asarray(points, np.float64)
    return np.column_stack([p, np.roll(p, -1, axis=0)])


# the left side of a positive polygon runs down the image
SQUARE = polygon((1.0, 1.0), (1.0, 3.0), (3.0, 3.0), (3.0, 1.0))

grid = st.integers(-12, 60).map(lambda n: n / 8.0)
anywhere = st.floats(-3.0, 9.0, width=32)
coarse = st.integers(-1, 7).map(float)
points = st.one_of(*(st.lists(st.tuples(c, c), min_size=2, max_size=7) for c in (grid, anywhere, coarse)))


@settings(max_examples=60, deadline=None)
@given(st.lists(points, min_size=1, max_size=2))
def test_mask_is_the_exact_area_of_positive_winding(polygons):
    segments = np.concatenate([polygon(*p) for p in polygons])
    mask = coverage_mask(segments, 6, 5).mask
    assert np.all(np.abs(mask / 255.0 - positive_area(segments, 6, 5)) <= allowed(segments, 6, 5))


def allowed(segments, width, height):
    """Largest error of each pixel: rounding, but a slab for each piece where there are too many pieces to be exact."""
    pieces, places = np.empty((1000, 4)), np.empty(1000, np.int32)
    columns = width + 1
    sums, state = np.zeros((height, columns)), np.zeros((height, columns), np.uint8)
    count, _ = cut(segments, np.arange(len(segments), dtype=np.int32), 0, 0, 0, width, height, sums, state, pieces, places)
    crossed = np.bincount(places[:count], minlength=height * columns).reshape(height, columns)[:, :width]
    return np.where(crossed > EXACT_PIECES, crossed / SLABS, ROUNDING)


def test_chain_that_ends_on_the_pixel_side_just_across_another_crosses_it():
    segments = polygon((1.0, 0.0), (0.0, 2.0), (1.5272900041034553e-16, 0.0), (0.0, 0.0), (0.0, 1.5))
    mask = coverage_mask(segments, 3, 3).mask
    assert np.abs(mask / 255.0 - positive_area(segments, 3, 3)).max() <= ROUNDING


def test_chains_that_cross_next_to_their_ends_cross():
    segments = polygon((0.0, 0.0), (1.0, 1.0), (0.0, -1.0), (8.779942778774908e-16, 0.0), (0.0, 1.0))
    mask = coverage_mask(segments, 3, 3).mask
    assert np.abs(mask / 255.0 - positive_area(segments, 3, 3)).max() <= ROUNDING


def test_chain_through_a_vertex_on_another_chain_crosses_it():
    segments = polygon((2.25, 0.0), (2.25, 1.5), (2.75, 3.0), (1.5, 3.0), (2.5, 0.0))
    mask = coverage_mask(segments, 4, 4).mask
    assert np.abs(mask / 255.0 - positive_area(segments, 4, 4)).max() <= ROUNDING


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=3, max_size=4))
def test_chains_within_one_pixel_are_exact(corners):
    segments = polygon(*corners)
    segments = np.concatenate([segments, segments[::-1, [2, 3, 0, 1]] * 0.5 + 0.25])
    mask = coverage_mask(segments, 1, 1).mask
    assert abs(mask[0, 0] / 255.0 - positive_area(segments, 1, 1)[0, 0]) <= ROUNDING


def test_a_positive_polygon_covers_and_its_reverse_does_not():
    mask = coverage_mask(SQUARE, 5, 4).mask
    expected = np.zeros((4, 5), np.uint8)
    expected[1:3, 1:3] = 255
    assert np.array_equal(mask, expected)
    assert not coverage_mask(SQUARE[:, [2, 3, 0, 1]], 5, 4).mask.any()


def test_layers_that_overlap_in_half_a_pixel_do_not_fill_it():
    half = polygon((0.0, 0.0), (0.0, 1.0), (0.5, 1.0), (0.5, 0.0))
    result = coverage_mask(np.concatenate([half, half]), 1, 1)
    assert result.mask[0, 0] == 128
    assert result.doubtful == 1


def test_a_hole_of_the_opposite_sense_is_not_covered():
    hole = polygon((1.5, 1.5), (2.5, 1.5), (2.5, 2.5), (1.5, 2.5))
    mask = coverage_mask(np.concatenate([SQUARE, hole]), 5, 4).mask
    assert set(mask[1:3, 1:3].ravel()) == {191}


def test_a_pentagram_is_covered_in_its_middle_too():
    angle = np.arange(5) * 4 * np.pi / 5
    star = polygon(*np.column_stack([8.3 + 7 * np.sin(angle), 8.1 + 7 * np.cos(angle)]))
    mask = coverage_mask(star, 17, 17).mask
    assert mask[8, 8] == 255
    assert np.abs(mask / 255.0 - positive_area(star, 17, 17)).max() <= ROUNDING


@pytest.mark.parametrize("seed", range(4))
def test_pixels_with_many_pieces_stay_within_their_sampling(seed):
    rng = np.random.default_rng(seed)
    segments = np.concatenate([polygon(*rng.uniform(0.0, 2.0, (3, 2))) for _ in range(9)])
    mask = coverage_mask(segments, 2, 2).mask
    assert np.abs(mask / 255.0 - positive_area(segments, 2, 2)).max() <= 2 / SLABS


def test_an_image_is_a_window_on_a_larger_one():
    rng = np.random.default_rng(5)
    p = rng.uniform(-10.0, 40.0, (40, 2))
    whole = coverage_mask(polygon(*p), 40, 40).mask.astype(int)
    for x, y, w, h in ((0, 0, 40, 40), (13, 7, 11, 19), (39, 39, 1, 1), (0, 20, 40, 1), (20, 0, 1, 40)):
        part = coverage_mask(polygon(*(p - (x, y))), w, h).mask.astype(int)
        assert np.abs(part - whole[y : y + h, x : x + w]).max() <= 1


@pytest.mark.parametrize("far", [1e3, 1e9, 1e15, 1e100])
def test_polygons_that_reach_far_beyond_the_image(far):
    everything = polygon((-far, -far), (-far, far), (far, far), (far, -far))
    assert np.all(coverage_mask(everything, 7, 5).mask == 255)
    left_half = polygon((-far, -far), (-far, far), (3.5, far), (3.5, -far))
    assert np.array_equal(coverage_mask(left_half, 7, 5).mask, np.tile(np.uint8([255, 255, 255, 128, 0, 0, 0]), (5, 1)))
    right_half = polygon((3.5, -far), (3.5, far), (far, far), (far, -far))
    assert np.array_equal(coverage_mask(right_half, 7, 5).mask, np.tile(np.uint8([0, 0, 0, 128, 255, 255, 255]), (5, 1)))


def test_a_diagonal_from_a_billion_pixels_away_cuts_where_it_should():
    far = 1e9
    triangle = polygon((-far, -far), (far, far), (far, -far))
    mask = coverage_mask(triangle, 4, 4).mask
    assert np.array_equal(mask, np.triu(np.full((4, 4), 255), 1) + np.diag([128] * 4))


@pytest.mark.parametrize("shift", [(-9.0, 0.0), (9.0, 0.0), (0.0, -9.0), (0.0, 9.0), (1e9, 1e9)])
def test_polygons_beside_the_image_cover_nothing(shift):
    result = coverage_mask(SQUARE + np.tile(shift, 2), 5, 4)
    assert not result.mask.any()


def test_nothing_is_done_for_nothing():
    assert coverage_mask(np.empty((0, 4)), 3, 2).bounds == (0, 0, 0, 0)
    assert coverage_mask(SQUARE + 100.0, 3, 2).bounds == (0, 0, 0, 0)


def test_everything_outside_the_bounds_is_zero_and_inside_is_all_of_it():
    result = coverage_mask(SQUARE * 3.3, 40, 30)
    x0, y0, x1, y1 = result.bounds
    inside = result.mask[y0:y1, x0:x1].copy()
    assert inside.sum() == result.mask.sum() > 0
    assert x1 - x0 <= 8
    assert y1 - y0 <= 8


def test_points_and_edges_without_length_change_nothing():
    nothing = np.array([[2.0, 2.0, 2.0, 2.0], [1.5, 2.5, 1.5, 2.5]])
    spike = np.array([[2.0, 2.0, 9.0, 3.3], [9.0, 3.3, 2.0, 2.0]])
    assert np.array_equal(coverage_mask(np.concatenate([SQUARE, nothing, spike]), 5, 4).mask, coverage_mask(SQUARE, 5, 4).mask)


def test_a_base_is_added_to_the_winding_number():
    assert np.all(coverage_mask(np.empty((0, 4)), 3, 2, base=1).mask == 255)
    around = coverage_mask(SQUARE[:, [2, 3, 0, 1]], 5, 4, base=1).mask
    assert np.array_equal(around, 255 - coverage_mask(SQUARE, 5, 4).mask)


def test_a_given_array_is_overwritten():
    out = np.full((4, 5), 7, np.uint8)
    assert coverage_mask(SQUARE, 5, 4, out).mask is out
    assert np.array_equal(out, coverage_mask(SQUARE, 5, 4).mask)


def test_the_order_of_the_segments_does_not_matter():
    rng = np.random.default_rng(2)
    segments = polygon(*rng.uniform(-4.0, 24.0, (60, 2)))
    a = coverage_mask(segments, 20, 20).mask.astype(int)
    b = coverage_mask(rng.permutation(segments), 20, 20).mask.astype(int)
    assert np.abs(a - b).max() <= 1


def test_more_pieces_than_are_held_at_a_time_give_clamped_sums(monkeypatch):
    disc = polygon(*(16.2 + 14.0 * np.column_stack([np.sin(t := np.arange(300) * np.pi / 150), np.cos(t)])))
    expected = coverage_mask(disc, 32, 32).mask
    monkeypatch.setattr(coverage, "MOST_PIECES", 50)
    assert np.array_equal(coverage_mask(disc, 32, 32).mask, expected)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
def test_segments_that_are_not_finite_are_refused(value):
    broken = SQUARE.copy()
    broken[1, 2] = value
    with pytest.raises(ValueError, match="finite"):
        coverage_mask(broken, 5, 4)


@settings(max_examples=60, deadline=None)
@given(st.lists(points, min_size=1, max_size=2), st.integers(1, 5))
def test_bands_of_rows_are_those_of_the_whole(polygons, rows):
    segments = np.concatenate([polygon(*p) for p in polygons])
    whole, parts = coverage_mask(segments, 6, 5).mask, np.full((5, 6), 77, np.uint8)
    finite, starts, chosen = by_band(segments, 0, 5, rows)
    assert finite
    for band, top in enumerate(range(0, 5, rows)):
        scratch = coverage.cover_scratch(rows * columns_of(6))
        some = chosen[starts[band] : starts[band + 1]]
        cover(segments, some, 0, top, 6, min(top + rows, 5), 0.0, parts, coverage.MOST_PIECES, scratch)
    assert np.abs(parts.astype(int) - whole).max() <= 1


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_segments_that_are_not_finite_are_in_no_band(value):
    broken = np.concatenate([SQUARE, np.add(SQUARE, (0.0, 20.0, 0.0, 20.0))])
    broken[6, 0] = value
    finite, starts, chosen = by_band(broken, 0, 30, 10)
    assert not finite
    assert not starts.any()
    assert not len(chosen)


@settings(max_examples=60, deadline=None)
@given(st.lists(points, min_size=1, max_size=2), st.integers(0, 3), st.integers(1, 6))
def test_a_rectangle_counts_what_is_left_of_it_and_nothing_else(polygons, left, width):
    segments = np.concatenate([polygon(*p) for p in polygons])
    whole, part, right = coverage_mask(segments, 12, 5).mask, np.zeros((5, 12), np.uint8), left + width
    scratch = coverage.cover_scratch(5 * columns_of(width))
    found, _ = cover(segments, np.arange(len(segments), dtype=np.int32), left, 0, right, 5, 0.0, part, coverage.MOST_PIECES, scratch)
    assert found >= 0
    assert np.abs(part[:, left:right].astype(int) - whole[:, left:right]).max() <= 1


def test_threads_do_not_share_scratch_memory():
    rng = np.random.default_rng(3)
    jobs = [polygon(*rng.uniform(0.0, 200.0, (50, 2))) for _ in range(4)]
    expected = [coverage_mask(j, 200, 200).mask for j in jobs]
    wrong = []

    def work(i):
        for _ in range(20):
            if not np.array_equal(coverage_mask(jobs[i], 200, 200).mask, expected[i]):
                wrong.append(i)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert not wrong
