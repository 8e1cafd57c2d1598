"""Every table on a small knot: that it runs, and that its rows add up."""

import json

import numpy as np
import pytest

from benchmarks.isolated import isolated
from benchmarks.models import AbsentError
from benchmarks.tables import figure9, figure10, figure11, hulls, making, preprocessing, table1, table2
from client.shapes import torus_knot, write_ply

pytestmark = pytest.mark.xdist_group("tables")  # one process for all that is measured

MACHINE = {"processor": "a", "cores": 2, "memory_gib": 1.0, "system": "b", "python": "3", "packages": {}, "load": 0.0}
SMALL_TEXELS = 128
SIZES_OF_DRAWN = {
    table1: {"texels": SMALL_TEXELS},
    table2: {},
    figure9: {},
    figure10: {"texels": SMALL_TEXELS},
    figure11: {"texels": SMALL_TEXELS},
}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    path = tmp_path_factory.mktemp("small") / "small.ply"
    write_ply(str(path), *torus_knot(60, 10))
    return str(path)


def drawn_rows(mesh):
    """{name of a table: its quick row, or the word for what is absent}."""
    rows = {}
    for table, sizes in SIZES_OF_DRAWN.items():
        try:
            rows[table.TABLE.name] = table.TABLE.measure(mesh, True, **sizes)
        except AbsentError as absent:
            rows[table.TABLE.name] = str(absent)
    return rows


@pytest.fixture(scope="module")
def rows(small):
    """Of all tables that draw or extract, in one process: it has a GL context of its own and loads the kernels once."""
    return isolated(drawn_rows, small, limit_s=280.0)[0]


def measured(table, rows):
    row = rows[table.TABLE.name]
    if isinstance(row, str):
        pytest.skip(row)
    return row, result_of(table, row)


def result_of(table, row):
    return {"name": table.TABLE.name, "quick": True, "machine": MACHINE, "meshes": {"small": row}, "left_out": {}, "failed": {}}


def written(table, result, folder):
    pytest.importorskip("matplotlib")
    making.write(table.TABLE, result, folder)
    page = (folder / f"{table.TABLE.name}.md").read_text()
    for picture in folder.glob("*.png"):
        assert picture.read_bytes()[:4] == b"\x89PNG"
        assert f"({picture.name})" in page
    assert json.loads((folder / f"{table.TABLE.name}.json").read_text())["meshes"]["small"]
    return page


def test_table_1_has_all_rungs_and_steps(rows, tmp_path):
    row, result = measured(table1, rows)
    assert row["faces"] == 1200
    assert set(row["steps"]) == {"stencil", "line", "coverage"}
    assert all(row["steps"][rung]["extraction"] > 0.0 and row["steps"][rung]["hull"] > 0.0 for rung in row["steps"])
    assert row["outline"]["mean_abs_error_edge_pixels"] < 0.01
    assert "original / clipped coverage" in written(table1, result, tmp_path)


def test_table_2_has_no_mismatch(rows, tmp_path):
    row, result = measured(table2, rows)
    assert (row["mismatches"], row["numpy_mismatches"], row.get("vtk_mismatches", 0)) == (0, 0, 0)
    assert min(row["tree_us"], row["numpy_us"], row["brute_simd_us"]) > 0.0
    assert "**SIMD / tree**" in written(table2, result, tmp_path)


def test_table_of_hulls_proves_enclosure(small, tmp_path):
    row = hulls.TABLE.measure(small, True)
    assert [hull["enclosed"] for hull in row["ours"]] == [True]
    assert row["ours"][0]["faces"] <= 300
    assert 0.0 < row["ours"][0]["volume_excess"] < 1.0
    assert row["our_mib"] > 50.0
    written(hulls, result_of(hulls, row), tmp_path)


def test_table_of_preprocessing_has_every_stage(small, tmp_path):
    row = preprocessing.TABLE.measure(small, True)
    stages = {stage["name"] for stage in row["stages"]}
    assert {"load", "hull", "bake", "tree", "verify"} <= stages
    page = written(preprocessing, result_of(preprocessing, row), tmp_path)
    assert all(f" {stage} " in page for stage in stages)


def test_figure_9_is_coarse_to_fine(rows, tmp_path):
    row, result = measured(figure9, rows)
    assert [point["faces"] for point in row["points"]] == [500, 1200]
    assert row["points"][0]["silhouette_edges"] < row["points"][1]["silhouette_edges"]
    written(figure9, result, tmp_path)


def test_growth_is_the_exponent():
    points = [{"silhouette_edges": m, "tree_us": 3.0 * m, "brute_simd_us": 0.1 * m**2} for m in (10, 50, 300)]
    assert figure9.growth(points, "tree_us") == pytest.approx(1.0)
    assert figure9.growth(points, "brute_simd_us") == pytest.approx(2.0)


def test_figure_10_clipped_outline_is_better_than_the_simplified(rows, tmp_path):
    row, result = measured(figure10, rows)
    wrong = {label: errors["outline_px"] for label, errors in row["drawn"].items()}
    assert wrong["clipped hull, exact coverage"] < 0.2 * wrong["simplified, normal-mapped"]
    assert wrong["clipped hull, exact coverage"] < wrong["original, 4x MSAA"] < wrong["original, no antialiasing"]
    written(figure10, result, tmp_path)
    assert "pictures" not in json.loads((tmp_path / "figure10.json").read_text())["meshes"]["small"]


def test_worst_window_is_where_the_error_is():
    wrong = np.zeros((40, 50))
    wrong[20:24, 30:34] = 1.0
    row, column = figure10.worst_window(wrong, 8)
    assert row <= 20 <= 24 <= row + 8
    assert column <= 30 <= 34 <= column + 8


def test_linear_light_and_back():
    pixels = np.dstack([np.arange(256, dtype=np.uint8)[None]] * 3 + [np.full((1, 256), 255, np.uint8)])
    assert np.array_equal(figure10.over_white(figure10.linear(pixels)), pixels[..., :3])


def test_figure_11_runs(rows, tmp_path):
    row, result = measured(figure11, rows)
    assert [point["faces"] for point in row["points"]] == [500, 1200]
    written(figure11, result, tmp_path)


def test_equal_time_lies_between_the_measured_meshes():
    points = [{"faces": 100, "drawn": 1.0, "clipped": 0.5}, {"faces": 10_000, "drawn": 100.0, "clipped": 10.0}]
    assert figure11.equal_time(points, "clipped", "drawn") == [100, 1000]
    points[1]["clipped"] = 101.0
    assert figure11.equal_time(points, "clipped", "drawn")[1] is None
