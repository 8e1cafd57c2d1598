"""Pictures in bands of rows are the same however many bands and cores there are."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from service.kernels.hull_bands import PASSES
from service.kernels.intrinsics import cycles, take
from service.render import bands
from service.render.bands import MOST_PIXELS, rows_of
from service.threads import side_by_side
from service.tile import Tile
from tests.service.render.conftest import VIEWS

MODES = ({"mode": "lambert"}, {"mode": "normal"}, {"mode": "mask", "color": "#3366cc"})


@pytest.mark.parametrize("background", ["transparent", "#204060"])
@pytest.mark.parametrize("shading", MODES, ids=lambda shading: shading["mode"])
@pytest.mark.parametrize("view", VIEWS)
def test_bands_make_the_picture_that_one_makes(draw, monkeypatch, view, shading, background):
    pictures = []
    for rows in (1000, 64, 7, 1):
        monkeypatch.setattr(bands, "rows_of", lambda area, _, rows=rows: min(rows, area.height))
        pictures.append(draw("joined", size=(200, 150), camera=VIEWS[view], shading=shading, background=background).pixels)
    assert len(np.unique(pictures[0].reshape(-1, 4), axis=0)) > 10
    for picture in pictures[1:]:
        assert np.array_equal(picture, pictures[0])


@pytest.mark.parametrize("shading", MODES, ids=lambda shading: shading["mode"])
def test_what_an_earlier_picture_left_in_memory_does_not_show(draw, shading):
    view = {"eye": [0.0, 0.0, 9.0], "target": [1.0, 0.7, 0.0], "fov_y_deg": 30}
    first = draw("torus", size=(160, 120), camera=view, shading=shading).pixels.copy()
    for _ in range(3):
        draw("sphere", size=(160, 120), camera=VIEWS["close"], background="#ffffff", shading=shading)
        again = draw("torus", size=(160, 120), camera=view, shading=shading)
        assert np.array_equal(again.pixels, first)
    assert 0 < np.count_nonzero(first[:, :, 3]) < first.shape[0] * first.shape[1] // 2


def test_each_pass_has_its_part_of_the_time(draw):
    times = dict(draw("torus", size=(300, 300)).passes)
    assert all(times[name] > 0.0 for name in PASSES)
    bare = dict(draw("torus", size=(300, 300), shading={"mode": "mask"}).passes)
    assert {"coverage", "composite"} == set(bare) & set(PASSES)


@given(st.integers(0, 9000), st.integers(0, 9000), st.integers(1, 9000), st.integers(1, 9000), st.integers(1, 64))
def test_bands_are_small_enough_to_be_kept_and_not_empty(x, y, width, height, threads):
    rows = rows_of(Tile(x, y, width, height), threads)
    assert 1 <= rows <= height
    assert rows == 1 or rows * width <= MOST_PIXELS


@njit(nogil=True)
def _take_many(counter, mine):
    for i in range(mine.shape[0]):
        mine[i] = take(counter)


def test_no_two_threads_take_the_same_number():
    counter, lists = np.zeros(1, np.int64), [np.empty(200_000, np.int64) for _ in range(4)]
    _take_many(counter, np.empty(0, np.int64))
    threads = [threading.Thread(target=_take_many, args=(counter, mine)) for mine in lists]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert np.array_equal(np.sort(np.concatenate(lists)), np.arange(800_000))
    assert counter[0] == 800_000


@njit
def _clock():
    return cycles()


def test_the_clock_runs():
    first = _clock()
    assert _clock() > first


def test_work_side_by_side_runs_at_the_same_time_and_fails_when_one_fails():
    both = threading.Barrier(2, timeout=20)
    assert sorted(side_by_side(both.wait, 2)) == [0, 1]
    calls = iter(range(2))

    def fail_once() -> None:
        if next(calls) == 1:
            raise ValueError("the second one")

    with pytest.raises(ValueError, match="the second one"):
        side_by_side(fail_once, 2)
