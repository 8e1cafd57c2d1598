"""Stages of the preprocessing, and the dotted names under which the service enqueues them without knowing their code."""

from __future__ import annotations

RUN_STAGE = "worker.jobs.run_stage"
"""Callable `(mesh_id: str, stage: str) -> None`; one job runs one stage."""

WORKER_MODULE = "worker"
"""`python -m` name of the worker process."""

QUEUE = "silhouette"

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
