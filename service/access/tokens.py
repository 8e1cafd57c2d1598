"""What a key's holder sends, and how it is held against the record: `sil_<id>_<secret>`."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from datetime import UTC, datetime, timedelta

from schemas.access import KeyRecord, MadeKey, NewKey

PREFIX = "sil"
"""Begins every token, so that one that leaked is found by a search for it."""

KEY_ID = re.compile(r"[0-9a-f]{16}")
TOKEN = re.compile(rf"{PREFIX}_({KEY_ID.pattern})_([A-Za-z0-9_-]{{43}})")
SECRET_BYTES = 32


def make_key(wanted: NewKey) -> tuple[KeyRecord, MadeKey]:
    """A new key: the record to store, and what its maker gets, with the token."""
    key_id, secret = secrets.token_hex(8), secrets.token_urlsafe(SECRET_BYTES)
    now = datetime.now(UTC)
    expires = None if wanted.expires_in_days is None else now + timedelta(days=wanted.expires_in_days)
    record = KeyRecord(
        id=key_id,
        name=wanted.name,
        scopes=sorted(set(wanted.scopes)),
        created=now,
        expires=expires,
        limits=wanted.limits,
        secret_sha256=_hash(secret),
    )
    return record, MadeKey(token=f"{PREFIX}_{key_id}_{secret}", **record.info().model_dump())


def parse_token(token: str) -> tuple[str, str] | None:
    """(key id, secret) of a token, None for what is none."""
    found = TOKEN.fullmatch(token)
    return None if found is None else (found[1], found[2])


def is_secret_of(record: KeyRecord, secret: str) -> bool:
    """Whether the secret is the record's, in a time that does not tell how nearly."""
    return hmac.compare_digest(record.secret_sha256, _hash(secret))


def has_expired(record: KeyRecord) -> bool:
    """Whether the key's time is over."""
    return record.expires is not None and record.expires <= datetime.now(UTC)


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()
