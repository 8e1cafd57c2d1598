"""Ways to ask the service that asks for keys."""

import pytest


@pytest.fixture
def anyone(guarded):
    """HTTP without a key."""
    with guarded.http() as http:
        yield http


@pytest.fixture
def everything(guarded):
    with guarded.http("everything") as http:
        yield http
