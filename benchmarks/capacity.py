"""How many processes, bytes and requests so many meshes and pictures a second take: arithmetic over what was measured of one mesh.

    python -m benchmarks.capacity [--meshes 1e6] [--renders 1e4] [--zipf 0.9] [--same 0.9] [--days 30] [--use 0.5] [--set NAME=VALUE]
    ... [--variants] [--json]

docs/capacity.md says what is assumed and what follows. Every mesh is taken for the one that was measured (`Inputs`). Meshes are asked for
by Zipf's law, `same` of the requests for the one thumbnail of the mesh and the others for views that nobody asks for again. What a cache
that drops the least recently used has is found by Che's approximation (Che, Tung, Wang: Hierarchical Web Caching Systems, 2002, section
III): a thing is in it if it was asked for within a time that is the same for all, and with which the things that are in it fill it.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.report import markdown_table, number

Rates = NDArray[np.float64]
HALVINGS = 100
SINGLE, GROUPS = 1000, 2000
SPREAD, HASHED = "any process", "by mesh"
MIB, GIB, TIB = 2.0**20, 2.0**30, 2.0**40
DAY_S = 86400.0
LIST_KEYS = 1000


@dataclass(frozen=True)
class Inputs:
    """Measured of one mesh and one process, and settings; a name ends with its unit. docs/capacity.md says where each comes from."""

    drawn_per_core_s: float = 205.0
    drawn_per_process_s: float = 237.0
    kept_per_core_s: float = 1071.0
    picture_bytes: float = 25_454.0
    empty_process_mib: float = 507.0
    gpu_cache_mib: float = 512.0
    picture_cache_mib: float = 64.0
    asset_cache_mib: float = 1024.0
    copies_mib: float = 8192.0
    manifests_kept: float = 256.0
    look_interval_s: float = 1.0
    mapped_mib: float = 9.27
    load_core_s: float = 0.19
    copy_core_s: float = 0.05
    look_requests: float = 2.0
    manifest_requests: float = 4.0
    check_requests: float = 12.0
    copy_requests: float = 12.0
    upload_bytes: float = 1_323_817.0
    stored_bytes: float = 15_108_282.0
    stored_objects: float = 28.0
    prepare_core_s: float = 24.4
    later_core_s: float = 78.4
    worker_mib: float = 411.0
    prepare_reads: float = 339.0
    prepare_writes: float = 52.0
    prepare_redis: float = 1796.0
    list_s: float = 0.1
    audit_interval_s: float = 86_400.0


@dataclass(frozen=True)
class Wanted:
    """What is to be served. zipf: exponent. same: part of the requests that are for thumbnails. use: part of the processors that may be
    busy. days: in which all meshes are to be made ready. workers_use: the same as `use`, of workers."""

    meshes: int = 1_000_000
    renders_per_s: float = 10_000.0
    zipf: float = 0.9
    same: float = 0.9
    days: float = 30.0
    use: float = 0.5
    workers_use: float = 0.9


@dataclass(frozen=True)
class Popularity:
    """Meshes in groups of those that are asked for about as often, most asked for first. rates (k,) f8: requests a second of one of a
    group, counts (k,) f8: meshes in it."""

    rates: Rates
    counts: Rates

    def sum(self, rates: Rates) -> float:
        """Of all meshes together."""
        return float((rates * self.counts).sum())


def popularity(wanted: Wanted) -> Popularity:
    """By Zipf's law. The first ranks have a group each."""
    ends = np.unique(np.concatenate([np.arange(SINGLE + 1), np.geomspace(1, wanted.meshes, GROUPS).astype(np.int64)]))
    ends = ends[ends <= wanted.meshes]
    weight = np.concatenate([[0.0], np.cumsum(np.arange(1, wanted.meshes + 1, dtype=np.float64) ** -wanted.zipf)])
    counts = np.diff(ends).astype(np.float64)
    return Popularity(np.diff(weight[ends]) / counts * (wanted.renders_per_s / weight[-1]), counts)


