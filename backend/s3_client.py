"""Requests to an S3 store: the library's calls with our errors, no secrets in them.

obstore's requests run in threads that a fork does not take along, and a forked child that asks anyway waits for ever. So a process
that has asked must not fork children that ask; one that tries gets a RuntimeError here.
"""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import timedelta
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from schemas.errors import NotFoundError, StorageFullError, StoreUnavailableError

if TYPE_CHECKING:
    from obstore.store import S3Store as Bucket

log = logging.getLogger(__name__)

QUICK_S = 3.0
"""Longest that one try of a small request may take, and after which it is not tried again: together twice as long at most."""
CONNECT_S = 2.0
STALL_S = 20.0
"""Longest that the body of an object may stand still."""
BULK_S = 3600.0
PART_BYTES = 8 << 20
"""Objects larger than this are sent in parts."""
PARTS_AT_ONCE = 4
DELETE_AT_ONCE = 500
NO_ROOM = re.compile(r"status code: 507|StorageFull|QuotaExceeded")
STATUS = re.compile(r"status code: (\d{3})")
CODE = re.compile(r"<Code>(\w{1,60})</Code>")
UNAVAILABLE = "The object store does not answer; try again in a moment."
REFUSED = "The object store refuses this service; its credentials or its bucket's policy are wrong."
NO_BUCKET = "The object store has no such bucket as this service is set to use."
SHA256 = "sha256"
"""Name of the metadata with the hash of an object that was stored from a file."""

_asking: list[int] = []


class ChangedError(Exception):
    """A conditional request found another version than it was about."""


class Meta(NamedTuple):
    """What a store says of an object. tag: entity tag; written: seconds since 1970."""

    key: str
    tag: str
    size: int
    written: float


@dataclass(frozen=True)
class S3Place:
    """Where objects are: a bucket, and a prefix without a slash at its ends. What is None comes from the usual `AWS_...` variables.

    endpoint: http(s)://host:port of a store that is not Amazon's. ca_file: PEM certificates to trust besides the library's own.
    """

    bucket: str
    prefix: str = ""
    endpoint: str | None = None
    region: str | None = None
    ca_file: Path | None = None

    def under(self, folder: str) -> S3Place:
        """A folder of it."""
        return replace(self, prefix=f"{self.prefix}/{folder}" if self.prefix else folder)


class S3Client:
    """Objects at a place. Every call raises StoreUnavailableError, writing ones StorageFullError."""

    def __init__(self, place: S3Place) -> None:
        self._place = place

    def get(self, key: str) -> tuple[bytes, str]:
        """(bytes, entity tag) of a small object. Raises NotFoundError."""
        import obstore

        with _told(key):
            found = obstore.get(self._quick, key)
            return bytes(found.bytes()), _tag(found.meta)

    def head(self, key: str) -> Meta | None:
        """What the store says of an object; None where there is none."""
        import obstore

        try:
            with _told(key):
                return _meta(obstore.head(self._quick, key))
        except NotFoundError:
            return None

    def download(self, key: str, tag: str, chunk_bytes: int = 4 << 20) -> tuple[str | None, Iterator[bytes]]:
        """(sha256 that it was stored with, bytes in pieces) of this version of an object. Raises ChangedError, NotFoundError."""
        import obstore

        with _told(key):
            found = obstore.get(self._bulk, key, options={"if_match": tag})
            return found.attributes.get(SHA256), _pieces(key, found.stream(chunk_bytes))

    def put(self, key: str, data: bytes) -> str:
        """Store an object; its entity tag."""
        return self._put(self._quick if len(data) <= PART_BYTES else self._bulk, key, data, "overwrite")

    def replace(self, key: str, data: bytes, tag: str | None) -> str:
        """Store a small object in place of this version of it, None: of none; its entity tag. Raises ChangedError."""
        return self._put(self._quick, key, data, "create" if tag is None else {"e_tag": tag})

    def _put(self, bucket: Bucket, key: str, data: bytes, mode: Any) -> str:
        import obstore

        with _told(key, writing=True):
            return str(obstore.put(bucket, key, data, mode=mode, use_multipart=False)["e_tag"])

    def put_file(self, key: str, source: Path, sha256: str) -> str:
        """Store a file, in parts when it is large; its entity tag. There is no object until the last part has come."""
        import obstore

        with _told(key, writing=True):
            sent = obstore.put(
                self._bulk,
                key,
                source,
                attributes={SHA256: sha256},
                chunk_size=PART_BYTES,
                max_concurrency=PARTS_AT_ONCE,
            )
        return str(sent["e_tag"])

    def delete(self, keys: Sequence[str]) -> None:
        """Remove objects, at most DELETE_AT_ONCE; those that are not there are no fault."""
        import obstore

        with _told(keys[0]):
            obstore.delete(self._quick, keys)

    def list(self, folder: str) -> Iterator[Meta]:
        """Objects under a folder (without slash at its end; empty: all), sorted."""
        import obstore

        with _told(folder):
            for page in obstore.list(self._quick, folder or None):
                yield from map(_meta, page)

    def folders(self, folder: str) -> tuple[set[str], set[str]]:
        """(folders, objects) directly in a folder, as paths from the place."""
        import obstore

        with _told(folder):
            found = obstore.list_with_delimiter(self._quick, folder or None)
            return set(found["common_prefixes"]), {str(meta["path"]) for meta in found["objects"]}

    @property
    def _quick(self) -> Bucket:
        _claim()
        return self._quick_bucket

    @property
    def _bulk(self) -> Bucket:
        _claim()
        return self._bulk_bucket

    @cached_property
    def _quick_bucket(self) -> Bucket:
        return _open(self._place, {"timeout": timedelta(seconds=QUICK_S)}, QUICK_S)

    @cached_property
    def _bulk_bucket(self) -> Bucket:
        return _open(self._place, {"timeout": timedelta(seconds=BULK_S), "read_timeout": timedelta(seconds=STALL_S)}, STALL_S)


