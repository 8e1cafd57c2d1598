"""How many pictures a second one service process answers, how long they take at half of that, and what rivals do on the same machine.

    python -m benchmarks.service MESH [--size 256] [--seconds 20] [--clients 4] [--json]

A service of its own is started on a free port of this machine, with the mesh prepared; nothing else is put under load, and no run is
longer than was asked for. `views` are different pictures, each of them drawn; `same` is one that is kept. Throughput is of so many clients
that each ask again at once, latency of requests at even distances at half that rate, counted from when each was due. Processor time is
that of the service's process; the clients' and the rivals' are their own. Rivals draw and encode in a process of their own, without HTTP.
"""

from __future__ import annotations

import argparse
import itertools
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.http_load import Answers, closed_loop, open_loop
from benchmarks.isolated import FailedError, isolated
from benchmarks.models import AbsentError, mesh_file
from benchmarks.picture_rivals import RIVALS, rival_pictures
from benchmarks.report import markdown_table, mesh_parser, number, report, times
from client.api import Client
from client.local import LocalService
from schemas.mesh import MeshInfo

BAR_PER_SECOND, BAR_RIVALS, BAR_P99_MS = 150.0, 5.0, 60.0
TICKS = os.sysconf("SC_CLK_TCK")
WARM_S = 3.0


def views(mesh_id: str, side: int) -> Iterator[str]:
    """Addresses of clipped pictures from ever other directions."""
    for step in itertools.count():
        azimuth, elevation = (step * 137.508) % 360.0, (step * 11.3) % 120.0 - 60.0
        yield (f"/v1/meshes/{mesh_id}/render.png?width={side}&height={side}&source=clipped&azimuth={azimuth:.3f}&elevation={elevation:.3f}")


def processor_s(pid: int) -> float:
    """Processor time of a process so far, seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def resident_mib(pid: int) -> float:
    """Memory of a process, MiB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return round(pages * os.sysconf("SC_PAGE_SIZE") / 2**20, 1)


def throughput(service: LocalService, paths: Iterator[str], given: argparse.Namespace) -> dict[str, Any]:
    """Pictures a second, and a second of the service's processor time."""
    closed_loop(service.url, paths, given.clients, WARM_S)
    before = processor_s(service.pid)
    answers = closed_loop(service.url, paths, given.clients, given.seconds)
    spent = processor_s(service.pid) - before
    return _told(answers) | {"per_core_second": round(answers.statuses[200] / spent, 1) if spent else None}


def _told(answers: Answers) -> dict[str, Any]:
    return {
        "per_second": round(answers.per_second, 1),
        "p50_ms": round(answers.percentile(50), 2),
        "p99_ms": round(answers.percentile(99), 2),
        "statuses": dict(answers.statuses),
    }


def prepared(service: LocalService, path: Path) -> MeshInfo:
    """The mesh, ready."""
    with Client(service.url) as client:
        return client.wait(client.upload(path).id)


def run(given: argparse.Namespace) -> dict[str, Any]:
    with mesh_file(given.mesh) as path, tempfile.TemporaryDirectory() as folder:
        with LocalService(Path(folder), {"SILHOUETTE_MEASURE": "false"}, ("--workers", "1")) as service:
            info = prepared(service, path)
            pictures = views(info.id, given.size)
            thumbnail = itertools.repeat(f"/v1/meshes/{info.id}/thumbnail.png?size={given.size}")
            result: dict[str, Any] = {"mesh": Path(given.mesh).name, "size": given.size, "clients": given.clients, "seconds": given.seconds}
            result["views"] = throughput(service, pictures, given)
            result["same"] = throughput(service, thumbnail, given)
            half = 0.5 * result["views"]["per_second"]
            result["half"] = {"asked_per_second": round(half, 1)} | _told(open_loop(service.url, pictures, half, given.seconds))
            result["resident_mib"] = resident_mib(service.pid)
        result["rivals"] = {name: _rival(name, path, given.size) for name in RIVALS}
    known = [rival["per_core_second"] for rival in result["rivals"].values() if "per_core_second" in rival]
    result["to_best_rival"] = round(result["views"]["per_core_second"] / max(known), 2) if known else None
    return result


def _rival(name: str, path: Path, side: int) -> dict[str, Any]:
    try:
        return dict(isolated(rival_pictures, name, path, side, limit_s=300.0)[0])
    except (AbsentError, FailedError) as error:
        return {"absent": str(error)}


def print_table(result: dict[str, Any]) -> None:
    print(f"{result['mesh']}, {result['size']} px, {result['clients']} clients, {result['resident_mib']} MiB resident at the end")
    rows = []
    for name, words in (("views", "clipped, each drawn"), ("same", "the same, kept"), ("half", "at half the rate")):
        one = result[name]
        faults = sum(count for status, count in one["statuses"].items() if status != 200)
        rows.append([words, *(number(one.get(k)) for k in ("per_second", "per_core_second", "p50_ms", "p99_ms")), number(faults)])
    for name, one in result["rivals"].items():
        told = one.get("absent")
        rows.append([f"{name}: {told}" if told else name, number(one.get("per_second")), number(one.get("per_core_second")), "", "", ""])
    print(markdown_table(["pictures", "a second", "a core's second", "p50 ms", "p99 ms", "not 200"], rows))
    print(
        f"\nto the best rival, a core: {times(result['to_best_rival'])} (at least {BAR_RIVALS:g}); bars: {BAR_PER_SECOND:g} a second, "
        f"p99 {BAR_P99_MS:g} ms at half the rate"
    )


def main() -> None:
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--size", type=int, default=256, help="pixels along each side")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each run")
    parser.add_argument("--clients", type=int, default=4)
    given = parser.parse_args()
    report(lambda: run(given), given.json, print_table)


if __name__ == "__main__":
    main()
