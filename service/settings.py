"""Settings of the service. Read from `SILHOUETTE_*` and the command line when it starts, never at import."""

from __future__ import annotations

import os
import re
from typing import Annotated

from pydantic import Field, field_validator
from pydantic_settings import NoDecode

from backend.settings import BackendSettings
from schemas.render import MAX_SIDE_PX

ORIGIN = re.compile(r"https?://[A-Za-z0-9.\-\[\]:]+")


class ServiceSettings(BackendSettings):
    """What `python -m service` can be told; environment names are `SILHOUETTE_` and the field's name."""

    host: str = Field("127.0.0.1", description="address to listen on; the default is for this machine only")
    port: int = Field(8000, ge=0, le=65535, description="port to listen on; 0 takes a free one")
    workers: int = Field(
        default_factory=lambda: max(1, (os.cpu_count() or 1)), ge=0, description="worker processes of the embedded default"
    )

    processes: int = Field(1, ge=1, le=256, description="service processes behind the one port, each with a renderer and caches of its own")

    insecure: bool = Field(False, description="listen for other machines though there is no key")
    require_keys: bool = Field(False, description="ask for a key on this machine, too, as behind a proxy; without one, do not start")
    cors_origins: Annotated[tuple[str, ...], NoDecode] = Field((), description="origins whose pages may use the API; * for all")
    behind_tls: bool = Field(False, description="the service is reached by TLS alone: tell browsers so")
    requests_per_minute: int = Field(6000, ge=0, description="requests a minute of a key that has no limit of its own; 0: any number")
    concurrent_renders: int = Field(0, ge=0, description="pictures in work at once of a key that has no limit of its own; 0: any number")
    address_requests_per_minute: int = Field(0, ge=0, description="requests a minute of an address while no key is needed; 0: any number")
    address_concurrent_renders: int = Field(0, ge=0, description="pictures in work at once of an address likewise; 0: any number")
    max_pixels: int = Field(MAX_SIDE_PX**2, ge=1, description="largest picture, width times height")
    max_faces: int | None = Field(None, ge=1, description="faces of the largest mesh; none: what a worker takes")

    max_upload_mib: int = Field(512, ge=1, description="largest upload that is taken, and largest file of positions")
    keep_free_mib: int = Field(256, ge=0, description="free disk that an upload must leave")
    max_body_kib: int = Field(1024, ge=1, description="largest body of any other request")

    once_timeout_s: float = Field(60.0, gt=0.0, description="longest a mesh that is not kept may take until it can be drawn")

    render_depth: int = Field(64, ge=1, description="renders that may wait for the one GL thread; more are told to come back")
    render_timeout_s: float = Field(30.0, gt=0.0, description="longest a request waits for its picture, or for each one of a sequence")
    asset_cache_mib: int = Field(1024, ge=1, description="mesh data kept mapped for rendering and silhouettes")
    picture_cache_mib: int = Field(64, ge=0, description="encoded pictures kept to be given again; 0 keeps none")
    gpu_cache_mib: int = Field(512, ge=1, description="meshes and maps kept by the renderer")
    warm_renderer: bool = Field(True, description="draw in every way, and find what that takes on this device, when the service starts")

    @field_validator("cors_origins", mode="before")
    @classmethod
    def _listed(cls, text: object) -> object:
        return tuple(part.strip() for part in text.split(",") if part.strip()) if isinstance(text, str) else text

    @field_validator("cors_origins")
    @classmethod
    def _are_origins(cls, origins: tuple[str, ...]) -> tuple[str, ...]:
        for origin in origins:
            if origin != "*" and not ORIGIN.fullmatch(origin):
                raise ValueError(f"{origin!r} is no origin: scheme and host, as https://shop.example, without a path")
        return origins