def kept(rates: Rates, counts: Rates, room: float, passing: float = 0.0) -> Rates:
    """Probability of finding each of so many things with these rates in a cache with room for so many. passing: things a second that are
    put into it and never asked for again."""
    if room >= counts.sum() and not passing:
        return np.ones_like(rates)
    shortest, longest = 0.0, 1e12
    for _ in range(HALVINGS):
        age = 0.5 * (shortest + longest)
        if passing * age - (counts * np.expm1(-rates * age)).sum() > room:
            longest = age
        else:
            shortest = age
    return -np.expm1(-rates * shortest)


def serving(inputs: Inputs, wanted: Wanted, routing: str) -> dict[str, float]:
    """What processes do, and how many there are: the fewest that are not busier than they may be."""
    asked = popularity(wanted)
    each = wanted.use * inputs.drawn_per_process_s / inputs.drawn_per_core_s
    fewest, enough = 0, 1
    while _of_processes(inputs, wanted, asked, routing, enough)["cores"] > enough * each:
        fewest, enough = enough, 2 * enough
    while enough - fewest > 1:
        count = (fewest + enough) // 2
        if _of_processes(inputs, wanted, asked, routing, count)["cores"] > count * each:
            fewest = count
        else:
            enough = count
    return _of_processes(inputs, wanted, asked, routing, enough)


def _of_processes(inputs: Inputs, wanted: Wanted, asked: Popularity, routing: str, count: int) -> dict[str, float]:
    """Of `count` processes. Where a mesh has one process, all together are one with as much room; else each sees a part of every mesh."""
    alike, rooms = (1, count) if routing == HASHED else (count, 1)
    seen, counts = asked.rates / alike, asked.counts
    once = (1.0 - wanted.same) * asked.sum(seen)
    pictures = kept(wanted.same * seen, counts, rooms * inputs.picture_cache_mib * MIB / inputs.picture_bytes, once)
    drawn = seen * (1.0 - wanted.same * pictures)
    loads = drawn * (1.0 - kept(drawn, counts, rooms * inputs.asset_cache_mib / inputs.mapped_mib))
    copies = np.minimum(loads, drawn * (1.0 - kept(drawn, counts, rooms * inputs.copies_mib / inputs.mapped_mib)))
    looks = seen / (1.0 + seen * inputs.look_interval_s)
    reads = looks * (1.0 - kept(looks, counts, rooms * inputs.manifests_kept))
    every = {"drawn": drawn, "loads": loads, "copies": copies, "looks": looks, "reads": reads}
    sums = {name: alike * asked.sum(part) for name, part in every.items()}
    busiest = _busiest(inputs, wanted, float(seen[0]), float(pictures[0]))
    return {"processes": count, **sums, **_costs(inputs, wanted, sums), "busiest": busiest}


def _costs(inputs: Inputs, wanted: Wanted, sums: dict[str, float]) -> dict[str, float]:
    """Cores that are busy, and requests to the store a second."""
    cores = (wanted.renders_per_s - sums["drawn"]) / inputs.kept_per_core_s + sums["drawn"] / inputs.drawn_per_core_s
    requests = sums["looks"] * inputs.look_requests + sums["reads"] * inputs.manifest_requests
    requests += sums["loads"] * inputs.check_requests + sums["copies"] * inputs.copy_requests
    cores += sums["loads"] * inputs.load_core_s + sums["copies"] * inputs.copy_core_s
    return {"cores": cores, "store_requests": requests}


def _busiest(inputs: Inputs, wanted: Wanted, rate: float, found: float) -> float:
    """Cores that the mesh asked for most keeps busy in one process."""
    same = wanted.same * found
    return rate * (same / inputs.kept_per_core_s + (1.0 - same) / inputs.drawn_per_core_s)


