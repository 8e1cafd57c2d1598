"""Kills on purpose while meshes are uploaded: `python -m benchmarks.faults [--json] [--uploads 50] [--kills 30] [--server-kills 5]`.

A service of its own on this machine takes distinct meshes from a few clients; meanwhile its workers, or the forks that run their stages,
are killed at random moments, and so is its queue server. Then every mesh must be ready, whole and there once, and when the service has
stopped no process and, once the next start has swept, no temporary file may be left.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path

import httpx

from backend import records
from backend.damage import is_sound
from backend.local_store import LocalStore
from benchmarks.machine import machine
from client import Client
from client.local import LocalService
from client.shapes import write_ply
from schemas import keys
from tests.meshes import bumpy_sphere

CLIENTS = 4
WORKERS = 2
TEMPORARY_AGE_S = 1
ENVIRONMENT = {
    "SILHOUETTE_WARM_KERNELS": "0",
    "SILHOUETTE_MEASURE": "0",
    "SILHOUETTE_LOG_LEVEL": "ERROR",
    "SILHOUETTE_TEMPORARY_AGE_S": str(TEMPORARY_AGE_S),
}
HULL_FACES, TEXELS = 200, 128
DETAIL = 4
"""Subdivisions of a bumpy sphere: 5,120 faces."""
BETWEEN_KILLS_S = (0.5, 3.0)
LIMIT_S = 900.0


@dataclass
class Outcome:
    """What became of the uploads. right: ready, clipped, every file as its record says; twice: meshes and files beyond one an upload.

    running_at_kills: stages that the service told were running, those of workers that had just been killed among them.
    """

    uploads: int
    right: int = 0
    wrong: list[str] = field(default_factory=list)
    twice: int = 0
    worker_kills: int = 0
    fork_kills: int = 0
    server_kills: int = 0
    running_at_kills: dict[str, int] = field(default_factory=dict)
    refused_then_accepted: int = 0
    orphans: int = 0
    temporary_files_before_sweep: int = 0
    temporary_files: int = 0
    seconds: float = 0.0

    @property
    def is_good(self) -> bool:
        """Whether nothing was lost, doubled or left behind."""
        return self.right == self.uploads and not (self.twice or self.orphans or self.temporary_files)


class Killer(threading.Thread):
    """Kills children of a service at random moments until it has killed as many as it was to."""

    def __init__(self, service: LocalService, kills: int, server_kills: int, seed: int) -> None:
        super().__init__(daemon=True)
        self._service = service
        self._chance = random.Random(seed)
        self._order = ["worker"] * kills + ["server"] * server_kills
        self._chance.shuffle(self._order)
        self.done: Counter[str] = Counter()
        self.running: Counter[str] = Counter()

    def run(self) -> None:
        """One after the other."""
        for what in self._order:
            time.sleep(self._chance.uniform(*BETWEEN_KILLS_S))
            while not self._kill(what):
                time.sleep(0.1)

    def _kill(self, what: str) -> bool:
        children = children_of(self._service.pid)
        if what == "server":
            return self._killed("server", [pid for pid in children if "valkey" in command_of(pid)])
        workers = [pid for pid in children if "-m worker" in command_of(pid) and "--reader" not in command_of(pid)]
        forks = [fork for worker in workers for fork in children_of(worker)]
        stages = self._running() if forks else []
        kind, pids = ("fork", forks) if forks and self._chance.random() < 0.5 else ("worker", workers if forks else [])
        if killed := self._killed(kind, pids):
            self.running.update(stages)
        return killed

    def _killed(self, kind: str, pids: list[int]) -> bool:
        if not pids:
            return False
        try:
            os.kill(self._chance.choice(pids), signal.SIGKILL)
        except ProcessLookupError:
            return False
        self.done[kind] += 1
        return True

    def _running(self) -> list[str]:
        try:
            page = httpx.get(f"{self._service.url}/v1/meshes?limit=200", timeout=20.0).json()
        except (httpx.HTTPError, ValueError):
            return []
        return [stage["name"] for mesh in page["meshes"] for stage in mesh["stages"] if stage["status"] == "running"]


def children_of(pid: int) -> list[int]:
    """Process ids of the children of all threads of a process; none when it is gone."""
    try:
        return [int(word) for task in Path(f"/proc/{pid}/task").iterdir() for word in (task / "children").read_text().split()]
    except OSError:
        return []


def command_of(pid: int) -> str:
    """A process's command line; empty when it is gone."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return ""


def processes_of(folder: Path) -> int:
    """How many processes have the folder in their command line or environment, but this one."""
    found = 0
    for process in Path("/proc").glob("[0-9]*"):
        try:
            text = (process / "cmdline").read_bytes() + (process / "environ").read_bytes()
        except OSError:
            continue
        found += int(process.name) != os.getpid() and os.fsencode(folder) in text
    return found


