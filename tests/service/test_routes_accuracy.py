"""The measured ladder over HTTP: before it is there, when it is there, and as a plot."""

import xml.etree.ElementTree as ET

import pytest

from client import Client
from client.shapes import write_ply
from schemas.jobs import STAGES
from schemas.ladder import AccuracyReport
from schemas.manifest import StageRecord
from service.measure.ladder import measure_step, put_together, steps
from tests import meshes
from tests.service.test_routes_early import Work, http, idle  # noqa: F401 - fixtures


@pytest.fixture
def accepted(idle, http, tmp_path):  # noqa: F811
    """(address, work): a mesh that nothing has been done for."""
    write_ply(str(tmp_path / "mesh.ply"), *meshes.bumpy_sphere(2, 0.3))
    body = (tmp_path / "mesh.ply").read_bytes()
    mesh = http.post("/v1/meshes", params={"name": "mesh.ply", "hull_faces": 100, "texels": 64}, content=body).json()
    yield mesh["links"]["self"], Work(idle, mesh["id"])
    http.delete(mesh["links"]["self"])


@pytest.mark.xdist_group("measured mesh")
def test_a_mesh_that_is_not_measured_yet_says_so(http, accepted):  # noqa: F811
    url, work = accepted
    assert http.get(f"{url}/accuracy").status_code == 409
    work.run(*STAGES)
    work.finish()
    answer = http.get(f"{url}/accuracy")
    assert (answer.status_code, answer.json()["code"]) == (409, "not-ready")
    assert "by itself" in answer.json()["detail"]
    assert "accuracy" not in http.get(url).json()["links"]


def test_where_measuring_is_off_that_is_said(client, knot):
    answer = client._http.get(f"/v1/meshes/{knot.id}/accuracy")
    assert answer.status_code == 409
    assert "switched off" in answer.json()["detail"]


@pytest.mark.xdist_group("measured mesh")
def test_a_measured_mesh_tells_its_ladder_and_shows_it(idle, http, accepted):  # noqa: F811
    url, work = accepted
    work.run(*STAGES)
    work.finish()
    work.measure()
    links = http.get(url).json()["links"]
    answer = http.get(links["accuracy"])
    report = AccuracyReport.model_validate_json(answer.content)
    assert (report.mesh, report.name) == (url.rpartition("/")[2], "mesh.ply")
    assert report.rungs and report.pareto.outline and report.pareto.shading
    assert http.get(links["accuracy"], headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
    plot = http.get(f"{links['accuracy']}.svg")
    assert plot.headers["content-type"].startswith("image/svg+xml")
    assert ET.fromstring(plot.content).tag.endswith("svg")
    by_accept = http.get(links["accuracy"], headers={"accept": "image/svg+xml"})
    assert by_accept.content == plot.content
    assert http.get(links["accuracy"], headers={"accept": "text/csv"}).status_code == 406
    refused = http.get(links["accuracy"], params={"device": "abacus"})
    assert (refused.status_code, refused.json()["field"]) == (422, "device")
    with Client(idle.url) as connected:
        assert connected.accuracy(report.mesh).rungs == report.rungs
        assert connected.accuracy_plot(report.mesh) == plot.content


@pytest.mark.xdist_group("measured mesh")
def test_a_measurement_that_failed_says_why(http, accepted):  # noqa: F811
    url, work = accepted
    work.run(*STAGES)
    work.finish()
    problem = {"title": "Preprocessing failed", "status": 422, "detail": "No renderer here.", "code": "stage-failed"}
    work.record(StageRecord(stage="measure", outcome="failed", seconds=0.0, error=problem))
    answer = http.get(f"{url}/accuracy")
    assert answer.status_code == 422 and "No renderer here." in answer.text


def test_a_real_ladder_knows_times_of_this_services_renderer(gpu):
    from service.accuracy.report import accuracy_report
    from tests.service.render.laddered import many_ways

    asset = many_ways()
    todo = steps(1, (64,))
    ladder = put_together(asset, "elsewhere", [measure_step(gpu, asset, step, 1, first=step == todo[0]) for step in todo], 1)
    assert {rung.label for rung in ladder.rungs} <= {key.label for key in asset.rungs.keys}
    report = accuracy_report("0" * 32, "knot", ladder, 64, None, {})
    assert [report.rungs[n].ms for n in report.pareto.outline] == sorted(report.rungs[n].ms for n in report.pareto.outline)


@pytest.mark.xdist_group("measured mesh")
def test_where_other_hulls_failed_that_is_why_nothing_was_measured(http, accepted):  # noqa: F811
    url, work = accepted
    work.run(*STAGES)
    work.finish()
    problem = {"title": "Preprocessing failed", "status": 422, "detail": "No room for hulls.", "code": "stage-failed"}
    work.record(StageRecord(stage="hulls", outcome="failed", seconds=0.0, error=problem))
    work.record(StageRecord(stage="measure", outcome="skipped", seconds=0.0))
    answer = http.get(f"{url}/accuracy")
    assert (answer.status_code, answer.json()["detail"]) == (422, "No room for hulls.")
