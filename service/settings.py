"""Settings of the service. Read from `SILHOUETTE_*` and the command line when it starts, never at import."""

from __future__ import annotations

import os

from pydantic import Field

from backend.settings import BackendSettings


class ServiceSettings(BackendSettings):
    """What `python -m service` can be told; environment names are `SILHOUETTE_` and the field's name."""

    host: str = Field("127.0.0.1", description="address to listen on; the default is for this machine only")
    port: int = Field(8000, ge=0, le=65535, description="port to listen on; 0 takes a free one")
    workers: int = Field(
        default_factory=lambda: max(1, (os.cpu_count() or 1)), ge=0, description="worker processes of the embedded default"
    )

    max_upload_mib: int = Field(512, ge=1, description="largest upload that is taken")
    keep_free_mib: int = Field(256, ge=0, description="free disk that an upload must leave")
    max_body_kib: int = Field(1024, ge=1, description="largest body of any other request")

    once_timeout_s: float = Field(60.0, gt=0.0, description="longest a mesh that is not kept may take until it can be drawn")

    render_depth: int = Field(8, ge=1, description="renders that may wait for the one GL thread; more are told to come back")
    render_timeout_s: float = Field(30.0, gt=0.0, description="longest a request waits for its picture")
    asset_cache_mib: int = Field(1024, ge=1, description="mesh data kept mapped for rendering and silhouettes")
    picture_cache_mib: int = Field(64, ge=0, description="encoded pictures kept to be given again; 0 keeps none")
    gpu_cache_mib: int = Field(512, ge=1, description="meshes and maps kept by the renderer")
