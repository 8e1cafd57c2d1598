"""A disk that fills up under a running service: uploads are refused, work stops and goes on, nothing is torn."""

import errno
import time

import httpx
import pytest

from client import Client
from client.local import LocalService
from client.shapes import write_ply
from tests.disks import mounted
from tests.meshes import bumpy_sphere

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


def test_a_full_disk_refuses_uploads_stops_work_and_both_go_on_with_room(disk, tmp_path):
    source = tmp_path / "mesh.ply"
    write_ply(str(source), *bumpy_sphere(5))
    with LocalService(disk / "data", ENVIRONMENT, ("--workers", "1")) as service, Client(service.url, timeout_s=60.0) as client:
        before = stored(service.data_dir)
        taken = fill(disk)
        refused = httpx.post(f"{service.url}/v1/meshes?name=a.ply", content=source.read_bytes(), timeout=60.0)
        assert refused.status_code == 507 and refused.json()["code"] == "storage-full"
        assert stored(service.data_dir) == before

        taken.unlink()
        mesh = client.upload(source, hull_faces=100, texels=64)
        taken = fill(disk)
        time.sleep(3.0)
        info = client.info(mesh.id)
        assert info.status != "failed", info.error
        taken.unlink()
        ready = client.wait(mesh.id, timeout_s=200.0)
        assert ready.status == "ready" and ready.capabilities["clip"].available
        assert not any("/.tmp/" in name for name in stored(service.data_dir))
