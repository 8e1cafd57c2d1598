from __future__ import annotations

from collections import Counter

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from service.kernels.loops import triangle_loops


def boundary(triangles):
    """Directed edges of the triangles that no opposite edge cancels, with their number."""
    count = Counter()
    for a, b, c in triangles.tolist():
        for edge in ((a, b), (b, c), (c, a)):
            if count[edge[::-1]]:
                count[edge[::-1]] -= 1
            else:
                count[edge] += 1
    return +count


@settings(deadline=None)  # compiling counts
@given(st.lists(st.integers(3, 70), max_size=6))
def test_loops_add_up_to_the_contours(sizes):
    offsets = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)]).astype(np.int32)
    triangles = triangle_loops(offsets)
    assert len(triangles) == sum(n - 2 for n in sizes)
    expected = Counter()
    for start, end in zip(offsets[:-1].tolist(), offsets[1:].tolist(), strict=True):
        expected.update((i, i + 1 if i + 1 < end else start) for i in range(start, end))
    assert boundary(triangles) == expected


def test_contours_too_short_to_enclose_anything_have_no_loops():
    assert triangle_loops(np.array([0, 1, 3], np.int32)).shape == (0, 3)
    assert triangle_loops(np.array([0], np.int32)).shape == (0, 3)


def test_no_loop_of_a_fine_round_contour_but_the_innermost_is_large():
    angle = np.arange(4096) / 4096 * 2 * np.pi
    points = np.column_stack([np.cos(angle), np.sin(angle)])
    corners = points[triangle_loops(np.array([0, 4096], np.int32))]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    assert abs(area.sum() - np.pi) < 1e-4
    assert (area > 0).all()
    assert (area > 0.01).sum() <= 32
