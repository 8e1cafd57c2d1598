"""What grows is told from what only moves about."""

import os
import time

import numpy as np
import pytest

from benchmarks.growth import Watch, files_under, memory_mib, open_files, slope_of, threads


def seen(slope, noise, count=200, seed=1):
    """(seconds, values): a second apart, neighbours alike as in memory that is taken and given back."""
    chance, t = np.random.default_rng(seed), np.arange(count, dtype=float)
    moves = np.convolve(chance.normal(size=count + 9), np.ones(10) / np.sqrt(10), "valid")
    return t, 500.0 + slope * t / 60.0 + noise * moves


@pytest.mark.parametrize("seed", range(5))
def test_a_slope_beyond_the_noise_is_found(seed):
    slope = slope_of(*seen(6.0, 0.5, seed=seed))
    assert slope.low < 6.0 < slope.high or slope.a_minute == pytest.approx(6.0, rel=0.2)
    assert slope.a_minute == pytest.approx(6.0, rel=0.3) and not slope.may_be_none


def test_what_only_moves_about_may_not_grow_at_all():
    found = [slope_of(*seen(0.0, 2.0, seed=seed)).may_be_none for seed in range(20)]
    assert sum(found) >= 17


def test_a_single_leap_is_no_slope():
    t, y = np.arange(200.0), np.full(200, 10.0)
    y[190:] = 1000.0
    assert slope_of(t, y).a_minute == 0.0


def test_too_few_values_say_nothing():
    assert slope_of([0.0, 1.0], [1.0, 2.0]) is None


def test_a_watch_keeps_what_it_saw_and_leaves_out_what_was_gone():
    calls = iter(range(10**6))

    def look():
        if (call := next(calls)) % 2:
            raise ProcessLookupError
        return {"calls": float(call)}

    with Watch(look, 0.001) as watch:
        deadline = time.monotonic() + 30.0
        while len(watch.samples) < 5 and time.monotonic() < deadline:
            time.sleep(0.01)
    times, values = watch.since(watch.seconds[2])["calls"]
    assert values[:2] == [4.0, 6.0] and len(times) == len(values)


def test_a_process_is_looked_at_by_its_id(tmp_path):
    resident, own = memory_mib(os.getpid())
    assert resident > own > 1.0
    before = open_files(os.getpid())
    with (tmp_path / "one").open("w"):
        assert open_files(os.getpid()) == before + 1
    assert threads(os.getpid()) >= 1
    (tmp_path / "folder").mkdir()
    assert files_under(tmp_path) == 1 and files_under(tmp_path / "none") == 0
