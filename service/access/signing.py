"""Addresses that work without a key until they expire: HMAC-SHA256 over method, path, query, expiry and key id.

The secret of the signature is made from the record of the key that signed, so that an address ends with its key, and with nothing kept.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import re
import time
from collections import Counter
from datetime import UTC, datetime
from urllib.parse import parse_qsl, quote, unquote, urlencode

from schemas.access import KeyRecord, Scope, SignedUrl, SignRequest
from schemas.artifacts import DOWNLOADS
from schemas.errors import ForbiddenError, InvalidRequestError

EXPIRES, KEY, SIGNATURE = "exp", "kid", "sig"
OURS = frozenset({EXPIRES, KEY, SIGNATURE})
PURPOSE = b"silhouette signed address 1"
"""Keeps the secret of signatures apart from anything else that may be made of a record."""

DOWNLOAD_NAMES = "|".join(map(re.escape, DOWNLOADS))
SIGNABLE = re.compile(
    r"/v1/meshes/[0-9a-f]{32}/"
    rf"((thumbnail|render)\.(png|webp|jpg)|turntable\.(png|webp)|(silhouette|accuracy)\.svg|artifacts/({DOWNLOAD_NAMES}))"
)
NOT_SIGNABLE = "Pictures, drawings and downloads of a mesh can be signed, without host and fragment: /v1/meshes/ID/thumbnail.webp?size=256"

Pairs = list[tuple[str, str]]


def sign(record: KeyRecord, wanted: SignRequest) -> SignedUrl:
    """The address with its signature. Raises InvalidRequestError for one that cannot be signed."""
    address, _, query = wanted.url.partition("?")
    path = unquote(address)
    if not SIGNABLE.fullmatch(path) or "#" in query:
        raise InvalidRequestError(NOT_SIGNABLE, field="url")
    pairs = parse_qsl(query, keep_blank_values=True)
    if repeated := _repeated(pairs):
        raise InvalidRequestError(f"{repeated} comes twice.", field="url")
    if signed := OURS & {name for name, _ in pairs}:
        raise InvalidRequestError(f"{min(signed)} belongs to an address that is signed already.", field="url")
    expires = int(time.time()) + wanted.expires_in_s
    if record.expires is not None:
        expires = min(expires, int(record.expires.timestamp()))
    pairs += [(EXPIRES, str(expires)), (KEY, record.id)]
    whole = urlencode([*pairs, (SIGNATURE, signature(record, path, pairs))])
    return SignedUrl(url=f"{quote(path)}?{whole}", expires=datetime.fromtimestamp(expires, UTC))


def signature(record: KeyRecord, path: str, pairs: Pairs) -> str:
    """URL-safe base64 without padding. path: decoded; pairs: decoded parameters with expiry and key id, in any order."""
    secret = hmac.digest(bytes.fromhex(record.secret_sha256), PURPOSE, hashlib.sha256)
    text = "\n".join(["GET", quote(path), urlencode(sorted(pairs))])
    return base64.urlsafe_b64encode(hmac.digest(secret, text.encode(), hashlib.sha256)).rstrip(b"=").decode()


def parse(query: str) -> tuple[Pairs, str] | None:
    """(parameters without the signature, the signature) of a query; None when it has none. Raises ForbiddenError."""
    pairs = parse_qsl(query, keep_blank_values=True)
    given = [value for name, value in pairs if name == SIGNATURE]
    if not given:
        return None
    if repeated := _repeated(pairs):
        raise ForbiddenError(f"The signature does not fit: {repeated} comes twice.", code="signature-wrong")
    return [pair for pair in pairs if pair[0] != SIGNATURE], given[0]


def key_of(pairs: Pairs) -> str:
    """The id of the key that is said to have signed; empty when none is."""
    return dict(pairs).get(KEY, "")


def check(record: KeyRecord | None, path: str, pairs: Pairs, given: str) -> int:
    """When the address expires, seconds since 1970. Raises ForbiddenError for one that is not good, or not any more."""
    if not SIGNABLE.fullmatch(path):
        raise ForbiddenError("This address takes a key, not a signature.", code="signature-wrong")
    if record is None or Scope.READ not in record.scopes:  # whoever has a token can compute signatures, whatever its scopes
        raise ForbiddenError("The key that signed this address has been revoked, or may not read.", code="signature-wrong")
    if not hmac.compare_digest(signature(record, path, pairs).encode(), given.encode()):
        raise ForbiddenError("The signature does not fit: the address is not as it was signed.", code="signature-wrong")
    expires = int(dict(pairs)[EXPIRES])  # it is ours: the signature covers it
    if expires <= time.time():
        raise ForbiddenError("This address has expired.", code="signature-expired")
    return expires


def without_signature(pairs: Pairs) -> bytes:
    """The query as it is for who answers it."""
    return urlencode([pair for pair in pairs if pair[0] not in OURS]).encode()


def _repeated(pairs: Pairs) -> str | None:
    return next((name for name, times in Counter(name for name, _ in pairs).items() if times > 1), None)
