"""Several machines on one: services and workers with data folders of their own, one queue, one S3 store between them."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx
import pytest

from backend.redis_connection import connect
from client import Client
from client.local import LocalService
from client.shapes import write_ply
from schemas.jobs import READER_FLAG, STAGES, WORKER_MODULE
from service.access.keys import REMEMBERED_S
from service.embedded import EmbeddedBackend
from tests import meshes
from tests.s3_server import S3Server

VIEW = {"camera": {"orbit": {"azimuth_deg": 30, "elevation_deg": 20}}, "width": 128, "height": 128}
SEEN_S = 2.0  # a replica looks again a second after it has seen that a mesh is ready
KILL_AFTER_S, SOAK_MESHES = 1.5, 4
AWAY_S = 8.0  # longer than a request is tried


pytestmark = pytest.mark.xdist_group("machines")


class Deployment:
    """What runs: a queue server, an S3 server, and machines that are started one by one."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder, self._stack = folder, stack
        queue = EmbeddedBackend(folder / "queue", worker_count=0)
        queue.start()
        stack.callback(queue.stop)
        self.s3 = stack.enter_context(S3Server())
        self.environment = {
            **self.s3.settings,
            "SILHOUETTE_REDIS_URL": queue.redis_url,
            "SILHOUETTE_MEASURE": "false",
            "SILHOUETTE_WARM_KERNELS": "false",
            "SILHOUETTE_RECONCILE_INTERVAL_S": "2",
            "SILHOUETTE_RENDER_TIMEOUT_S": "200",
        }
        self.redis = connect(queue.redis_url)

    def service(self, name: str) -> LocalService:
        """A service on a machine of its own."""
        return self._stack.enter_context(LocalService(self.folder / name, self.environment))

    def worker(self, name: str, *flags: str) -> subprocess.Popen[bytes]:
        """A worker on a machine of its own."""
        environment = {**os.environ, **self.environment, "SILHOUETTE_DATA_DIR": str(self.folder / name)}
        with (self.folder / f"{name}.log").open("wb") as log:
            process = subprocess.Popen([sys.executable, "-m", WORKER_MODULE, *flags], env=environment, stderr=log)
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        return process

    def log_of(self, name: str) -> str:
        """What a worker or service has logged."""
        path = self.folder / f"{name}.log"
        return (path if path.exists() else self.folder / name / "service.log").read_text()


@contextmanager
def deployed(folder: Path) -> Iterator[Deployment]:
    with ExitStack() as stack:
        yield Deployment(folder, stack)


@pytest.fixture(scope="module")
def machines(tmp_path_factory):
    """Two services, two workers, a reader."""
    pytest.importorskip("moto.server", reason="moto, flask or flask-cors is not installed")
    with deployed(tmp_path_factory.mktemp("machines")) as running:
        running.victim, _ = (running.worker(name) for name in ("worker-1", "worker-2"))
        running.worker("reader", READER_FLAG)
        running.a, running.b = running.service("a"), running.service("b")
        yield running


@pytest.fixture
def a(machines):
    with Client(machines.a.url, timeout_s=240.0) as client:
        yield client


@pytest.fixture
def b(machines):
    with Client(machines.b.url, timeout_s=240.0) as client:
        yield client


def test_a_mesh_that_one_service_took_is_drawn_by_another_and_gone_from_both(machines, a, b, knot_file):
    accepted = a.upload(knot_file, hull_faces=200, texels=128)
    ready = b.wait(accepted.id, timeout_s=200.0)
    assert [(stage.name, stage.status) for stage in ready.stages] == [(name, "done") for name in STAGES]
    assert b.upload(knot_file, hull_faces=200, texels=128).id == accepted.id
    for accuracy in ({"source": "clipped"}, {"source": "original", "antialias": "ssaa"}):
        assert a.render(accepted.id, **VIEW, accuracy=accuracy) == b.render(accepted.id, **VIEW, accuracy=accuracy)
    assert a.silhouette(accepted.id, camera=VIEW["camera"]) == b.silhouette(accepted.id, camera=VIEW["camera"])
    hulls = [httpx.get(f"{service.url}/v1/meshes/{accepted.id}/artifacts/hull.glb") for service in (machines.a, machines.b)]
    assert hulls[0].content == hulls[1].content and hulls[0].content.startswith(b"glTF")
    assert not (machines.a.data_dir / "store").exists()
    a.delete(accepted.id)
    time.sleep(SEEN_S)
    for service in (machines.a, machines.b):
        listed = httpx.get(f"{service.url}/v1/meshes").json()["meshes"]
        assert accepted.id not in [mesh["id"] for mesh in listed]
        for path in ("", "/render.png", "/artifacts/hull.glb"):
            assert httpx.get(f"{service.url}/v1/meshes/{accepted.id}{path}").status_code == 404


def test_a_mesh_that_is_not_kept_is_read_by_a_worker_elsewhere(machines, knot_file):
    for service in (machines.a, machines.b):
        answer = httpx.post(f"{service.url}/v1/render?name=knot.ply&width=64&height=64", content=knot_file.read_bytes(), timeout=60.0)
        assert answer.status_code == 200, answer.text
        assert answer.content.startswith(b"\x89PNG")
    assert httpx.get(f"{machines.a.url}/readyz").json()["checks"]["store"] == "ok"


