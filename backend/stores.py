"""Which object store the settings name."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote, urlsplit

from backend.local_store import LocalStore
from backend.settings import BackendSettings
from backend.store import Store

CACHE = "cache"


def open_store(settings: BackendSettings) -> Store:
    """The store of `settings.store_url`; nothing is asked of another machine yet."""
    url = urlsplit(settings.store_url or "")
    if url.scheme != "s3":
        return LocalStore(settings.store_dir)
    from backend.s3_client import S3Place
    from backend.s3_store import S3Store

    place = S3Place(url.netloc, unquote(url.path).strip("/"), settings.store_endpoint, settings.store_region, settings.store_ca_file)
    return S3Store(place, Path(settings.data_dir).absolute() / CACHE, settings.store_cache_mib << 20)
