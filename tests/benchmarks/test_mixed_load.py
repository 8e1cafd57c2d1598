"""A small run of the mixed load on a real service, and what its figures mean."""

import copy
import itertools
from argparse import Namespace

import pytest

from benchmarks.mixed_load import bars, print_table, run
from benchmarks.mixed_requests import MIX, THUMBNAIL, Known, mixed
from client.shapes import write_ply
from tests.meshes import bumpy_sphere

pytestmark = pytest.mark.xdist_group("mixed load")  # one run of the benchmark for all tests


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    path = tmp_path_factory.mktemp("mixed") / "bumpy.ply"
    write_ply(str(path), *bumpy_sphere(3))
    return run(Namespace(mesh=[str(path)], minutes=0.06, clients=4, uploaders=1, texels=128, seed=2, measure=False))


def test_a_service_answers_everything_as_expected(result):
    assert result["bars"]["no 5xx"] and result["bars"]["every answer as expected"], result


def test_every_phase_has_its_kinds_and_the_service_was_watched(result, capsys):
    assert result["half"]["kinds"][THUMBNAIL]["p99_ms"] > 0.0
    watched = {"service RSS MiB", "service files", "service threads", "reader RSS MiB", "worker 1 own MiB", "temporary files"}
    assert watched <= result["growth"].keys()
    assert result["queue_keys"]
    print_table(result)
    assert "no 5xx" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "bar"),
    [
        (lambda r: r["saturated"].update(server_errors=1), "no 5xx"),
        (lambda r: r["warm"].update(unexpected=1), "every answer as expected"),
        (lambda r: r["uploads"]["half"]["faults"].append("lost"), "every answer as expected"),
        (lambda r: r["growth"]["service RSS MiB"].update(holds=False), "memory does not grow"),
        (lambda r: r["growth"]["service files"].update(holds=False), "files and threads do not grow"),
        (lambda r: r["half"]["kinds"][THUMBNAIL].update(p99_ms=61.0), "p99 of a kept thumbnail under 60 ms"),
    ],
)
def test_whatever_does_not_hold_is_told(result, change, bar):
    broken = copy.deepcopy(result)
    change(broken)
    assert not bars(broken)[bar]


def test_the_same_seed_asks_for_the_same_and_every_kind_comes():
    known = Known(["a" * 32, "b" * 32], {"/thumbnail": '"tag"'}, b"ply")
    first, again = (list(itertools.islice(mixed(known, 3), 2000)) for _ in range(2))
    assert first == again
    assert len({request.kind for request in first}) == len(MIX)
    assert all(200 not in request.expected for request in first if request.kind in ("wrong", "leaves", "not modified"))
