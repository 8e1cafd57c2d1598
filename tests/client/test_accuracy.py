"""What accuracy costs, in Python and as a command, of a mesh whose ladder is stored."""

from __future__ import annotations

import json
import os

import pytest

from backend import records
from backend.local_store import LocalStore
from client.errors import NotReadyError, RequestError
from schemas.manifest import StageRecord
from tests.client.command import silhouette
from tests.conftest import HULL_FACES
from tests.service.accuracy.ladders import a_ladder, a_report

WIDE = {**os.environ, "COLUMNS": "100"}


@pytest.fixture(scope="module")
def measured(service, client, knot_file):
    """Id of a mesh with a ladder of 100 rungs."""
    mesh = client.upload(knot_file, hull_faces=HULL_FACES + 40, texels=128)
    record = StageRecord(stage="measure", outcome="done", seconds=1.0, report=a_ladder(100).model_dump(mode="json"))
    store = LocalStore(service.data_dir / "store")
    with records.publishing(store, mesh.id):  # before it is ready: a service that does not measure looks no more then
        records.write_stage(store, mesh.id, record)
    client.wait(mesh.id, timeout_s=280.0)
    yield mesh.id
    client.delete(mesh.id)


def lines(*arguments, url):
    run = silhouette("accuracy", *arguments, url=url, env=WIDE)
    assert run.returncode == 0, run.stderr
    assert b"\x1b" not in run.stdout, "no terminal codes in a pipe"
    return run.stdout.decode().splitlines()


def test_client_has_the_report_of_a_size_and_the_plot(client, measured):
    assert client.info(measured).links["accuracy"] == f"/v1/meshes/{measured}/accuracy"
    small = client.accuracy(measured, size=200)
    assert (small.size, small.mesh, len(small.rungs)) == (256, measured, 100)
    assert small.rungs == a_report(size=256).rungs
    assert client.accuracy(measured).size == 512
    assert client.accuracy_plot(measured, 256) != client.accuracy_plot(measured, 512)
    assert b"faces" in client.accuracy_plot(measured)[:2000]


def test_client_says_which_devices_there_are_and_what_is_not_measured(client, knot, measured):
    with pytest.raises(RequestError, match="a device"):
        client.accuracy(measured, device="abacus")
    with pytest.raises(NotReadyError, match="switched off"):
        client.accuracy(knot.id)


def test_table_has_the_fronts_and_what_each_antialias_draws_by_itself(service, measured):
    report, (head, _, *rows, told) = a_report(), lines(measured, url=service.url)
    assert "small knot.ply, 512 x 512 px, 12 views, times measured on a device" in head
    fronts = {*report.pareto.outline, *report.pareto.shading}
    drawn = [row.split() for row in rows]
    times = [next(float(cell) for cell in cells if cell[0].isdigit()) for cells in drawn]
    assert times == sorted(times)
    assert {f"{report.rungs[n].ms:.2f}" for n in fronts} == {cells[1] for cells in drawn if cells[0] in ("outline", "shading", "both")}
    assert {cell for cells in drawn for cell in cells if "/" in cell} == {f"{r.source}/{r.antialias}" for r in report.rungs}
    assert f"{100 - len(rows)} more with --all" in told


def test_table_fits_a_hundred_columns_and_all_has_every_rung(service, measured):
    printed = lines(measured, "--all", "--size", "256", url=service.url)
    assert len(printed) == 103
    assert max(map(len, printed[1:])) <= 100
    assert "…" not in "".join(printed)
    assert "256 x 256 px" in printed[0]


def test_report_as_json_and_plot_as_a_file(service, measured, tmp_path):
    report = json.loads("\n".join(lines(measured, "--json", url=service.url)))
    assert (report["mesh"], len(report["rungs"])) == (measured, 100)
    assert lines(measured, "-o", tmp_path / "plot.svg", url=service.url) == []
    assert (tmp_path / "plot.svg").read_text().startswith("<svg")
    piped = silhouette("accuracy", measured, "-o", "-", url=service.url)
    assert piped.stdout == (tmp_path / "plot.svg").read_bytes()


def test_mesh_that_is_not_measured_is_one_line(service, knot):
    run = silhouette("accuracy", knot.id, url=service.url)
    assert run.returncode == 1
    assert run.stderr.decode().startswith("error This mesh has not been measured, and measuring is switched off here")
