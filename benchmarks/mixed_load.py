"""What a service does under mixed load for minutes: whether it answers everything, whether it grows, how long a kept thumbnail takes.

    python -m benchmarks.mixed_load [MESH ...] [--minutes 10] [--clients 32] [--json]

A service of its own is started on a free port of this machine, with a private queue, a worker a processor and small caches; nothing else is
put under load, and it stops by itself. Two of the clients (--uploaders) upload ever new meshes, wait until each is ready, look at it, and
delete every second one; the others ask for what `benchmarks.mixed_requests` lists. First all of them ask again as soon as they are
answered, for a quarter of the time: until the caches are full, and then to find how many requests a second are too many. Then come half as
many a second at even distances for all of the time; latency counts from when each was due, and growth is that of the second half of it.
Nothing has grown whose slope's bounds (19 times of 20) include none, or that comes to less than 8 MiB, open files or threads in the whole
time.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import threading
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from benchmarks.faults import children_of, command_of
from benchmarks.growth import Sample, Watch, files_under, memory_mib, open_files, slope_of, threads
from benchmarks.http_load import Answers, closed_loop, open_loop
from benchmarks.machine import machine
from benchmarks.mixed_requests import THUMBNAIL, Known, mixed, thumbnail_paths
from benchmarks.models import MESH_HELP, mesh_file
from benchmarks.report import markdown_table, number, report
from client import Client
from client.errors import ServiceError
from client.local import LocalService
from client.shapes import three_holed_torus, torus_knot, write_ply

WARM_PART, SATURATED_PART = 0.1, 0.15
BAR_P99_MS, BAR_GROWTH = 60.0, 8.0
"""The second: MiB, open files or threads that may come in the whole time."""
ENVIRONMENT = {
    "SILHOUETTE_LOG_LEVEL": "WARNING",
    "SILHOUETTE_PICTURE_CACHE_MIB": "12",
    "SILHOUETTE_ASSET_CACHE_MIB": "24",
    "SILHOUETTE_GPU_CACHE_MIB": "16",
}
"""Caches so small that they are full when growth begins to count."""
QUEUE_WAIT_S = 120.0
LOOKS = 60
"""At what there is, at least."""


@dataclass
class Uploads:
    """What the clients that upload have done. seconds: from upload to ready. faults: what went wrong."""

    seconds: list[float] = field(default_factory=list)
    deleted: int = 0
    faults: list[str] = field(default_factory=list)


class Uploader(threading.Thread):
    """A client that uploads until it is told to stop, at most one mesh every `pace_s` seconds."""

    def __init__(self, url: str, folder: Path, seed: int, done: Uploads, pace_s: float, texels: int) -> None:
        super().__init__(daemon=True)
        self._url, self._path, self._done, self._pace_s = url, folder / f"{seed}.ply", done, pace_s
        self._texels = texels
        self._chance, self._stop_asked = np.random.default_rng([seed, time.monotonic_ns()]), threading.Event()

    def stop(self) -> None:
        """End after the mesh under way."""
        self._stop_asked.set()

    def run(self) -> None:
        """One mesh after the other."""
        number = 0
        with Client(self._url, timeout_s=120.0) as client:
            while not self._stop_asked.is_set():
                start = time.monotonic()
                try:
                    self._one(client, delete=number % 2 == 0)
                except (ServiceError, TimeoutError) as error:
                    self._done.faults.append(repr(error))
                number += 1
                self._stop_asked.wait(max(0.0, start + self._pace_s - time.monotonic()))

    def _one(self, client: Client, *, delete: bool) -> None:
        write_ply(str(self._path), *new_shape(self._chance))
        start = time.monotonic()
        mesh = client.upload(self._path, texels=self._texels).id
        if delete and self._chance.random() < 0.25:  # while it is in work
            client.delete(mesh)
            self._done.deleted += 1
            return
        client.wait(mesh, timeout_s=300.0)
        self._done.seconds.append(time.monotonic() - start)
        client.thumbnail(mesh)
        client.render(mesh, width=256, height=256)
        if delete:
            client.delete(mesh)
            self._done.deleted += 1


def new_shape(chance: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A knot that nobody has uploaded yet, of 1,600 to 14,400 faces."""
    vertices, faces = torus_knot(int(chance.integers(100, 300)), int(chance.integers(8, 24)), *((2, 3), (3, 2), (2, 5))[chance.integers(3)])
    return vertices * chance.uniform(0.5, 2.0, 3), faces


