import os
import time

import numpy as np
import pytest

from benchmarks.isolated import FailedError, isolated
from benchmarks.models import AbsentError


def filled(mib):
    return int(np.ones(mib * 2**20, np.uint8).sum())


def raising(error):
    raise error


def test_value_and_memory_come_back():
    _, small = isolated(filled, 1)
    value, large = isolated(filled, 200)
    assert value == 200 * 2**20
    assert 150.0 < large - small < 260.0


def test_an_absent_thing_is_told_apart_from_a_failure():
    with pytest.raises(AbsentError, match="no VTK"):
        isolated(raising, AbsentError("no VTK"))
    with pytest.raises(FailedError, match="KeyError: 'lost'"):
        isolated(raising, KeyError("lost"))
    with pytest.raises(FailedError, match="this mesh has no hull"):
        isolated(raising, SystemExit("this mesh has no hull"))


def test_a_process_that_dies_is_a_failure():
    with pytest.raises(FailedError, match="status 7"):
        isolated(os._exit, 7)


def test_what_takes_too_long_is_ended():
    begun = time.perf_counter()
    with pytest.raises(FailedError, match="not done after 1 s"):
        isolated(time.sleep, 60.0, limit_s=1.0)
    assert time.perf_counter() - begun < 20.0
