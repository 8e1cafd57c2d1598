"""Axes hold what they are made for, in order, with round ticks."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.accuracy.axes import FLOOR, MOST_TICKS, linear_axis, log_axis

POSITIVE = st.lists(st.floats(1e-5, 1e5), min_size=1, max_size=20)
ANY = st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=20)


@given(POSITIVE)
def test_logarithmic_axis_holds_all_values_in_order_between_two_ticks_or_more(values):
    axis = log_axis(values, 10.0, 110.0)
    places = [axis.at(value) for value in sorted(values)]
    assert places == sorted(places)
    assert places[0] >= 10.0
    assert places[-1] <= 110.0
    assert 2 <= len(axis.ticks) <= MOST_TICKS
    assert all(10.0 <= axis.at(value) <= 110.0 for value, _ in axis.ticks)


@given(POSITIVE)
def test_ticks_say_what_they_are_at(values):
    for axis in (log_axis(values, 0.0, 1.0), linear_axis(values, 0.0, 1.0)):
        assert all(float(words) == pytest.approx(value, rel=1e-5, abs=1e-12) for value, words in axis.ticks)


@given(POSITIVE)
def test_logarithmic_ticks_begin_with_one_two_or_five(values):
    assert {f"{value:e}"[0] for value, _ in log_axis(values, 0.0, 1.0).ticks} <= {"1", "2", "5"}


@given(ANY)
def test_linear_axis_holds_all_values_in_order_with_even_ticks(values):
    axis = linear_axis(values, 300.0, 100.0)  # y grows downwards
    places = [axis.at(value) for value in sorted(values)]
    assert places == sorted(places, reverse=True)
    assert all(100.0 <= place <= 300.0 for place in places)
    gaps = [b - a for (a, _), (b, _) in pairwise(axis.ticks)]
    assert 2 <= len(axis.ticks) <= MOST_TICKS + 1
    assert gaps == pytest.approx([gaps[0]] * len(gaps), rel=1e-6)


def test_nought_has_a_place_and_a_tick_of_its_own_on_a_logarithmic_axis():
    axis = log_axis([0.0, 0.01, 0.1], 200.0, 100.0, 220.0)
    assert axis.at(0.0) == axis.at(FLOOR) == 220.0
    assert axis.ticks[0] == (0.0, "0")
    assert axis.at(0.01) < 200.0
    without = log_axis([0.01, 0.1], 200.0, 100.0, 220.0)
    assert "0" not in [words for _, words in without.ticks]


def test_axis_of_nothing_but_noughts_can_be_drawn():
    assert log_axis([0.0, 0.0], 200.0, 100.0, 220.0).at(0.0) == 220.0