def storing(inputs: Inputs, wanted: Wanted) -> dict[str, float]:
    """What the object store holds, and what a look through all of it takes."""
    objects = wanted.meshes * inputs.stored_objects
    return {
        "artifacts_tib": wanted.meshes * inputs.stored_bytes / TIB,
        "uploads_tib": wanted.meshes * inputs.upload_bytes / TIB,
        "objects": objects,
        "lists": objects / LIST_KEYS,
        "all_listed_s": objects / LIST_KEYS * inputs.list_s,
        "lists_per_s": objects / LIST_KEYS / inputs.audit_interval_s,
    }


def preparing(inputs: Inputs, wanted: Wanted) -> dict[str, float]:
    """What makes all meshes ready in so many days."""
    rate = wanted.meshes / (wanted.days * DAY_S)
    cores = {"ready": rate * inputs.prepare_core_s, "later": rate * inputs.later_core_s}
    workers = {name: math.ceil(busy / wanted.workers_use) for name, busy in cores.items()}
    return {
        "meshes_per_s": rate,
        "upload_mib_s": rate * inputs.upload_bytes / MIB,
        "workers": workers["ready"],
        "workers_later": workers["later"],
        "workers_gib": workers["ready"] * inputs.worker_mib * MIB / GIB,
        "store_reads": rate * inputs.prepare_reads,
        "store_writes": rate * inputs.prepare_writes,
        "redis_commands": rate * inputs.prepare_redis,
    }


def plan(inputs: Inputs, wanted: Wanted) -> dict[str, Any]:
    """Everything: serving by each way to spread requests, storing and preparing."""
    return {
        "serving": {routing: _sized(inputs, wanted, serving(inputs, wanted, routing)) for routing in (SPREAD, HASHED)},
        "storing": storing(inputs, wanted),
        "preparing": preparing(inputs, wanted),
    }


def _sized(inputs: Inputs, wanted: Wanted, found: dict[str, float]) -> dict[str, float]:
    memory = inputs.empty_process_mib + inputs.asset_cache_mib + inputs.gpu_cache_mib + inputs.picture_cache_mib
    return found | {
        "memory_gib": found["processes"] * memory * MIB / GIB,
        "disk_gib": found["processes"] * inputs.copies_mib * MIB / GIB,
        "answers_mib_s": wanted.renders_per_s * inputs.picture_bytes / MIB,
        "copied_mib_s": found["copies"] * inputs.mapped_mib,
        "counted_per_s": wanted.renders_per_s,
    }


ROWS = {
    "serving": {
        "processes": "service processes",
        "cores": "cores busy",
        "memory_gib": "memory, GiB",
        "disk_gib": "disk for copies, GiB",
        "drawn": "pictures drawn a second; the rest is kept",
        "loads": "meshes mapped and checked a second",
        "copies": "meshes copied from the store a second",
        "copied_mib_s": "from the store, MiB a second",
        "store_requests": "requests to the store a second",
        "answers_mib_s": "answers, MiB a second",
        "counted_per_s": "requests counted in Redis a second",
        "busiest": "cores for the mesh asked for most, in one process",
    },
    "storing": {
        "artifacts_tib": "artifacts and records, TiB",
        "uploads_tib": "uploads, TiB",
        "objects": "objects",
        "lists": "LIST requests to see all of them",
        "all_listed_s": "seconds to see all of them",
        "lists_per_s": "LIST requests a second to go through all of them once a day",
    },
    "preparing": {
        "meshes_per_s": "meshes a second",
        "upload_mib_s": "uploads, MiB a second",
        "workers": "workers until all are ready",
        "workers_later": "workers besides for hulls of other sizes and accuracy",
        "workers_gib": "memory of the first, GiB",
        "store_reads": "GET and HEAD a second",
        "store_writes": "PUT and DELETE a second",
        "redis_commands": "Redis commands a second",
    },
}
"""What each figure is, in the order in which it is printed."""


