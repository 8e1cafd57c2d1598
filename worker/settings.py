"""Settings of a worker process."""

from __future__ import annotations

from pydantic import Field

from backend.settings import BackendSettings


class WorkerSettings(BackendSettings):
    """What `python -m worker` can be told; environment names are `SILHOUETTE_` and the field's name."""

    nice: int = Field(0, ge=0, le=19, description="how far the worker gives way to what else runs on the machine")
    warm_kernels: bool = Field(True, description="compile all kernels in the background when a worker starts")
