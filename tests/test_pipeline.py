"""The main job end to end: real HTTP, real queue, a real worker process, real EGL; what is drawn is looked at."""

import contextlib
import io
import json
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image

from client import Client
from client.local import LocalService, LocalServiceError
from client.shapes import write_ply
from schemas.jobs import STAGES
from tests import meshes, plain_http
from tests.client.command import silhouette_process
from tests.meshes import shared


def rgba(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGBA"))


def children_of(pid: int) -> list[int]:
    """Process ids of the direct children, by the kernel's account."""
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for task in tasks for child in task.read_text().split()]


def command_line(pid: int) -> str:
    return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()


def gone(pids: list[int], seconds: float = 10.0) -> bool:
    deadline = time.monotonic() + seconds
    while any(Path(f"/proc/{pid}").exists() for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.05)
    return not any(Path(f"/proc/{pid}").exists() for pid in pids)


def test_mesh_goes_from_bytes_to_pictures_and_edges(client, knot):
    assert knot.status == "ready"
    assert [(stage.name, stage.status) for stage in knot.stages] == [(n, "done") for n in STAGES]
    assert all(stage.seconds is not None and stage.seconds >= 0.0 for stage in knot.stages)
    assert knot.stats is not None and knot.hull is not None and knot.sphere is not None
    assert (knot.stats.vertices, knot.stats.faces, knot.stats.edges, knot.stats.closed) == (2560, 5120, 7680, True)
    assert 4 <= knot.hull.faces <= 200
    assert knot.hull.volume_excess > 0.0
    assert np.allclose(knot.sphere.centre, np.mean(knot.stats.bounds, axis=0), atol=1e-6)


@pytest.mark.parametrize("azimuth_deg", [0, 77, 180, 290])
def test_clipped_and_original_agree_from_every_side(client, knot, azimuth_deg):
    camera = {"orbit": {"azimuth_deg": azimuth_deg, "elevation_deg": azimuth_deg / 5 - 30}}
    view = {"camera": camera, "width": 256, "height": 256}
    clipped = rgba(client.render(knot.id, **view, accuracy={"source": "clipped", "antialias": "coverage"}))[..., 3].astype(float)
    original = rgba(client.render(knot.id, **view, accuracy={"source": "original", "antialias": "ssaa"}))[..., 3].astype(float)
    assert original.max() == 255 and 0.1 < (original > 0).mean() < 0.7
    partly = ((clipped > 0) & (clipped < 255)) | ((original > 0) & (original < 255))
    assert np.abs(clipped - original)[partly].mean() < 15.0
    assert np.abs(clipped - original)[~partly].max(initial=0.0) == 0.0


def test_silhouette_and_picture_tell_the_same_outline(client, knot):
    camera = {"orbit": {"azimuth_deg": 50, "elevation_deg": 10}}
    silhouette = client.silhouette(knot.id, camera=camera, project={"width": 256, "height": 256})
    alpha = rgba(client.render(knot.id, camera=camera, width=256, height=256))[..., 3]
    pixel = np.array(silhouette["vertices"]["pixel"])
    rows, columns = np.nonzero(alpha)
    assert np.allclose([columns.min(), rows.min()], pixel.min(axis=0), atol=1.01)
    assert np.allclose([columns.max() + 1, rows.max() + 1], pixel.max(axis=0), atol=1.01)


def test_many_clients_at_once_get_the_same_picture_or_are_told_to_come_back(service, knot):
    url = f"{service.url}/v1/meshes/{knot.id}/render.png?width=400&height=400&source=original&antialias=ssaa"

    def get(_):
        return plain_http.get(url, timeout=120.0)

    with ThreadPoolExecutor(24) as pool:
        answers = list(pool.map(get, range(48)))
    assert {answer.status_code for answer in answers} <= {200, 503}
    good = [answer.content for answer in answers if answer.status_code == 200]
    assert good and len(set(good)) == 1
    assert all(int(answer.headers["retry-after"]) >= 1 for answer in answers if answer.status_code == 503)
    assert plain_http.get(f"{service.url}/readyz").json()["status"] == "ready"


def test_clients_that_leave_do_not_block_the_others(service, knot):
    url = f"{service.url}/v1/meshes/{knot.id}/render.png?width=2000&height=2000&source=original&antialias=ssaa"
    left = 0
    for _ in range(12):  # a full service may still answer 503 in time
        with contextlib.suppress(httpx.TimeoutException):
            assert plain_http.get(url, timeout=0.02).status_code == 503
            continue
        left += 1
    assert left
    began = time.monotonic()
    while (answer := plain_http.get(f"{service.url}/v1/meshes/{knot.id}/render.png?width=64&height=64", timeout=60.0)).status_code == 503:
        assert time.monotonic() - began < 30.0
        time.sleep(0.1)
    assert answer.status_code == 200