def tables(found: dict[str, Any]) -> str:
    """The figures as Markdown."""
    served = found["serving"]
    rows = [[text, *(number(rounded(served[routing][name])) for routing in served)] for name, text in ROWS["serving"].items()]
    parts = [markdown_table(["serving", *served], rows)]
    for part in ("storing", "preparing"):
        parts.append(markdown_table([part, ""], [[text, number(rounded(found[part][name]))] for name, text in ROWS[part].items()]))
    return "\n\n".join(parts)


VARIANTS: tuple[tuple[str, dict[str, float], dict[str, float]], ...] = (
    ("as above", {}, {}),
    ("popularity flatter: exponent 0.7", {}, {"zipf": 0.7}),
    ("popularity steeper: exponent 1.1", {}, {"zipf": 1.1}),
    ("half of the requests for views that are asked for once", {}, {"same": 0.5}),
    ("256 MiB of pictures a process", {"picture_cache_mib": 256.0}, {}),
    ("4 GiB of meshes a process", {"asset_cache_mib": 4096.0}, {}),
    ("64 GiB of copies a process", {"copies_mib": 65536.0}, {}),
    ("all three", {"picture_cache_mib": 256.0, "asset_cache_mib": 4096.0, "copies_mib": 65536.0}, {}),
    ("processes 70 % busy", {}, {"use": 0.7}),
    ("if a mesh were loaded in 0.08 s of a core", {"load_core_s": 0.08}, {}),
    ("if manifests of 4,096 meshes were kept, and looked at once a minute", {"manifests_kept": 4096.0, "look_interval_s": 60.0}, {}),
)
"""What, changed inputs, changed wishes."""


def variants(inputs: Inputs, wanted: Wanted) -> str:
    """What moves the result where a mesh has one process, as Markdown."""
    rows = []
    for text, other, wish in VARIANTS:
        found = serving(replace(inputs, **other), replace(wanted, **wish), HASHED)
        rows.append([text, *(number(rounded(found[name])) for name in ("processes", "drawn", "loads", "copies", "store_requests"))])
    return markdown_table(["by mesh", "processes", "drawn/s", "mapped/s", "copied/s", "store requests/s"], rows)


def rounded(value: float) -> float | int:
    """With three significant digits, as a whole number where it has none behind the point."""
    near = float(f"{value:.3g}")
    return int(near) if near == int(near) else near


def changed(inputs: Inputs, given: Sequence[str]) -> Inputs:
    """The inputs with those of `NAME=VALUE` in place. Raises SystemExit for a name that is none."""
    names = {field.name for field in fields(Inputs)}
    pairs = [text.partition("=")[::2] for text in given]
    if unknown := sorted({name for name, _ in pairs} - names):
        raise SystemExit(f"no such input: {', '.join(unknown)}; there are {', '.join(sorted(names))}")
    return replace(inputs, **{name: float(value) for name, value in pairs})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=float, default=1e6)
    parser.add_argument("--renders", type=float, default=1e4, help="pictures a second")
    parser.add_argument("--zipf", type=float, default=0.9, help="exponent of popularity; 0: all alike")
    parser.add_argument("--same", type=float, default=0.9, help="part of the requests that are for thumbnails")
    parser.add_argument("--days", type=float, default=30.0, help="in which all meshes are made ready")
    parser.add_argument("--use", type=float, default=0.5, help="part of a process's processor time that may be taken")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="another value of an input")
    parser.add_argument("--variants", action="store_true", help="what moves the result, besides")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    wanted = Wanted(int(given.meshes), given.renders, given.zipf, given.same, given.days, given.use)
    inputs = changed(Inputs(), given.set)
    found = plan(inputs, wanted)
    print(json.dumps(found) if given.json else tables(found))
    if given.variants:
        print("", variants(inputs, wanted), sep="\n")


if __name__ == "__main__":
    main()
