"""Crossings in the image against rational arithmetic on all pairs, and pieces against what they are cut from."""

from fractions import Fraction

import numpy as np
import pytest

from service.kernels import line_cuts, line_image, line_pieces

SIDE = 64.0


def flat(ends, near):
    """Clipped segments (n, COLUMNS) of an image, all as near as `near` at both ends."""
    image = np.zeros((len(ends), line_image.COLUMNS))
    image[:, :4], image[:, 4:6] = ends, near
    image[:, line_image.T1], image[:, line_image.W0], image[:, line_image.W1] = 1.0, 1.0, 1.0
    return image


def turn(a, b, p):
    (ax, ay), (bx, by), (px, py) = ((Fraction(float(c)) for c in point) for point in (a, b, p))
    area = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
    return (area > 0) - (area < 0)


def meet(one, two):
    """Whether two segments have a point in common; None where they are on one line."""
    a, b, p, q = one[:2], one[2:], two[:2], two[2:]
    sides = turn(a, b, p), turn(a, b, q), turn(p, q, a), turn(p, q, b)
    if sides[:2] == (0, 0):
        return None
    return sides[0] * sides[1] <= 0 and sides[2] * sides[3] <= 0


def cuts_of(lines, contours, shared=False):
    nodes = np.arange(2 * len(lines), dtype=np.int32).reshape(-1, 2)
    others = nodes[: len(contours)] if shared else 10**6 + np.arange(2 * len(contours), dtype=np.int32).reshape(-1, 2)
    cuts, of = np.empty(20000), np.empty(20000, np.int32)
    count = line_cuts.find_cuts(lines, nodes, contours, others, SIDE, SIDE, 20000, cuts, of)
    return cuts[:count], of[:count]


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_cuts_are_where_rational_arithmetic_says(whole, seed):
    rng = np.random.default_rng(seed)
    start, reach = rng.uniform(0, SIDE, (120, 2)), rng.choice([2.0, 8.0, 60.0], (120, 1))
    ends = np.concatenate([start, np.clip(start + rng.uniform(-1, 1, (120, 2)) * reach, 0, SIDE)], axis=1)
    if whole:
        ends = np.round(ends / 4.0) * 4.0
    lines, contours = ends[:60], ends[60:]
    cuts, of = cuts_of(flat(lines, 1.0), flat(contours, 2.0))
    for n, line in enumerate(lines):
        pairs = [meet(line, contour) for contour in contours]
        if None not in pairs and tuple(line[:2]) != tuple(line[2:]):
            assert np.count_nonzero(of == n) == sum(pairs)
    cuts, of = (part[(lines[of, :2] != lines[of, 2:]).any(axis=1)] for part in (cuts, of))
    points = lines[of, :2] + cuts[:, None] * (lines[of, 2:] - lines[of, :2])
    for point in points:
        d = contours[:, 2:] - contours[:, :2]
        square = np.maximum((d**2).sum(axis=1), 1e-300)
        t = np.clip(((point - contours[:, :2]) * d).sum(axis=1) / square, 0, 1)
        assert np.linalg.norm(contours[:, :2] + t[:, None] * d - point, axis=1).min() < 1e-9


def test_contours_behind_a_line_or_with_its_end_do_not_cut_it():
    lines, contours = np.array([[0.0, 8.0, 64.0, 8.0]]), np.array([[8.0, 0.0, 8.0, 64.0]])
    assert cuts_of(flat(lines, 1.0), flat(contours, 2.0))[0].tolist() == [0.125]
    assert cuts_of(flat(lines, 2.0), flat(contours, 1.0))[0].tolist() == []
    assert cuts_of(flat(lines, 1.0), flat(contours, 1.0))[0].tolist() == [0.125]  # not sure to be behind
    assert cuts_of(flat(lines, 1.0), flat(contours, 2.0), shared=True)[0].tolist() == []


def test_a_contour_over_a_line_cuts_it_at_its_ends():
    lines, contours = np.array([[0.0, 8.0, 64.0, 8.0]]), np.array([[48.0, 8.0, 16.0, 8.0]])
    assert sorted(cuts_of(flat(lines, 1.0), flat(contours, 2.0))[0].tolist()) == [0.25, 0.75]


def test_pieces_lie_one_after_the_other_and_are_free_where_the_line_ends_untouched():
    lines = flat(np.array([[0.0, 0.0, 64.0, 0.0], [0.0, 1.0, 64.0, 1.0], [5.0, 5.0, 5.0, 5.0]]), 1.0)
    starts, cuts = np.array([0, 3, 5, 5]), np.array([0.25, 0.25, 0.5, 0.0, 1.0])
    line, spans, free = line_pieces.cut_lines(lines, starts, cuts)
    assert line.tolist() == [0, 0, 0, 1]
    assert spans.tolist() == [[0.0, 0.25], [0.25, 0.5], [0.5, 1.0], [0.0, 1.0]]
    assert free.tolist() == [line_pieces.START, 0, line_pieces.END, 0]


def test_parts_in_space_and_in_the_image_are_each_others_inverse():
    image = flat(np.array([[0.0, 0.0, 10.0, 5.0]]), 1.0)
    image[0, line_image.T0], image[0, line_image.T1], image[0, line_image.W0], image[0, line_image.W1] = 0.2, 0.9, 0.5, 4.0
    for s in np.linspace(0, 1, 11):
        assert line_image.across(image, 0, line_image.along(image, 0, s)) == pytest.approx(s, abs=1e-12)
    assert line_image.along(image, 0, 0.5) < 0.35  # the near half takes up most of the image
