"""Checks of what the service needs beside itself: queue server, store, port, keys."""

from __future__ import annotations

import errno
import re
import socket
import tempfile
import time
import uuid
from pathlib import Path
from typing import Any

import httpx
import redis

from backend.redis_connection import connect
from backend.s3_client import NO_BUCKET, REFUSED, UNAVAILABLE
from backend.stores import open_store
from schemas.errors import SilhouetteError, StorageFullError
from service.access.policy import startup_fault
from service.doctor.finding import Finding
from service.doctor.machine import CLOCK_S
from service.embedded import EmbeddedBackend, StartupError, find_server
from service.settings import ServiceSettings

ANSWER_S = 3.0
LEAST_REDIS = (7, 0)
PROBE_BYTES = 1 << 20
SLOW_SYNC_S = 1.0
S3_REMEDIES = {
    NO_BUCKET: "make that bucket, or correct the name in SILHOUETTE_STORE_URL",
    REFUSED: "correct AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or let them list, read, write and delete in that bucket",
    UNAVAILABLE: "start that store, or correct SILHOUETTE_STORE_ENDPOINT and SILHOUETTE_STORE_REGION: docs/deploy.md",
}
PASSWORD = re.compile(r"(://[^:@/]*:)[^@/]*@")


def check_queue(settings: ServiceSettings) -> Finding:
    """The Redis that is named, or a private server that is started for the check."""
    if settings.redis_url is not None:
        return _named_server(settings, settings.redis_url)
    try:
        program = find_server()
        with tempfile.TemporaryDirectory(prefix="silhouette-doctor-") as folder:
            backend = EmbeddedBackend(Path(folder), worker_count=0)
            backend.start()
            try:
                with connect(backend.redis_url, timeout_s=ANSWER_S) as connection:
                    version = _info(connection)["redis_version"]
            finally:
                backend.stop(0.0)
    except StartupError as error:
        return Finding("no private server", f"{error}; make setup installs one")
    return Finding(f"private server {program}, Redis {version}")


def _named_server(settings: ServiceSettings, url: str) -> Finding:
    shown = PASSWORD.sub(r"\1***@", url)
    connection = connect(url, settings.redis_password_file, settings.redis_ca_file, timeout_s=ANSWER_S)
    try:
        info = _info(connection)
        server_s = connection.time()
    except redis.RedisError as error:
        return Finding(f"{shown}: {error}", _remedy(error, url))
    finally:
        connection.close()
    found = f"{shown}, Redis {info['redis_version']}"
    if tuple(int(part) for part in info["redis_version"].split(".")[:2]) < LEAST_REDIS:
        return Finding(found, "use Redis 7.0 or newer, or Valkey")
    if (policy := info.get("maxmemory_policy", "noeviction")) != "noeviction":
        return Finding(f"{found}, maxmemory-policy {policy}", "CONFIG SET maxmemory-policy noeviction: a queue must not lose jobs quietly")
    apart_s = time.time() - server_s[0] - server_s[1] / 1e6
    if abs(apart_s) > CLOCK_S:
        return Finding(f"{found}, its clock is {abs(apart_s):.1f} s off", "set the clocks of both machines by NTP", is_fatal=False)
    return Finding(found)


def _info(connection: redis.Redis) -> dict[str, Any]:
    return connection.info()


def _remedy(error: redis.RedisError, url: str) -> str:
    text = str(error).lower()
    if isinstance(error, redis.AuthenticationError) or "noauth" in text or "password" in text:
        return "the server wants another password: SILHOUETTE_REDIS_URL=redis://:PASSWORD@HOST:6379/0, or SILHOUETTE_REDIS_PASSWORD_FILE"
    if "ssl" in text or "certificate" in text:
        return "TLS failed: use redis:// for a server without it, or name the authority of a rediss:// one by SILHOUETTE_REDIS_CA_FILE"
    if url.startswith("redis://") and ("closed" in text or "reset" in text):
        return "the server may want TLS: try rediss://"
    return "start that server, or correct SILHOUETTE_REDIS_URL; without it a private server is used"


def check_store(settings: ServiceSettings) -> Finding:
    """Write, read back and delete an object, durably; and how much room there is."""
    where = settings.store_url or str(settings.store_dir)
    key = f"doctor/{uuid.uuid4().hex}"
    data = bytes(PROBE_BYTES)
    try:
        store = open_store(settings)
        started = time.perf_counter()
        store.put_bytes(key, data)
        took_s = time.perf_counter() - started
        is_same = store.get_bytes(key) == data
        store.delete(key)
        free_mib = store.free_bytes() >> 20
    except (OSError, SilhouetteError) as error:
        return Finding(f"{where}: {error}", _store_remedy(error, settings))
    found = f"{where}: 1 MiB made durable in {took_s * 1e3:.0f} ms, {free_mib} MiB free"
    if not is_same:
        return Finding(found, "what is read is not what was written: check the disk")
    if free_mib < settings.keep_free_mib:
        return Finding(found, f"make room: uploads leave {settings.keep_free_mib} MiB free (SILHOUETTE_KEEP_FREE_MIB) and are refused now")
    if took_s > SLOW_SYNC_S:
        return Finding(found, "put the store on a faster disk: every artifact waits for this", is_fatal=False)
    return Finding(found)


def _store_remedy(error: OSError | SilhouetteError, settings: ServiceSettings) -> str:
    if settings.store_url is not None and settings.store_url.startswith("s3:"):
        return S3_REMEDIES.get(str(error), S3_REMEDIES[UNAVAILABLE])
    if isinstance(error, StorageFullError):
        return "make room on its disk, or name another: SILHOUETTE_DATA_DIR, SILHOUETTE_STORE_URL"
    return "give the service's user a folder to write: SILHOUETTE_DATA_DIR, SILHOUETTE_STORE_URL"


def check_port(settings: ServiceSettings) -> Finding:
    """Whether the address can be listened on, or a service of ours is there already."""
    where = f"{settings.host} port {settings.port}"
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((settings.host, settings.port))
            listener.listen(1)
        except OSError as error:
            if error.errno == errno.EADDRINUSE and _is_ours(settings):
                return Finding(f"{where}: a silhouette service answers there")
            return Finding(f"{where}: {error.strerror}", "choose another: --port or SILHOUETTE_PORT, --host or SILHOUETTE_HOST")
    return Finding(f"{where} is free")


def _is_ours(settings: ServiceSettings) -> bool:
    host = "127.0.0.1" if settings.host == "0.0.0.0" else settings.host
    url = f"http://{f'[{host}]' if ':' in host else host}:{settings.port}/healthz"
    try:
        return bool(httpx.get(url, timeout=ANSWER_S).json() == {"status": "ok"})
    except (httpx.HTTPError, ValueError):
        return False


def check_access(settings: ServiceSettings) -> Finding:
    """Whether there is a key where one is needed."""
    fault = startup_fault(settings)
    if fault is not None:
        told, _, ways = fault.partition("\n")
        return Finding(told, " ".join(ways.split()))
    return Finding(f"as the settings want it for {settings.host}")
