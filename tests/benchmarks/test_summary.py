import json

import pytest

from benchmarks.summary import Bar, bars, document, of, of_hull, over, summarise, write

MACHINE = {"processor": "a", "cores": 2, "memory_gib": 1.0, "system": "b", "python": "3", "packages": {}, "load": 0.0}


def result(meshes, **kinds):
    return {"quick": False, "machine": MACHINE, "meshes": meshes, "left_out": {}, "failed": {}} | kinds


def verdict(summary, what, on):
    return next(row for row in summary["bars"] if row["what"] == what and row["on"] == on)


def extraction(simd, scalar=100.0, **more):
    return {"brute_simd_us": simd, "brute_scalar_us": scalar, "tree_us": 10.0, "mismatches": 0, "stored_edges": 1, "stored_nodes": 1} | more


@pytest.mark.parametrize(("value", "at_least", "met"), [(4.0, True, True), (3.99, True, False), (4.0, False, True), (4.01, False, False)])
def test_a_limit_itself_meets_the_bar(value, at_least, met):
    assert Bar("", "", 4.0, at_least, "", of("t", "m")).met(value) is met


def test_every_bar_has_its_own_name_and_none_is_met_by_nothing():
    rows = summarise({})["bars"]
    assert len({(row["what"], row["on"]) for row in rows}) == len(rows) == len(bars())
    assert {row["met"] for row in rows} == {None}


def test_ratios_are_of_slow_over_fast():
    summary = summarise({"table2": result({"bunny_closed": extraction(41.0), "knot": extraction(79.0)})})
    assert verdict(summary, "extraction: SIMD brute force / tree", "bunny_closed")["measured"] == pytest.approx(4.1)
    assert verdict(summary, "extraction: SIMD brute force / tree", "bunny_closed")["met"] is True
    assert verdict(summary, "extraction: SIMD brute force / tree", "knot")["met"] is False
    assert verdict(summary, "extraction: SIMD brute force / tree", "holes3")["met"] is None


def test_one_mismatch_on_any_mesh_fails_the_bar():
    meshes = {"bunny_closed": extraction(41.0), "knot": extraction(79.0, mismatches=1)}
    row = verdict(summarise({"table2": result(meshes)}), "extraction: eyes with another silhouette than the exact one", "all")
    assert (row["measured"], row["met"]) == (1, False)


def hulls(excess, enclosed):
    row = {"faces_requested": 1000, "faces": 1000, "seconds": 1.0, "volume_excess": excess, "enclosed": enclosed}
    return result({"bunny_closed": {"ours": [row], "our_mib": 512.0}})


def test_excess_volume_is_in_percent_of_the_requested_hull():
    assert of_hull("bunny_closed", 1000, "volume_excess", 100.0)({"hulls": hulls(0.044, True)}) == pytest.approx(4.4)
    assert of_hull("bunny_closed", 500, "volume_excess", 100.0)({"hulls": hulls(0.044, True)}) is None


def test_a_hull_that_does_not_enclose_is_counted():
    row = verdict(summarise({"hulls": hulls(0.01, enclosed=False)}), "hulls that do not enclose", "all")
    assert (row["measured"], row["met"]) == (1, False)
    row = verdict(summarise({"hulls": hulls(0.01, enclosed=True)}), "hulls that do not enclose", "all")
    assert (row["measured"], row["met"]) == (0, True)


def test_missing_values_give_no_ratio():
    assert over("t", "m", "slow", "fast")({"t": result({"m": {"slow": 3.0, "fast": None}})}) is None
    assert over("t", "m", "slow", "fast")({"t": result({})}) is None


def test_page_says_what_is_met_what_is_not_and_what_failed(tmp_path):
    table = result({"bunny_closed": extraction(30.0)}, failed={"knot": "it died"}, left_out={"dragon_871k": "not here"})
    (tmp_path / "table2.json").write_text(json.dumps(table))
    page = write(tmp_path)
    assert "| extraction: SIMD brute force / tree | bunny_closed | ≥ 4 x | 3.00 x | **not met** |" in page
    assert "| extraction: SIMD brute force / tree | knot | ≥ 8 x | – | not measured |" in page
    assert "Failed: table2, knot: it died." in page
    assert "Left out: table2, dragon_871k: not here." in page
    assert page == (tmp_path / "summary.md").read_text() == document(json.loads((tmp_path / "summary.json").read_text()))