def keys_command(machines, *arguments, given=""):
    command = [sys.executable, "-m", "service.access", "--data-dir", str(machines.folder / "desk"), *arguments]
    run = subprocess.run(command, env={**os.environ, **machines.environment}, input=given, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_a_key_that_was_made_elsewhere_is_asked_for_by_every_service_until_it_is_revoked(machines):
    made = json.loads(keys_command(machines, "add", given='{"name": "of tests", "scopes": ["read"]}'))
    urls = [f"{service.url}/v1/meshes" for service in (machines.a, machines.b)]
    try:
        time.sleep(REMEMBERED_S + 0.5)
        assert [httpx.get(url).status_code for url in urls] == [401, 401]
        assert [httpx.get(url, headers={"X-API-Key": made["token"]}).status_code for url in urls] == [200, 200]
    finally:
        keys_command(machines, "revoke", made["id"])
    time.sleep(REMEMBERED_S + 0.5)
    assert [httpx.get(url).status_code for url in urls] == [200, 200]


def test_a_store_that_is_away_is_503_with_when_to_come_back_and_loses_nothing(machines, a, tmp_path):
    path = tmp_path / "cube.ply"
    write_ply(str(path), *meshes.cube(4))
    machines.s3.pause()
    try:
        answer = httpx.post(f"{machines.a.url}/v1/meshes?name=cube.ply", content=path.read_bytes(), timeout=60.0)
        assert answer.status_code == 503 and answer.json()["code"] == "store-unavailable"
        assert int(answer.headers["Retry-After"]) >= 1
        ready = httpx.get(f"{machines.b.url}/readyz", timeout=60.0)
        assert ready.status_code == 503 and "does not answer" in ready.json()["checks"]["store"]
        assert httpx.get(f"{machines.b.url}/healthz").status_code == 200
    finally:
        machines.s3.resume()
    accepted = a.upload(path, hull_faces=12, texels=64)
    assert a.wait(accepted.id, timeout_s=120.0).status == "ready"
    a.delete(accepted.id)


def offer(urls: list[str], path: Path, accepted: list[str], stop: threading.Event) -> None:
    """Upload to the services in turn until one has taken it."""
    for url in urls * 20:
        if stop.is_set():
            return
        with contextlib.suppress(httpx.HTTPError):
            answer = httpx.post(f"{url}/v1/meshes?name={path.name}&hull_faces=12&texels=64", content=path.read_bytes(), timeout=60.0)
            if answer.status_code in (200, 202):
                accepted.append(answer.json()["id"])
                return
        time.sleep(0.3)


def statuses(url: str, ids: list[str]) -> dict[str, str]:
    return {mesh_id: httpx.get(f"{url}/v1/meshes/{mesh_id}", timeout=60.0).json()["status"] for mesh_id in ids}


def test_a_store_that_goes_away_while_a_mesh_is_processed_fails_no_mesh(machines, a, tmp_path):
    accepted = []
    for number in range(2):
        path = tmp_path / f"block {number}.ply"
        vertices, faces = meshes.cube(3)
        write_ply(str(path), vertices * [1.0, 2.0, 3.0 + number], faces)
        accepted.append(a.upload(path, hull_faces=12, texels=64).id)
    resumed = threading.Timer(AWAY_S, machines.s3.resume)
    resumed.start()
    with httpx.stream("GET", f"{machines.b.url}/v1/meshes/{accepted[-1]}/events", timeout=120.0) as events:
        machines.s3.pause()
        told = [json.loads(line.removeprefix("data: "))["status"] for line in events.iter_lines() if line.startswith("data: ")]
    resumed.join()
    assert told[-1] == "ready"  # the stream waited for the store
    assert [a.wait(mesh_id, timeout_s=120.0).status for mesh_id in accepted] == ["ready"] * 2


@pytest.mark.heavy
def test_a_service_and_a_worker_killed_under_load_lose_nothing(machines, tmp_path):
    """The last test: what it kills stays dead."""
    paths = [tmp_path / f"box {number}.ply" for number in range(SOAK_MESHES)]
    for number, path in enumerate(paths):
        vertices, faces = meshes.cube(2)
        write_ply(str(path), vertices * [1.0, 1.0, 1.0 + number], faces)
    accepted: list[str] = []
    stop = threading.Event()
    clients = [
        threading.Thread(target=offer, args=([machines.a.url, machines.b.url][:: (-1) ** i], p, accepted, stop))
        for i, p in enumerate(paths)
    ]
    [client.start() for client in clients]
    time.sleep(KILL_AFTER_S)
    os.kill(machines.a.pid, signal.SIGKILL)
    machines.victim.kill()
    machines.redis.flushall()  # and the queue forgets everything
    [client.join(120.0) for client in clients]
    stop.set()
    assert len(accepted) == len(set(accepted)) == SOAK_MESHES
    deadline = time.monotonic() + 200.0
    while set(statuses(machines.b.url, accepted).values()) != {"ready"} and time.monotonic() < deadline:
        time.sleep(0.5)
    assert set(statuses(machines.b.url, accepted).values()) == {"ready"}
