"""Settings that the service and the workers share. Read from the environment when an instance is made, never at import."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

from pydantic import Field, ValidationError, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

ENV_PREFIX = "SILHOUETTE_"
REDIS_SCHEMES = ("redis", "rediss", "unix")


def default_data_dir() -> Path:
    """The user's data folder, as the XDG base directory rules have it."""
    return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share") / "silhouette"


def setting_faults(error: ValidationError) -> list[str]:
    """A line for people for each setting that cannot be used."""
    return [f"setting {'.'.join(map(str, fault['loc']))}: {fault['msg'].removeprefix('Value error, ')}" for fault in error.errors()]


class BackendSettings(BaseSettings):
    """Where things are kept, and how stubborn the queue is. Environment names are `SILHOUETTE_` and the field's name."""

    model_config = SettingsConfigDict(env_prefix=ENV_PREFIX, extra="ignore", env_ignore_empty=True)

    data_dir: Path = Field(default_factory=default_data_dir, description="folder of everything kept on this machine")
    redis_url: str | None = Field(None, description="Redis of the queue; none: a private server is started")
    store_url: str | None = Field(None, description="object store; none: local disk under data_dir; file:///path: local disk there")
    log_level: str = Field("INFO", pattern=r"^(DEBUG|INFO|WARNING|ERROR)$", description="least level of log lines")

    log_requests: bool = Field(True, description="a log line for each request that is answered")
    trace_endpoint: str | None = Field(None, description="OTLP collector that traces go to, over HTTP; none: no traces")

    measure: bool = Field(True, description="once a mesh is ready, make hulls of other sizes and measure what accuracy costs")
    stage_timeout_s: int = Field(3600, ge=10, description="longest one preprocessing stage may run")
    stage_attempts: int = Field(4, ge=1, description="times a stage is started before a mesh fails because its worker died or it broke")
    stop_grace_s: float = Field(5.0, ge=0.0, le=3600.0, description="longest that work under way holds up the end of a process")
    job_record_s: int = Field(3600, ge=60, description="how long the queue remembers a job that ended")
    reconcile_interval_s: float = Field(10.0, gt=0.0, description="how often accepted meshes are compared with the queue")
    temporary_age_s: float = Field(6 * 3600.0, gt=0.0, description="temporary files older than this belong to nobody")

    @field_validator("redis_url")
    @classmethod
    def _known_server(cls, url: str | None) -> str | None:
        if url is not None and urlsplit(url).scheme not in REDIS_SCHEMES:
            raise ValueError("a Redis is named by redis://, rediss:// or unix://")
        return url

    @field_validator("store_url")
    @classmethod
    def _known_store(cls, url: str | None) -> str | None:
        if url is not None and urlsplit(url).scheme != "file":
            raise ValueError(f"store_url {url!r} is not supported: only file:///path, or nothing for a folder under data_dir")
        return url

    @property
    def store_dir(self) -> Path:
        """Folder of the local object store."""
        if self.store_url is None:
            return self.data_dir / "store"
        return Path(url2pathname(urlsplit(self.store_url).path))
