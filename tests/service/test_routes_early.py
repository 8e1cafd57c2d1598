"""Pictures of a mesh before it is ready, and how they give way as its stages end: a service without workers, stages run by the test."""

import io
import logging
import time

import numpy as np
import pytest
from PIL import Image

from backend import records
from backend.local_store import LocalStore
from backend.manifests import NOT_ENDED, build_manifest
from backend.queue import JobQueue
from backend.redis_connection import connect
from client import Client
from client.local import LocalService
from client.shapes import write_ply
from schemas.jobs import LATER_STAGES, STAGES
from schemas.manifest import StageRecord
from service.meshes import RECENT_S
from tests import meshes, plain_http
from tests.ladders import small_ladder
from tests.worker.processing import opened_box
from worker.jobs import run_and_record

REVALIDATE = "no-cache"

pytestmark = pytest.mark.xdist_group("early")


@pytest.fixture(scope="module")
def idle(tmp_path_factory):
    """A service that measures, with no worker."""
    environment = {"SILHOUETTE_MEASURE": "true", "SILHOUETTE_RECONCILE_INTERVAL_S": "3600", "SILHOUETTE_RENDER_TIMEOUT_S": "240"}
    with LocalService(tmp_path_factory.mktemp("idle"), environment, ("--workers", "0")) as running:
        yield running


@pytest.fixture(scope="module")
def http(idle):
    with plain_http.Client(base_url=idle.url, timeout=250.0) as connection:
        yield connection


class Work:
    """What workers would do for one mesh."""

    def __init__(self, idle, mesh_id):
        logging.getLogger("backend.progress").setLevel(logging.ERROR)
        self._queue = JobQueue(connect(f"unix://{idle.data_dir}/of-nobody.sock"), LocalStore(idle.data_dir / "store"), measure=True)
        self._mesh_id = mesh_id

    def run(self, *stages):
        for stage in stages:
            assert run_and_record(self._queue, self._mesh_id, stage).outcome in ("done", "skipped")

    def finish(self):
        done = {stage: records.read_stage(self._queue.store, self._mesh_id, stage) for stage in STAGES}
        with records.publishing(self._queue.store, self._mesh_id):
            records.write_manifest(self._queue.store, build_manifest(self._mesh_id, done))

    def measure(self):
        self.record(StageRecord(stage="measure", outcome="done", seconds=1.0, report=small_ladder().model_dump(mode="json")))

    def record(self, record):
        with records.publishing(self._queue.store, self._mesh_id):
            records.write_stage(self._queue.store, self._mesh_id, record)


@pytest.fixture
def accepted(idle, http, tmp_path):
    """(address, work): a mesh that nothing has been done for."""
    write_ply(str(tmp_path / "mesh.ply"), *meshes.bumpy_sphere(3, 0.3))
    body = (tmp_path / "mesh.ply").read_bytes()
    mesh = http.post("/v1/meshes", params={"name": "mesh.ply", "hull_faces": 100, "texels": 64}, content=body).json()
    yield mesh["links"]["self"], Work(idle, mesh["id"])
    http.delete(mesh["links"]["self"])


def rung(answer):
    assert answer.status_code == 200, answer.text
    return answer.headers["x-accuracy"].split(";")[0]


def alpha(answer):
    assert answer.status_code == 200, answer.text
    return np.asarray(Image.open(io.BytesIO(answer.content)).convert("RGBA"))[..., 3].astype(float)


def test_the_original_is_drawn_until_the_mesh_is_ready_and_then_the_hull(http, accepted):
    url, work = accepted
    assert http.get(f"{url}/render.png").status_code == 409
    assert "render" not in http.get(url).json()["links"]
    work.run("load")
    info = http.get(url).json()
    assert info["status"] == "processing" and info["sphere"]["radius"] > 0.0
    early = http.get(info["links"]["render"], params={"width": 128, "height": 128})
    assert rung(early) == "rung=original/msaa"
    assert "edges" not in early.headers["x-plan"]
    work.run(*[stage for stage in STAGES if stage != "load"])
    assert rung(http.get(f"{url}/render.png")) == "rung=original/msaa", "checked, but not published"
    work.finish()
    ready = http.get(f"{url}/render.png", params={"width": 128, "height": 128})
    assert rung(ready) == "rung=clipped/coverage"
    assert np.abs(alpha(early) - alpha(ready)).mean() < 2.0, "both show the same outline"
    assert http.get(url).json()["links"].keys() > info["links"].keys()


