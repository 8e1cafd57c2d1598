"""A disk that fills up under a running service: uploads are refused, work stops and goes on, nothing is torn."""

import contextlib
import errno
import os
import signal
import time

import pytest

from client import Client
from client.local import LocalService
from client.shapes import write_ply
from tests import plain_http
from tests.disks import mounted
from tests.meshes import bumpy_sphere
from tests.test_pipeline import children_of, command_line

DISK_MIB = 48
ENVIRONMENT = {
    "SILHOUETTE_KEEP_FREE_MIB": "0",
    "SILHOUETTE_WARM_KERNELS": "0",
    "SILHOUETTE_MEASURE": "0",
    "SILHOUETTE_RECONCILE_INTERVAL_S": "1",
}


@pytest.fixture
def disk(tmp_path):
    with mounted(tmp_path / "small", DISK_MIB) as mount:
        yield mount


def fill(disk):
    """Take all room that is left; the file that has it."""
    taken = disk / "taken"
    with taken.open("ab", buffering=0) as file:
        for piece in (1 << 20, 1 << 12):
            try:
                while file.write(bytes(piece)):
                    pass
            except OSError as error:
                assert error.errno == errno.ENOSPC
    return taken


def stored(data_dir):
    files = (path for path in (data_dir / "store").rglob("*") if path.is_file() and not {".locks", "indexed"} & set(path.parts))
    return sorted(str(path.relative_to(data_dir)) for path in files)


def worker_of(service):
    """Process id of its worker, once there is one."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        with contextlib.suppress(FileNotFoundError):  # a child that has just ended
            for pid in children_of(service.pid):
                if command_line(pid).split()[1:] == ["-m", "worker"]:
                    return pid
        time.sleep(0.05)
    raise AssertionError("no worker")


def test_a_full_disk_refuses_uploads_stops_work_and_both_go_on_with_room(disk, tmp_path):
    source = tmp_path / "mesh.ply"
    write_ply(str(source), *bumpy_sphere(2))
    with LocalService(disk / "data", ENVIRONMENT, ("--workers", "1")) as service, Client(service.url, timeout_s=60.0) as client:
        before = stored(service.data_dir)
        taken = fill(disk)
        refused = plain_http.post(f"{service.url}/v1/meshes?name=a.ply", content=source.read_bytes(), timeout=60.0)
        assert refused.status_code == 507 and refused.json()["code"] == "storage-full"
        assert stored(service.data_dir) == before

        taken.unlink()
        worker = worker_of(service)
        os.kill(worker, signal.SIGSTOP)  # so that the disk is full before any of the work is done
        mesh = client.upload(source, hull_faces=40, texels=64)
        taken = fill(disk)
        os.kill(worker, signal.SIGCONT)
        deadline = time.monotonic() + 120.0
        while worker_of(service) == worker:  # it ends once it finds that even the queue takes nothing
            assert time.monotonic() < deadline
            time.sleep(0.1)
        info = client.info(mesh.id)
        assert info.status in ("queued", "processing"), info.error
        taken.unlink()
        ready = client.wait(mesh.id, timeout_s=200.0)
        assert ready.status == "ready" and ready.capabilities["clip"].available
        assert not any("/.tmp/" in name for name in stored(service.data_dir))