def _claim() -> None:
    """Remember that this process asks. Raises RuntimeError in a child of one that has asked before it forked."""
    if not _asking:
        _asking.append(os.getpid())
    elif _asking[0] != os.getpid():
        raise RuntimeError("a process that had asked the object store forked, and its child asks: it would wait for ever")


def _open(place: S3Place, times: Mapping[str, timedelta], retry_s: float) -> Bucket:
    from obstore.store import S3Store as Bucket

    endpoint = (
        place.endpoint or os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or os.environ.get("AWS_ENDPOINT")
    )
    client: Any = {
        "connect_timeout": timedelta(seconds=CONNECT_S),
        "allow_http": bool(endpoint and endpoint.startswith("http://")),
        **times,
    }
    if place.ca_file is not None:
        client["root_certificate"] = place.ca_file.read_bytes()
    given: Any = {name: value for name, value in (("endpoint", endpoint), ("region", place.region)) if value}
    retries: Any = {
        "max_retries": 4,
        "retry_timeout": timedelta(seconds=retry_s),
        "backoff": {"init_backoff": timedelta(seconds=0.05), "max_backoff": timedelta(seconds=1.0), "base": 2},
    }
    return Bucket(place.bucket, prefix=place.prefix or None, client_options=client, retry_config=retries, **given)


def _pieces(key: str, stream: Iterator[bytes]) -> Iterator[bytes]:
    with _told(key):
        yield from stream


@contextmanager
def _told(key: str, *, writing: bool = False) -> Iterator[None]:
    """Make our errors of the library's. Its texts stay out of them and out of the log: a refusal quotes the request, key id included."""
    from obstore import exceptions

    try:
        yield
    except (exceptions.AlreadyExistsError, exceptions.PreconditionError):
        raise ChangedError from None
    except (FileNotFoundError, exceptions.NotFoundError) as error:
        if writing and "NoSuchKey" in str(error):  # the version that was to be replaced is gone
            raise ChangedError from None
        if writing or "NoSuchBucket" in str(error):
            log.error("object store: no such bucket")  # noqa: TRY400
            raise StoreUnavailableError(NO_BUCKET) from None
        raise NotFoundError("there is no such object", key=key) from None
    except (PermissionError, exceptions.BaseError) as error:
        raise _fault(error) from None


def _fault(error: Exception) -> StorageFullError | StoreUnavailableError:
    text = str(error)
    status, code = STATUS.search(text), CODE.search(text)
    log.warning("object store: %s", type(error).__name__, extra={"status": status and status[1], "code": code and code[1]})
    if NO_ROOM.search(text):
        return StorageFullError("the store has no room left")
    if code and code[1] == "NoSuchBucket":
        return StoreUnavailableError(NO_BUCKET)
    refused = bool(status and status[1] in ("401", "403"))
    return StoreUnavailableError(REFUSED if refused else UNAVAILABLE)


def _meta(found: Mapping[str, Any]) -> Meta:
    return Meta(str(found["path"]), _tag(found), int(found["size"]), found["last_modified"].timestamp())


def _tag(found: Mapping[str, Any]) -> str:
    return str(found["e_tag"])
