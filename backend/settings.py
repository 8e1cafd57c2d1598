"""Settings that the service and the workers share. Read from the environment when an instance is made, never at import."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Self
from urllib.parse import urlsplit
from urllib.request import url2pathname

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

ENV_PREFIX = "SILHOUETTE_"
REDIS_SCHEMES = ("redis", "rediss", "unix")
BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")
PREFIX = re.compile(r"(/[A-Za-z0-9_-][A-Za-z0-9._-]*)*/?")


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
    redis_url: str | None = Field(None, repr=False, description="Redis of the queue; none: a private server is started")
    redis_password_file: Path | None = Field(None, description="file with the password of the Redis, instead of one in its URL")
    redis_ca_file: Path | None = Field(None, description="PEM certificates that a rediss:// server's is to be signed by")
    store_url: str | None = Field(None, description="none: local disk under data_dir; file:///path: local disk there; s3://bucket/prefix")
    store_endpoint: str | None = Field(None, description="http(s)://host:port of an S3 store that is not Amazon's")
    store_region: str | None = Field(None, description="region of an S3 store; none: AWS_REGION")
    store_ca_file: Path | None = Field(None, description="PEM certificates that an S3 store's may be signed by, besides public ones")
    store_cache_mib: int = Field(4096, ge=1, description="copies of an S3 store's objects under data_dir")
    log_level: str = Field("INFO", pattern=r"^(DEBUG|INFO|WARNING|ERROR)$", description="least level of log lines")

    log_requests: bool = Field(True, description="a log line for each request that is answered")
    trace_endpoint: str | None = Field(None, description="OTLP collector that traces go to, over HTTP; none: no traces")

    measure: bool = Field(True, description="once a mesh is ready, make hulls of other sizes and measure what accuracy costs")
    stage_timeout_s: int = Field(3600, ge=10, description="longest one preprocessing stage may run")
    stage_attempts: int = Field(4, ge=1, description="times a stage is started before a mesh fails because its worker died or it broke")
    stop_grace_s: float = Field(5.0, ge=0.0, le=3600.0, description="longest that work under way holds up the end of a process")
    job_record_s: int = Field(3600, ge=60, description="how long the queue remembers a job that ended")
    reconcile_interval_s: float = Field(10.0, gt=0.0, description="how often unfinished meshes are compared with the queue")
    audit_interval_s: float = Field(24 * 3600.0, gt=0.0, description="how often one process goes through everything in the store")
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
        parts = urlsplit(url or "file:")
        if parts.scheme not in ("file", "s3"):
            raise ValueError(
                "not supported: a store is named by file:///path or s3://bucket/prefix, or by nothing for a folder under data_dir"
            )
        if parts.scheme == "s3" and not (BUCKET.fullmatch(parts.netloc) and PREFIX.fullmatch(parts.path) and not parts.query):
            raise ValueError(
                "an S3 store is named by s3://bucket or s3://bucket/prefix; where it is and its keys are settings of their own"
            )
        return url

    @field_validator("store_endpoint")
    @classmethod
    def _plain_endpoint(cls, url: str | None) -> str | None:
        parts = urlsplit(url or "http://host")
        if parts.scheme not in ("http", "https") or not parts.netloc or "@" in parts.netloc or parts.path not in ("", "/") or parts.query:
            raise ValueError("an endpoint is http://host:port or https://host:port, without credentials")
        return url

    @field_validator("redis_password_file", "redis_ca_file", "store_ca_file")
    @classmethod
    def _readable(cls, path: Path | None) -> Path | None:
        if path is not None and not os.access(path, os.R_OK):
            raise ValueError("there is no such file, or it may not be read")
        return path

    @model_validator(mode="after")
    def _password_once(self) -> Self:
        if self.redis_password_file is not None and (self.redis_url is None or urlsplit(self.redis_url).password is not None):
            raise ValueError("redis_password_file needs a redis_url that has no password")
        return self

    @property
    def store_dir(self) -> Path:
        """Folder of the local object store."""
        if self.store_url is None:
            return self.data_dir / "store"
        return Path(url2pathname(urlsplit(self.store_url).path))
