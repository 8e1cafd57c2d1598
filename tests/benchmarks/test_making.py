"""How a table is made of meshes that are there, absent, or fail: with a measurement that costs nothing, and imports nothing."""

import json

import pytest

from benchmarks.tables import making
from benchmarks.tables.making import Table


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.ply"
    path.write_bytes(b"ply")
    return str(path)


def count(mesh, quick):
    if "bad" in mesh:
        raise ValueError("this one is broken")
    return {"quick": quick}


def test_a_failing_and_an_absent_mesh_are_told_and_the_others_are_made(small, tmp_path):
    bad = tmp_path / "bad.ply"
    bad.write_bytes(b"")
    table = Table("counting", "Counting", (small,), count, lambda result: f"{len(result['meshes'])} meshes")
    result = making.make(table, [small, str(bad), "nowhere"], quick=True)
    assert result["meshes"]["small"]["quick"] is True
    assert result["failed"] == {"bad": "ValueError: this one is broken"}
    assert "nowhere is not on this machine" in result["left_out"]["nowhere"]
    page = making.document(table, result, [])
    assert "1 meshes" in page
    assert "Failed: bad: ValueError: this one is broken." in page


def test_a_table_ends_with_status_1_when_a_mesh_failed(small, tmp_path, capsys):
    bad = tmp_path / "bad.ply"
    bad.write_bytes(b"")
    table = Table("counting", "Counting", (), count, lambda result: f"{len(result['meshes'])} meshes")
    with pytest.raises(SystemExit, match="0"):
        making.main(table, [small, "--json"])
    assert json.loads(capsys.readouterr().out)["meshes"]["small"]["quick"] is False
    with pytest.raises(SystemExit, match="1"):
        making.main(table, [small, str(bad), "--out", str(tmp_path / "out")])
    assert (tmp_path / "out" / "counting.md").exists()
