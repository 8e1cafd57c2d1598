"""Stages of the preprocessing, and the dotted names under which the service enqueues them without knowing their code."""

from __future__ import annotations

RUN_STAGE = "worker.jobs.run_stage"
"""Callable `(mesh_id: str, stage: str) -> None`; one job runs one stage."""

WORKER_MODULE = "worker"
"""`python -m` name of the worker process."""

QUEUE = "silhouette"
LATER_QUEUE = "silhouette-later"
"""Of the later stages: workers look there when nothing else is to be done."""

READ_MESH = "worker.once.read_mesh"
"""Callable `(token: str, extension: str, options: dict) -> None`; one job reads one mesh that is not kept (`backend.once`)."""

ONCE_QUEUE = "silhouette-once"
"""Of meshes that are not kept: a client waits, so readers look nowhere else, and no stage is in front of them."""

READER_FLAG = "--reader"
"""Of the worker module, for a process that takes jobs off that queue and no other."""

MEASURE = "service.measure.measure_mesh"
"""Callable `(store, mesh_id, progress, pause) -> dict | None`, for the stage `measure`: the one piece of work on the workers' side that
draws. store: `backend.store.Store`; progress: takes a fraction, raises CancelledError; pause: whether others are waiting for the
worker. Returns the report (`schemas.ladder.Ladder` as JSON), or None when it paused and is to be started again: what it had is kept
under `keys.partial`."""

STAGES: dict[str, tuple[str, ...]] = {
    "load": (),
    "hull": ("load",),
    "inner": ("load",),
    "tree": ("load",),
    "levels": ("hull",),
    "bake": ("hull",),
    "verify": ("bake", "levels", "tree", "inner"),
}
"""Stage -> the stages that must be done (or skipped) before it; of those that are due, earlier ones are started first: the one that
others wait for, then the longest, so that two workers end together. Publishing the manifest ends `verify`."""

LATER_STAGES: dict[str, tuple[str, ...]] = {
    "hulls": ("verify",),
    "measure": ("hulls",),
}
"""Stages of a mesh that is ready already, where the service wants them; the same form."""
