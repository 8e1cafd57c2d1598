from __future__ import annotations

import pytest

from service.render.state import Gpu


@pytest.fixture(scope="session")
def gpu():
    """The one context of this process's tests: a second would take its place."""
    gpu = Gpu(64)
    yield gpu
    gpu.release()
