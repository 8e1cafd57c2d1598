"""What a request shows to be let in: a token as bearer, as `X-API-Key`, or as the password that a browser asks for."""

from __future__ import annotations

import base64
from collections.abc import Collection

from starlette.datastructures import Headers

from service.access.scopes import READING_METHODS

REALM = "silhouette"
NO_KEY = "This service needs an API key: Authorization: Bearer sil_... or X-API-Key: sil_..."


def token_of(headers: Headers) -> str | None:
    """The token that a request carries, however; None when it carries none."""
    scheme, _, value = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return value.strip()
    if scheme.lower() == "basic":
        return _basic_token(value.strip())
    return headers.get("x-api-key")


def challenges(headers: Headers) -> list[str]:
    """Each a `WWW-Authenticate` of its own, for a request that needs a key. Only a browser on our own pages is told of a password.

    It asks for one then. Chromium reads one challenge of a header, its first.
    """
    bearer = f'Bearer realm="{REALM}"'
    is_own_page = headers.get("sec-fetch-site") in ("none", "same-origin") or "text/html" in headers.get("accept", "")
    return [bearer, f'Basic realm="{REALM}", charset="UTF-8"'] if is_own_page else [bearer]


def is_foreign_write(method: str, headers: Headers, allowed_origins: Collection[str]) -> bool:
    """Whether a browser sends this for a page of somebody else's, with what it would add by itself: nothing, or a kept password.

    Such a page cannot set the headers of a key, but it can make a browser post. An allowed origin may do that where no password is sent.
    """
    scheme = headers.get("authorization", "").partition(" ")[0].lower()
    origin = headers.get("origin")
    if method in READING_METHODS or scheme == "bearer" or "x-api-key" in headers or origin is None:
        return False
    if scheme != "basic" and not {origin, "*"}.isdisjoint(allowed_origins):
        return False
    site = headers.get("sec-fetch-site")
    return site not in ("same-origin", "none") if site is not None else origin.partition("://")[2] != headers.get("host")


def _basic_token(encoded: str) -> str:
    """The password of a user of any name; the name itself where there is no password, as `curl -u TOKEN:` sends it."""
    try:
        name, _, password = base64.b64decode(encoded, validate=True).decode().partition(":")
    except ValueError:  # no base64, or no UTF-8
        return ""
    return password or name