def test_answers_before_the_end_are_asked_for_again_and_never_kept_for_good(http, accepted):
    url, work = accepted
    work.run("load")
    first = {path: http.get(f"{url}/{path}") for path in ("render.png?width=64&height=64", "thumbnail.png?size=64")}
    assert {answer.headers["cache-control"] for answer in first.values()} == {REVALIDATE}
    for path, answer in first.items():
        assert http.get(f"{url}/{path}", headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
    work.run(*[stage for stage in STAGES if stage != "load"])
    work.finish()
    for path, answer in first.items():
        again = http.get(f"{url}/{path}", headers={"If-None-Match": answer.headers["etag"]})
        assert (again.status_code, again.headers["etag"] != answer.headers["etag"]) == (200, True)
    assert "immutable" in again.headers["cache-control"]


@pytest.mark.parametrize("accuracy", [{"source": "clipped"}, {"smooth": True}])
def test_what_needs_the_silhouette_is_not_ready_yet(http, accepted, accuracy):
    url, work = accepted
    work.run("load")
    calls = [("render", {"accuracy": accuracy}), ("silhouette", {})]
    for path, body in calls:
        answer = http.post(f"{url}/{path}", json=body)
        assert (answer.status_code, answer.json()["code"]) == (409, "not-ready"), path
        assert int(answer.headers["retry-after"]) >= 1
    scene = {"objects": [{"mesh": url.rpartition("/")[2]}], "accuracy": accuracy}
    answer = http.post("/v1/scenes/render", json=scene)
    assert (answer.status_code, answer.json()["field"]) == (409, "objects[0].mesh")


def test_a_scene_shows_the_originals_of_meshes_in_work(http, accepted):
    url, work = accepted
    work.run("load")
    scene = {"objects": [{"mesh": url.rpartition("/")[2]}], "width": 96, "height": 96}
    early = http.post("/v1/scenes/render", json=scene)
    assert "original" in early.headers["x-accuracy"] and alpha(early).max() == 255
    work.run(*[stage for stage in STAGES if stage != "load"])
    work.finish()
    ready = http.post("/v1/scenes/render", json=scene, headers={"If-None-Match": early.headers["etag"]})
    assert ready.status_code == 200
    assert "clipped" in ready.headers["x-accuracy"]


def test_an_open_mesh_refuses_clipping_for_good_as_soon_as_it_is_loaded(idle, http):
    mesh = http.post("/v1/meshes", params={"name": "open.ply", "repair": "never"}, content=opened_box()).json()
    Work(idle, mesh["id"]).run("load")
    answer = http.post(f"/v1/meshes/{mesh['id']}/render", json={"accuracy": {"source": "clipped"}})
    assert (answer.status_code, answer.json()["code"]) == (422, "capability-unavailable")
    assert NOT_ENDED not in answer.text
    http.delete(f"/v1/meshes/{mesh['id']}")


def test_later_stages_change_the_tag_and_not_the_status(http, idle, accepted):
    url, work = accepted
    work.run(*STAGES)
    work.finish()
    tags = [http.get(f"{url}/render.png").headers["etag"]]
    with http.stream("GET", f"{url}/events") as stream:
        events = [line for line in stream.iter_lines() if line.startswith("data: ")]
    assert len(events) == 1, "the stream ends with the mesh ready"
    stages = {stage["name"]: stage["status"] for stage in http.get(url).json()["stages"]}
    assert [stages[name] for name in LATER_STAGES] == ["queued", "queued"]
    for step in (lambda: work.run("hulls"), work.measure):
        step()
        time.sleep(RECENT_S)  # so long a look at the mesh may serve
        answer = http.get(f"{url}/render.png")
        assert rung(answer).startswith("rung=clipped/coverage")
        tags.append(answer.headers["etag"])
    assert len(set(tags)) == 3
    with Client(idle.url) as client:
        info = client.info(url.rpartition("/")[2])
    assert info.status == "ready"
    assert [stage.status for stage in info.stages] == ["done"] * len([*STAGES, *LATER_STAGES])


def test_a_mesh_deleted_before_it_is_ready_has_no_pictures_left(http, accepted):
    url, work = accepted
    work.run("load")
    assert http.get(f"{url}/render.png").status_code == 200
    assert http.delete(url).status_code == 204
    assert http.get(f"{url}/render.png").status_code == 404