def run(uploads: int, kills: int, server_kills: int, seed: int, detail: int = DETAIL) -> Outcome:
    """The whole experiment, in a folder of its own that is removed afterwards. detail: of most meshes, every fifth has one more."""
    folder = Path(tempfile.mkdtemp(prefix="silhouette-faults-"))
    outcome, started = Outcome(uploads), time.perf_counter()
    try:
        files = _files(folder / "files", uploads, detail)
        _upload_under_fire(folder, files, outcome, kills, server_kills, seed)
        time.sleep(TEMPORARY_AGE_S + 0.5)
        outcome.orphans = processes_of(folder)
        outcome.temporary_files_before_sweep = _temporary_files(folder)
        with LocalService(folder, ENVIRONMENT, ("--workers", "0")):
            deadline = time.monotonic() + 20.0
            while (left := _temporary_files(folder)) and time.monotonic() < deadline:
                time.sleep(0.1)
            outcome.temporary_files = left
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    outcome.seconds = round(time.perf_counter() - started, 1)
    return outcome


def _temporary_files(folder: Path) -> int:
    place = folder / "store" / ".tmp"
    return sum(1 for _ in place.iterdir()) if place.is_dir() else 0


def _upload_under_fire(folder: Path, files: list[Path], outcome: Outcome, kills: int, server_kills: int, seed: int) -> None:
    with LocalService(folder, ENVIRONMENT, ("--workers", str(WORKERS))) as service:
        killer = Killer(service, kills, server_kills, seed)
        killer.start()
        with ThreadPoolExecutor(CLIENTS) as clients:
            accepted = list(clients.map(lambda path: _upload(service.url, path, outcome), files))
        _wait(folder, accepted)
        killer.join(timeout=1.0)
        again = [_upload(service.url, path, outcome) for path in files]
    outcome.worker_kills, outcome.fork_kills, outcome.server_kills = (killer.done[name] for name in ("worker", "fork", "server"))
    outcome.running_at_kills = dict(killer.running.most_common())
    store = LocalStore(folder / "store")
    outcome.wrong = [fault for mesh_id in accepted if (fault := _fault(store, mesh_id))]
    outcome.right = outcome.uploads - len(outcome.wrong)
    stored = len(list(store.children(keys.MESHES))), len(list(store.children(keys.UPLOADS)))
    outcome.twice = sum(count - outcome.uploads for count in stored) + sum(a != b for a, b in zip(accepted, again, strict=True))


def _files(folder: Path, count: int, detail: int) -> list[Path]:
    folder.mkdir()
    paths = [folder / f"{number}.ply" for number in range(count)]
    for number, path in enumerate(paths):
        write_ply(str(path), *bumpy_sphere(detail + 1 if number % 5 == 0 else detail, seed=number))
    return paths


def _upload(url: str, path: Path, outcome: Outcome) -> str:
    """Id of the mesh that the upload became, tried again until it is accepted."""
    deadline = time.monotonic() + LIMIT_S
    while True:
        try:
            with Client(url, timeout_s=60.0) as client:
                return client.upload(path, hull_faces=HULL_FACES, texels=TEXELS).id
        except Exception:  # what counts is that a client who tries again gets through
            outcome.refused_then_accepted += 1
            if time.monotonic() > deadline:
                raise
            time.sleep(0.5)


def _wait(folder: Path, accepted: list[str]) -> None:
    store, deadline = LocalStore(folder / "store"), time.monotonic() + LIMIT_S
    while time.monotonic() < deadline and not all(store.exists(keys.manifest(mesh_id)) for mesh_id in accepted):
        time.sleep(0.2)


def _fault(store: LocalStore, mesh_id: str) -> str:
    """What is wrong with a mesh; empty when nothing is."""
    manifest = records.read_manifest(store, mesh_id)
    if manifest is None or manifest.status != "ready":
        return f"{mesh_id} is {'in work' if manifest is None else manifest.status}"
    if not manifest.capabilities["clip"].available:
        return f"{mesh_id} is not clipped: {manifest.capabilities['clip'].reason}"
    damaged = [record.stage for record in manifest.stages if not is_sound(store, mesh_id, record)]
    return f"{mesh_id}: files of {', '.join(damaged)} are damaged" if damaged else ""


def main() -> int:
    """Run it and say what came out; 1 when anything was lost, doubled or left behind."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults", description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--uploads", type=int, default=50)
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--server-kills", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    flags = parser.parse_args()
    facts = machine()
    outcome = run(flags.uploads, flags.kills, flags.server_kills, flags.seed)
    if flags.json:
        print(json.dumps({"machine": facts, **asdict(outcome)}, indent=2))
    else:
        print(f"{outcome.right} of {outcome.uploads} right after {outcome.worker_kills} workers, {outcome.fork_kills} stages and")
        print(
            f"{outcome.server_kills} servers killed; {outcome.twice} twice, {outcome.orphans} orphans, {outcome.temporary_files} files left"
        )
        print("\n".join(outcome.wrong), end="")
    return 0 if outcome.is_good else 1


if __name__ == "__main__":
    sys.exit(main())
