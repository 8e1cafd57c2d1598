"""What one mesh takes of the stores and of processes: the inputs of `benchmarks.capacity` that are not throughput.

    python -m benchmarks.footprint MESH [--later] [--json]

A service, a worker and a queue of this machine's own share an S3 server of the tests, behind a proxy that counts. The mesh is uploaded and
made ready; then a service with an empty folder, which has drawn a small mesh already, draws it: the first time, from another side at once,
and once more when it looks again whether the mesh is there; and another process, which finds copies on its disk. Requests and bytes are
exact; processor time has a resolution of 10 ms. With --later what is prepared includes hulls of other sizes and the measuring of accuracy.
Nothing but this machine is asked.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from backend.counts import read_counts
from backend.redis_connection import connect
from benchmarks.counting_proxy import LIST, CountingProxy
from benchmarks.models import mesh_file
from benchmarks.report import markdown_table, mesh_parser, number, report
from benchmarks.service import processor_s, resident_mib
from client.api import Client
from client.local import LocalService
from client.shapes import torus_knot, write_ply
from schemas.jobs import WORKER_MODULE
from service.embedded import EmbeddedBackend
from tests.s3_server import BUCKET, S3Server

Values = dict[str, Any]
TICKS = os.sysconf("SC_CLK_TCK")
QUIET_S = 36_000
"""Between two comparisons of the store with the queue: none while this runs."""

SETTLED_S = 20.0
"""After its start a service compiles and calibrates beside."""
LOOKS_AGAIN_S = 1.3
READS = ("GET", "HEAD", LIST)
PICTURES = 12
SIDE_PX = 256


@dataclass(frozen=True)
class Stores:
    """What processes share. environment: theirs. last: the stage that a mesh ends with."""

    folder: Path
    proxy: CountingProxy
    redis: Any
    environment: dict[str, str]
    last: str

    def taken(self) -> Values:
        """Requests to the store by method, and commands to Redis, since the last call."""
        stats = self.redis.info("commandstats")
        self.redis.config_resetstat()
        return {"store": dict(self.proxy.taken()), "redis": sum(one["calls"] for one in stats.values())}


@contextmanager
def stores(later: bool) -> Iterator[Stores]:
    """A queue server and an S3 server. later: whether meshes go on once they are ready."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        queue = EmbeddedBackend(folder / "queue", worker_count=0)
        queue.start()
        stack.callback(queue.stop)
        server = stack.enter_context(S3Server())
        proxy = stack.enter_context(CountingProxy(server.endpoint))
        environment = {
            **server.settings,
            "SILHOUETTE_STORE_ENDPOINT": proxy.url,
            "SILHOUETTE_REDIS_URL": queue.redis_url,
            "SILHOUETTE_MEASURE": str(later).lower(),
            "SILHOUETTE_WARM_KERNELS": "false",
            "SILHOUETTE_RECONCILE_INTERVAL_S": str(QUIET_S),
        }
        yield Stores(folder, proxy, connect(queue.redis_url), environment, "measure" if later else "verify")


@contextmanager
def worker(shared: Stores) -> Iterator[int]:
    """A worker; its process id."""
    environment = {**os.environ, **shared.environment, "SILHOUETTE_DATA_DIR": str(shared.folder / "worker")}
    with (shared.folder / "worker.log").open("wb") as log:
        process = subprocess.Popen([sys.executable, "-m", WORKER_MODULE], env=environment, stderr=log)
    try:
        yield process.pid
    finally:
        process.kill()
        process.wait()


def family_s(pid: int) -> float:
    """Processor time of a process and of its children that have ended, seconds."""
    told = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, told[11:15])) / TICKS


def wait_for(shared: Stores, count: int) -> None:
    """Until so many meshes have ended; Redis says it without asking the store."""
    while sum(times for (stage, _), times in read_counts(shared.redis).ended.items() if stage == shared.last) < count:
        time.sleep(LOOKS_AGAIN_S)
    time.sleep(LOOKS_AGAIN_S)