def base_meshes(names: list[str], folder: Path) -> list[Path]:
    """Files of the meshes that stay: those named, or a few of our own."""
    if not names:
        own = {"knot": torus_knot(400, 24), "holes": three_holed_torus(4), "small": torus_knot(120, 16, 3, 2)}
        for name, mesh in own.items():
            write_ply(str(folder / f"{name}.ply"), *mesh)
        return [folder / f"{name}.ply" for name in own]
    paths = []
    for name in names:
        with mesh_file(name) as path:
            paths.append(folder / path.name)
            paths[-1].write_bytes(path.read_bytes())
    return paths


def prepared(url: str, names: list[str], folder: Path, texels: int) -> Known:
    """The meshes that stay, ready, their thumbnails drawn once."""
    with Client(url, timeout_s=120.0) as client:
        meshes = [client.wait(client.upload(path, texels=texels).id).id for path in base_meshes(names, folder)]
    tags = {path: httpx.get(url + path, timeout=60.0).headers["ETag"] for path in thumbnail_paths(meshes)}
    once = folder / "once.ply"
    write_ply(str(once), *torus_knot(60, 8))
    return Known(meshes, tags, once.read_bytes())


def look_at(service: LocalService) -> Sample:
    """What there is of the service now: memory, open files and threads of its process, its server, reader and workers, and its files."""
    seen: Sample = {"temporary files": files_under(service.data_dir / "store" / ".tmp"), "shm files": files_under(Path("/dev/shm"))}
    seen["queue files MiB"] = sum(file.stat().st_size for file in (service.data_dir / "redis").rglob("*") if file.is_file()) / 2**20
    counts: Counter[str] = Counter()
    for pid in (service.pid, *children_of(service.pid)):
        name = _name_of(pid, service.pid)
        counts[name] += 1
        name = f"{name} {counts[name]}" if name == "worker" else name
        resident, own = memory_mib(pid)
        seen |= {f"{name} RSS MiB": resident, f"{name} own MiB": own}
        seen |= {f"{name} files": open_files(pid), f"{name} threads": threads(pid)}
    seen["all RSS MiB"] = sum(value for key, value in seen.items() if key.endswith("RSS MiB"))
    return seen


def _name_of(pid: int, service: int) -> str:
    command = command_of(pid)
    if pid == service:
        return "service"
    if "valkey" in command or "redis-server" in command:
        return "queue server"
    return "reader" if "--reader" in command else "worker"


def load(service: LocalService, known: Known, folder: Path, given: argparse.Namespace) -> dict[str, Any]:
    """The phases, one after the other."""
    seconds, clients = given.minutes * 60.0, max(1, given.clients - given.uploaders)
    requests, closed, opened = mixed(known, given.seed), Uploads(), Uploads()
    with Uploading(service, folder, closed, 0.0, given):
        warm = closed_loop(service.url, requests, clients, WARM_PART * seconds)
        saturated = closed_loop(service.url, requests, clients, SATURATED_PART * seconds)
    pace_s = 2.0 * float(np.mean(closed.seconds)) if closed.seconds else 10.0
    rate = 0.5 * saturated.asked_per_second
    with (
        Watch(lambda: look_at(service), min(1.0, seconds / LOOKS)) as watch,
        Uploading(service, folder, opened, pace_s, given),
    ):
        before = caches(service.url)
        start = time.perf_counter()
        half = open_loop(service.url, requests, rate, seconds, clients)
        after = caches(service.url)
    return {
        "asked_per_second": round(rate, 1),
        "warm": told(warm),
        "saturated": told(saturated),
        "half": told(half),
        "uploads": {"saturated": _uploads_told(closed), "half": _uploads_told(opened)},
        "growth": growth(watch, start, seconds),
        "cache_mib": {name: [round(before.get(name, 0.0), 1), round(value, 1)] for name, value in after.items()},
    }


