"""The normalised frame."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.conventions import Frame

coordinate = st.floats(-1e6, 1e6, allow_nan=False)


@given(st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=2, max_size=20, unique=True))
def test_frame_puts_every_point_inside_the_unit_sphere_and_one_on_it(points):
    p = np.array(points)
    frame = Frame.around(p)
    length = np.linalg.norm(frame.to_normalised(p), axis=1)
    assert length.max() == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12, 1e200])
@pytest.mark.parametrize("offset", [0.0, 1e7])
def test_frame_round_trip_keeps_float64_accuracy(scale, offset):
    p = (np.random.default_rng(0).uniform(-1, 1, (100, 3)) + offset) * scale
    frame = Frame.around(p)
    error = np.abs(frame.to_model(frame.to_normalised(p)) - p).max()
    assert error <= 4 * np.spacing(np.abs(p).max())


@pytest.mark.parametrize("points", [np.empty((0, 3)), [[0, 0, np.nan]], [[1, 2, 3], [1, 2, 3]]])
def test_frame_refuses_points_without_an_extent(points):
    with pytest.raises(ValueError, match="points"):
        Frame.around(points)
