"""A service that is told to stop answers what it has begun, within its grace, and takes nothing new."""

import os
import signal
import socket
import threading
import time

import httpx
import pytest

from client import Client
from client.local import LocalService
from client.shapes import write_ply
from tests import meshes, plain_http


def serving(folder, grace_s, workers=1):
    environment = {"SILHOUETTE_STOP_GRACE_S": str(grace_s), "SILHOUETTE_MEASURE": "0", "SILHOUETTE_WARM_KERNELS": "0"}
    return LocalService(folder, environment, ("--workers", str(workers)))


def ready_cube(service, folder):
    write_ply(str(folder / "a.ply"), *meshes.cube(3))
    with Client(service.url, timeout_s=120.0) as client:
        mesh = client.wait(client.upload(folder / "a.ply", hull_faces=40, texels=64).id, timeout_s=200.0)
    plain_http.get(f"{service.url}/v1/meshes/{mesh.id}/render.png?width=64&height=64", timeout=200.0).raise_for_status()
    return mesh.id


@pytest.mark.heavy
def test_a_request_under_way_is_answered_and_a_new_one_is_not_taken(tmp_path):
    with serving(tmp_path, 14.0) as service:
        mesh_id = ready_cube(service, tmp_path)
        answers = []
        address = f"{service.url}/v1/meshes/{mesh_id}/turntable.webp?frames=60&width=400&height=400"
        asking = threading.Thread(target=lambda: answers.append(plain_http.get(address, timeout=60.0)))
        asking.start()
        time.sleep(0.3)
        assert not answers
        os.kill(service.pid, signal.SIGTERM)
        time.sleep(0.3)
        with pytest.raises(httpx.TransportError):
            plain_http.get(f"{service.url}/healthz", timeout=5.0)
        asking.join(60.0)
        assert answers[0].status_code == 200
        assert answers[0].headers["X-Frames"] == "60"
        assert service.stop() == 0, service.last_words()


def test_a_request_that_outlasts_the_grace_does_not_hold_up_the_end(tmp_path):
    with serving(tmp_path, 1.0, workers=0) as service:
        host, port = service.url.removeprefix("http://").split(":")
        with socket.create_connection((host, int(port)), timeout=30.0) as upload:
            upload.sendall(b"POST /v1/meshes?name=a.off HTTP/1.1\r\nHost: here\r\nContent-Length: 1000\r\n\r\nOFF\n")
            time.sleep(0.5)
            asked = time.monotonic()
            assert service.stop() == 0, service.last_words()
            assert time.monotonic() - asked < 10.0