def prepared(shared: Stores, mesh: Path) -> tuple[str, str, Values]:
    """(id of a small mesh, id, what it took) of a mesh that is made ready."""
    small = shared.folder / "small.ply"
    write_ply(str(small), *torus_knot(160, 16))
    with worker(shared) as pid, LocalService(shared.folder / "first", shared.environment) as service, Client(service.url) as client:
        first = client.wait(client.upload(small).id).id
        wait_for(shared, 1)
        time.sleep(SETTLED_S)
        shared.taken()
        before = family_s(pid)
        found = client.upload(mesh)
        wait_for(shared, 2)
        taken, spent = shared.taken(), family_s(pid) - before
        reads = sum(taken["store"].get(name, 0) for name in READS)
        info = client.info(found.id)
        assert info.stats is not None
        return (
            first,
            found.id,
            {
                "faces": info.stats.faces,
                "upload_bytes": mesh.stat().st_size,
                "prepare_core_s": round(spent, 2),
                "prepare_reads": reads,
                "prepare_writes": sum(taken["store"].values()) - reads,
                "prepare_redis": taken["redis"],
            },
        )


def stored(shared: Stores, mesh_id: str) -> Values:
    """Bytes and objects of a mesh in the store; of bytes its upload apart."""
    from backend.s3_client import S3Client, S3Place

    os.environ.update({name: value for name, value in shared.environment.items() if name.startswith("AWS_")})
    place = S3Place(BUCKET, f"of/tests/meshes/{mesh_id}", shared.environment["SILHOUETTE_STORE_ENDPOINT"])
    found = [*S3Client(place).list("")]
    return {"stored_bytes": sum(one.size for one in found), "stored_objects": len(found) + 1}


class Drawn:
    """A service process that has drawn a small mesh. empty_mib: its memory then."""

    def __init__(self, shared: Stores, service: LocalService, small: str) -> None:
        self._shared, self._pid, self._url = shared, service.pid, service.url
        time.sleep(SETTLED_S)
        self.picture(small, 10)
        self.empty_mib = resident_mib(self._pid)

    def picture(self, mesh_id: str, azimuth: int) -> Values:
        """Draw a view: bytes of the answer, processor time, requests to the store."""
        before, _ = processor_s(self._pid), self._shared.taken()
        address = f"{self._url}/v1/meshes/{mesh_id}/render.png?width={SIDE_PX}&height={SIDE_PX}&source=clipped&azimuth={azimuth}"
        answer = httpx.get(address, timeout=600.0).raise_for_status()
        spent = processor_s(self._pid) - before
        return {"bytes": len(answer.content), "core_s": round(spent, 2), "store": self._shared.taken()["store"]}

    def mapped_mib(self) -> float:
        """Mesh data that it has mapped."""
        told = re.search(r'silhouette_cache_bytes\{cache="assets"\} (\S+)', httpx.get(f"{self._url}/metrics").text)
        assert told is not None
        return float(told[1]) / 2**20

    def now_mib(self) -> float:
        """Its memory."""
        return resident_mib(self._pid)


def served(shared: Stores, small: str, mesh_id: str) -> Values:
    """What pictures of it take of a process that has nothing of it, of its memory too."""
    with LocalService(shared.folder / "second", shared.environment) as service:
        process = Drawn(shared, service, small)
        mapped = process.mapped_mib()
        first, second = process.picture(mesh_id, 1), process.picture(mesh_id, 50)
        time.sleep(LOOKS_AGAIN_S)
        look = process.picture(mesh_id, 77)
        sizes = [process.picture(mesh_id, azimuth)["bytes"] for azimuth in range(0, 30 * PICTURES, 30)]
        return {
            "first": first,
            "second": second,
            "look": look,
            "picture_bytes": round(sum(sizes) / len(sizes)),
            "mapped_mib": round(process.mapped_mib() - mapped, 2),
            "empty_process_mib": process.empty_mib,
            "process_with_it_mib": process.now_mib(),
        }


def again(shared: Stores, small: str, mesh_id: str) -> Values:
    """What the first picture takes of a process that finds copies of the mesh on its disk."""
    with LocalService(shared.folder / "second", shared.environment) as service:
        return Drawn(shared, service, small).picture(mesh_id, 1)


def run(given: argparse.Namespace) -> Values:
    with mesh_file(given.mesh) as path, stores(given.later) as shared:
        small, mesh_id, taken = prepared(shared, path)
        result = {"mesh": Path(given.mesh).name, **taken, **stored(shared, mesh_id), **served(shared, small, mesh_id)}
        return result | {"with_copies": again(shared, small, mesh_id)}


def print_table(result: Values) -> None:
    told = [[name, _said(value)] for name, value in result.items()]
    print(markdown_table(["what", "is"], told))


def _said(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_said(part)}" for name, part in value.items())
    return value if isinstance(value, str) else number(value)


def main() -> None:
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--later", action="store_true", help="with what is made of a mesh that is ready")
    given = parser.parse_args()
    report(lambda: run(given), given.json, print_table)


if __name__ == "__main__":
    main()
