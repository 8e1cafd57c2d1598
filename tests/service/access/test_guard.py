"""What the guard makes of an answer's caching."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.access.guard import _cache_control
from service.caching import IMMUTABLE, NOT_KEPT, REVALIDATE


@pytest.mark.parametrize(
    ("told", "by_key"),
    [
        (IMMUTABLE, "private, max-age=31536000, immutable"),
        (REVALIDATE, "private, no-cache"),
        (NOT_KEPT, "no-store"),
        ("", "private"),
    ],
)
def test_what_came_with_a_key_is_for_its_client_alone(told, by_key):
    assert _cache_control(told, None) == by_key


@given(st.integers(-10, 10**9))
def test_what_is_signed_is_fresh_no_longer_than_it_lasts(seconds):
    parts = _cache_control(IMMUTABLE, int(time.time()) + seconds).split(", ")
    (age,) = (int(part.removeprefix("max-age=")) for part in parts if part.startswith("max-age="))
    assert 0 <= age <= max(0, seconds) and age <= 31536000
    assert "must-revalidate" in parts and "immutable" not in parts


def test_what_is_asked_for_each_time_stays_so():
    until = int(time.time()) + 1000
    assert (_cache_control(REVALIDATE, until), _cache_control(NOT_KEPT, until)) == (REVALIDATE, NOT_KEPT)
    assert _cache_control("", until) == "private, no-cache"
