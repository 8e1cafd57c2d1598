import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from service.kernels.enclosed import fill_enclosed

MASKS = arrays(np.uint8, (7, 9), elements=st.sampled_from([0, 90, 255, 255]))


def filled(mask, before, steps):
    """The same by definition: paths grow pixel by pixel."""
    open_pixels = mask < 255
    reached = open_pixels & (before < 255)
    for _ in range(steps):
        grown = np.pad(reached, 1)
        near = np.any([grown[1 + y : 8 + y, 1 + x : 10 + x] for y in (-1, 0, 1) for x in (-1, 0, 1)], axis=0)
        reached = reached | (near & open_pixels)
    return np.where(open_pixels & ~reached, 255, mask)


@given(mask=MASKS, before=MASKS, steps=st.integers(0, 5))
@settings(deadline=None)
def test_gaps_that_no_short_path_joins_to_the_outside_are_filled(mask, before, steps):
    expected = filled(mask, before, steps)
    made = mask.copy()
    assert fill_enclosed(made, before, steps) == (expected != mask).sum()
    assert np.array_equal(made, expected)


def test_hole_in_the_middle_is_filled_and_a_dent_is_not():
    before = np.zeros((9, 9), np.uint8)
    before[1:8, 1:8] = 255
    mask = before.copy()
    mask[4, 4] = 0
    mask[1:3, 2] = 0
    assert fill_enclosed(mask, before, 5) == 1
    assert mask[4, 4] == 255
    assert not mask[1:3, 2].any()
