"""What is costly to make is made once where the tests that share it run in one process: their group must count."""

import pytest


@pytest.mark.xdist_group("groups")
def test_a_parallel_run_sees_the_groups_of_tests(request):
    parallel = getattr(request.config.option, "loadgroup", False)
    assert not parallel or request.node.nodeid.endswith("@groups")