class Uploading:
    """The clients that upload, while the block runs."""

    def __init__(self, service: LocalService, folder: Path, done: Uploads, pace_s: float, given: argparse.Namespace) -> None:
        self._threads = [Uploader(service.url, folder, number, done, pace_s, given.texels) for number in range(given.uploaders)]

    def __enter__(self) -> None:
        for thread in self._threads:
            thread.start()

    def __exit__(self, *_: object) -> None:
        for thread in self._threads:
            thread.stop()
        for thread in self._threads:
            thread.join()


def caches(url: str) -> dict[str, float]:
    """MiB that each cache holds, as the service says."""
    lines = httpx.get(f"{url}/metrics", timeout=60.0).text.splitlines()
    held = (
        line.removeprefix('silhouette_cache_bytes{cache="').split('"} ') for line in lines if line.startswith("silhouette_cache_bytes{")
    )
    return {name: float(value) / 2**20 for name, value in held}


def growth(watch: Watch, start: float, seconds: float) -> dict[str, dict[str, float | bool]]:
    """Of everything that was looked at in the second half of the time: its last median, its slope and whether it holds."""
    found: dict[str, dict[str, float | bool]] = {}
    for name, (times, values) in sorted(watch.since(start + 0.5 * seconds).items()):
        slope = slope_of(times, values)
        if slope is not None:
            last = float(np.median(values[len(values) // 2 :]))
            rounded = {"a_minute": slope.a_minute, "low": slope.low, "high": slope.high, "last": last}
            holds = slope.may_be_none or slope.a_minute * seconds / 60.0 < BAR_GROWTH
            found[name] = {key: round(value, 4) for key, value in rounded.items()} | {"holds": holds}
    return found


def told(answers: Answers) -> dict[str, Any]:
    """What there is to say of a phase, and of each kind of request in it."""
    one = {
        "asked": answers.statuses.total(),
        "per_second": round(answers.asked_per_second, 1),
        "p50_ms": round(answers.percentile(50), 2),
        "p99_ms": round(answers.percentile(99), 2),
        "max_ms": round(max(answers.ms, default=math.nan), 1),
        "server_errors": sum(count for status, count in answers.statuses.items() if status >= 500),
        "unexpected": answers.unexpected,
        "statuses": {str(status): count for status, count in sorted(answers.statuses.items())},
    }
    faults = {"faults": [f"{status}: {asked}" for status, asked in answers.faults]} if answers.faults else {}
    kinds = {"kinds": {name: told(of_kind) for name, of_kind in sorted(answers.kinds.items())}} if answers.kinds else {}
    return one | faults | kinds


def _uploads_told(done: Uploads) -> dict[str, Any]:
    return {
        "ready": len(done.seconds),
        "deleted": done.deleted,
        "median_s": round(float(np.median(done.seconds)), 2) if done.seconds else None,
        "faults": done.faults,
    }


def left_in_queue(service: LocalService) -> dict[str, int]:
    """Keys of the queue server once nothing waits any more, by the first parts of their names."""
    import redis

    connection = redis.Redis.from_url(f"unix://{service.data_dir / 'v.sock'}")
    deadline = time.monotonic() + QUEUE_WAIT_S
    while _jobs(service.url) and time.monotonic() < deadline:
        time.sleep(0.5)
    keys = (key.decode() for key in connection.scan_iter(count=1000))
    return dict(Counter(":".join(key.split(":")[:2]) for key in keys).most_common())


def _jobs(url: str) -> float:
    lines = httpx.get(f"{url}/metrics", timeout=60.0).text.splitlines()
    return sum(float(line.split()[-1]) for line in lines if line.startswith("silhouette_jobs{") and 'state="failed"' not in line)


def run(given: argparse.Namespace) -> dict[str, Any]:
    facts = machine()
    with ExitStack() as held:
        data, files = (Path(held.enter_context(tempfile.TemporaryDirectory(prefix="silhouette-mixed-"))) for _ in range(2))
        environment = ENVIRONMENT | {"SILHOUETTE_MEASURE": str(given.measure).lower()}
        with LocalService(data, environment) as service:
            known = prepared(service.url, given.mesh, files, given.texels)
            result = {"machine": facts, "minutes": given.minutes, "clients": given.clients} | load(service, known, files, given)
            result["queue_keys"] = left_in_queue(service)
            result["log"] = service.last_words()
    return result | {"bars": bars(result)}


def bars(result: dict[str, Any]) -> dict[str, bool]:
    """What must hold, and whether it does."""
    phases = [result[name] for name in ("warm", "saturated", "half")]
    memory = [one["holds"] for name, one in result["growth"].items() if name.endswith("MiB") and name != "all RSS MiB"]
    others = [one["holds"] for name, one in result["growth"].items() if not name.endswith("MiB")]
    uploads = [fault for phase in result["uploads"].values() for fault in phase["faults"]]
    return {
        "no 5xx": not any(phase["server_errors"] for phase in phases),
        "every answer as expected": not any(phase["unexpected"] for phase in phases) and not uploads,
        "memory does not grow": bool(memory) and all(memory),
        "files and threads do not grow": bool(others) and all(others),
        f"p99 of a kept thumbnail under {BAR_P99_MS:g} ms": result["half"]["kinds"][THUMBNAIL]["p99_ms"] < BAR_P99_MS,
    }


def print_table(result: dict[str, Any]) -> None:
    print(
        f"{result['clients']} clients, {result['minutes']:g} minutes at {result['asked_per_second']} requests a second, half of the most\n"
    )
    rows = []
    for name, one in result["half"]["kinds"].items():
        most = result["saturated"]["kinds"].get(name, {})
        cells = (one["asked"], one["p50_ms"], one["p99_ms"], most.get("p50_ms"), most.get("p99_ms"), one["unexpected"])
        rows.append([name, *map(number, cells)])
    print(markdown_table(["asked for", "times", "p50 ms", "p99 ms", "p50 ms at most", "p99 ms at most", "not as expected"], rows), "\n")
    rows = []
    for name, one in result["growth"].items():
        bounds = f"{one['low']:+.3f} to {one['high']:+.3f}"
        rows.append([name, number(float(one["last"])), f"{one['a_minute']:+.3f}", bounds, "yes" if one["holds"] else "no"])
    print(markdown_table(["of", "at the end", "a minute", "19 times of 20", "holds"], rows), "\n")
    for name in ("uploads", "cache_mib", "queue_keys"):
        print(f"{name.replace('_', ' ')}: {result[name]}")
    for phase in ("warm", "saturated", "half"):
        print(f"{phase}: {result[phase]['per_second']} a second, {result[phase]['statuses']}", *result[phase].get("faults", []), sep="\n  ")
    print(*(f"{'holds' if holds else 'FAILS'}: {name}" for name, holds in result["bars"].items()), sep="\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", nargs="*", help=f"{MESH_HELP}; a few generated ones if none is given")
    parser.add_argument("--minutes", type=float, default=10.0, help="at half the rate; a quarter of that comes before")
    parser.add_argument("--clients", type=int, default=32)
    parser.add_argument("--uploaders", type=int, default=2, help="how many of the clients upload")
    parser.add_argument("--texels", type=int, default=1024, help="longest side of the maps of uploaded meshes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--measure", action="store_true", help="let workers measure the meshes that are ready, too")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    given = parser.parse_args()
    report(lambda: run(given), given.json, print_table)


if __name__ == "__main__":
    main()