def test_health_says_what_is_well(service):
    assert plain_http.get(f"{service.url}/healthz").json() == {"status": "ok"}
    ready = plain_http.get(f"{service.url}/readyz")
    assert (ready.status_code, ready.json()["checks"]) == (200, {"queue": "ok", "store": "ok", "renderer": "ok"})


def test_page_needs_nothing_from_elsewhere(service):
    for path in ("/", "/docs"):
        page = plain_http.get(service.url + path)
        assert page.headers["content-type"].startswith("text/html")
        parts = [part.split('"')[0] for word in ('src="', 'href="') for part in page.text.split(word)[1:]]
        for part in parts:
            assert part.startswith("/") or part == "#", part
            if part.startswith("/"):
                assert plain_http.get(service.url + part).status_code == 200, part
    assert "http" not in plain_http.get(f"{service.url}/page/app.js").text.replace("XMLHttpRequest", "")
    assert plain_http.get(f"{service.url}/page/..%2fapp.py").status_code == 404


def test_openapi_describes_every_query_parameter(service):
    api = plain_http.get(f"{service.url}/openapi.json").json()
    parameters = api["paths"]["/v1/meshes/{mesh_id}/render.{suffix}"]["get"]["parameters"]
    assert all(one.get("description") for one in parameters if one["in"] == "query")
    assert {"azimuth", "eye", "width", "antialias"} <= {one["name"] for one in parameters}


def test_meshes_outlive_a_crash_and_a_stop_and_no_child_outlives_its_service(tmp_path):
    path, data = tmp_path / "cube.ply", tmp_path / "data"
    write_ply(str(path), *meshes.cube())
    with LocalService(data, arguments=("--workers", "0")) as service, Client(service.url) as client:
        accepted = client.upload(path, hull_faces=12, texels=64)
        children = children_of(service.pid)
        os.kill(service.pid, signal.SIGKILL)
        assert gone(children)
    with LocalService(data, arguments=("--workers", "1")) as service, Client(service.url) as client:
        children = children_of(service.pid)
        assert any("worker" in command_line(child) for child in children)
        assert client.wait(accepted.id, timeout_s=200.0).status == "ready", "accepted before the crash, made after it"
        began = time.monotonic()
        assert service.stop() == 0
        assert time.monotonic() - began < 8.0
        assert gone(children)
    with LocalService(data, arguments=("--workers", "1")) as service, Client(service.url) as client:
        assert client.info(accepted.id).status == "ready"
        assert rgba(client.render(accepted.id, width=64, height=64))[..., 3].max() == 255
        children = [service.pid, *children_of(service.pid)]
        service._process.stdin.close()  # what the kernel does when the process that started it is killed
        service._process.wait(15.0)
        assert gone(children)


def test_port_in_use_is_a_sentence(service, tmp_path):
    port = service.url.rsplit(":", 1)[1]
    with pytest.raises(LocalServiceError, match="cannot listen"), LocalService(tmp_path, arguments=("--port", port)):
        pass


def test_wrong_setting_is_a_sentence(tmp_path):
    with pytest.raises(LocalServiceError, match="max_upload_mib"), LocalService(tmp_path, {"SILHOUETTE_MAX_UPLOAD_MIB": "lots"}):
        pass


def test_demo_writes_its_pictures_and_leaves_nothing(tmp_path, monkeypatch):
    write_ply(str(tmp_path / "small ball.ply"), *meshes.bumpy_sphere(3))
    monkeypatch.setenv("SILHOUETTE_WORKERS", "1")
    out = tmp_path / "out"
    run = silhouette_process("demo", tmp_path / "small ball.ply", "--out", out)
    assert run.returncode == 0, run.stderr
    with Image.open(out / "small ball.png") as image:
        assert (image.size, image.mode) == ((512, 512), "RGBA")
        assert image.getchannel("A").getextrema() == (0, 255)
    assert json.loads((out / "small ball.json").read_text())["edge_count"] > 10
    assert "<svg" in (out / "small ball.svg").read_text()[:300]
    for word in ("load", "hull", "bake", "tree", "MSAA", "clipped", "silhouette edges"):
        assert word.encode() in run.stdout


@pytest.mark.heavy
def test_bunny_goes_all_the_way(client):
    path = shared("bunny_closed.ply")
    mesh = client.wait(client.upload(path, texels=256).id, timeout_s=280.0)
    assert mesh.capabilities["clip"].available
    assert mesh.hull is not None and mesh.hull.faces <= 1000
    alpha = rgba(client.thumbnail(mesh.id))[..., 3]
    assert 0.2 < (alpha > 0).mean() < 0.8
