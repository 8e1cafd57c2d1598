"""The capacity model: limits that are known without it, and that its page says what it says."""

import re
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.capacity import (
    HASHED,
    MIB,
    ROWS,
    SPREAD,
    Inputs,
    Wanted,
    changed,
    kept,
    plan,
    popularity,
    preparing,
    serving,
    storing,
    tables,
    variants,
)

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "capacity.md"
FEW = Wanted(meshes=20_000, renders_per_s=2_000.0)


def test_popularity_has_every_mesh_and_every_request():
    for zipf in (0.0, 0.9, 1.2):
        asked = popularity(replace(FEW, zipf=zipf))
        assert asked.counts.sum() == FEW.meshes
        assert asked.sum(asked.rates) == pytest.approx(FEW.renders_per_s)
        assert (np.diff(asked.rates) <= 1e-12).all()


def test_groups_of_meshes_say_the_same_as_single_ones():
    asked = popularity(FEW)
    rates = np.arange(1, FEW.meshes + 1) ** -FEW.zipf
    rates *= FEW.renders_per_s / rates.sum()
    single = (rates * kept(rates, np.ones_like(rates), 2_000)).sum()
    assert asked.sum(asked.rates * kept(asked.rates, asked.counts, 2_000)) == pytest.approx(single, rel=1e-3)


def test_a_cache_is_as_full_as_it_has_room():
    rates, counts = np.array([100.0, 1.0, 0.01]), np.array([10.0, 100.0, 1000.0])
    for room in (5.0, 50.0, 500.0):
        assert (kept(rates, counts, room) * counts).sum() == pytest.approx(room, rel=1e-6)


def test_a_cache_has_all_where_there_is_room_and_its_part_where_all_are_alike():
    rates, counts = np.full(4, 3.0), np.full(4, 25.0)
    assert kept(rates, counts, 100.0) == pytest.approx(1.0)
    assert kept(rates, counts, 20.0) == pytest.approx(0.2)


def test_the_approximation_agrees_with_a_cache_that_is_played_through():
    rates = np.arange(1, 201) ** -0.9
    drawn = np.random.default_rng(7).choice(200, 40_000, p=rates / rates.sum())
    cache: dict[int, None] = {}
    hits = 0
    for thing in drawn.tolist():
        hits += thing in cache
        cache.pop(thing, None)
        cache[thing] = None
        if len(cache) > 40:
            del cache[next(iter(cache))]
    told = (rates * kept(rates, np.ones(200), 40.0)).sum() / rates.sum()
    assert hits / len(drawn) == pytest.approx(told, abs=0.01)


def test_things_that_pass_through_take_room_from_those_that_stay():
    rates, counts = np.full(10, 1.0), np.ones(10)
    assert (kept(rates, counts, 10.0, passing=100.0) < kept(rates, counts, 9.0)).all()


def test_one_process_serves_what_one_core_draws():
    inputs = Inputs(drawn_per_core_s=100.0, drawn_per_process_s=100.0, load_core_s=0.0, copy_core_s=0.0)
    assert serving(inputs, Wanted(meshes=1, renders_per_s=49.0, same=0.0, use=0.5), HASHED)["processes"] == 1
    assert serving(inputs, Wanted(meshes=1, renders_per_s=51.0, same=0.0, use=0.5), HASHED)["processes"] == 2


def test_meshes_that_have_one_process_each_cost_less_than_meshes_that_all_have():
    spread, hashed = (serving(Inputs(), FEW, routing) for routing in (SPREAD, HASHED))
    for name in ("processes", "cores", "drawn", "loads", "store_requests"):
        assert hashed[name] < spread[name]


def test_pictures_that_are_never_the_same_are_all_drawn():
    assert serving(Inputs(), replace(FEW, same=0.0), HASHED)["drawn"] == pytest.approx(FEW.renders_per_s)


def test_sums_over_meshes_are_sums_over_meshes():
    found = storing(Inputs(stored_bytes=2.0**20, stored_objects=10.0, list_s=0.5), Wanted(meshes=2**20))
    assert (found["artifacts_tib"], found["objects"]) == (1.0, 10 * 2**20)
    assert found["all_listed_s"] == pytest.approx(0.5 * 10 * 2**20 / 1000)
    made = preparing(Inputs(prepare_core_s=9.0, upload_bytes=MIB), Wanted(meshes=86_400, days=1.0, workers_use=0.9))
    assert (made["meshes_per_s"], made["upload_mib_s"], made["workers"]) == (1.0, 1.0, 10)


def test_inputs_can_be_given_and_unknown_ones_are_refused():
    assert changed(Inputs(), ["stored_bytes=5e6"]).stored_bytes == 5e6
    with pytest.raises(SystemExit, match="no such input: colour"):
        changed(Inputs(), ["colour=1"])


def test_the_program_prints_every_figure():
    command = [sys.executable, "-m", "benchmarks.capacity", "--meshes", "1e4", "--renders", "100"]
    printed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True, timeout=120).stdout
    assert all(text in printed for part in ROWS.values() for text in part.values())


def test_the_page_has_the_figures_and_inputs_of_the_model():
    text = PAGE.read_text()
    assert tables(plan(Inputs(), Wanted())) in text
    assert variants(Inputs(), Wanted()) in text
    for field in fields(Inputs):
        (told,) = re.findall(rf"^\| `{field.name}` \| ([0-9.,]+) \|", text, re.M)
        assert float(told.replace(",", "")) == getattr(Inputs(), field.name)
