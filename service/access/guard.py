"""Pure ASGI middleware: finds out who asks, lets in who may, and counts."""

from __future__ import annotations

import time
from collections.abc import Collection
from contextlib import ExitStack
from typing import cast

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from schemas.access import KeyRecord
from schemas.errors import ForbiddenError, SilhouetteError, UnauthorizedError
from service.access import signing
from service.access.addresses import address_of
from service.access.caller import Caller, set_caller, tightest
from service.access.credentials import NO_KEY, challenges, is_foreign_write, token_of
from service.access.policy import Access
from service.access.quotas import OverRateError
from service.access.scopes import OPEN, is_picture, scope_of
from service.access.tokens import has_expired, is_secret_of, parse_token
from service.draining import drain
from service.errors import error_response
from service.request_record import current_request

UNKNOWN_KEY = "This API key is not known here; it may have been revoked."
EXPIRED_KEY = "This API key has expired."
FOREIGN = "Another site's page may not do this: list its origin in SILHOUETTE_CORS_ORIGINS, or send a key in a header."


class AccessGuard:
    """Answers 401, 403 and 429 itself; what passes has its `Caller` in the connection's state, and no signature in its query."""

    def __init__(self, app: ASGIApp, allowed_origins: Collection[str]) -> None:
        self.app = app
        self.allowed_origins = allowed_origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        if scope["type"] != "http" or scope["path"] in OPEN:
            await self.app(scope, receive, send)
            return
        access = cast(Access, scope["app"].state.services.access)
        with ExitStack() as held:
            headers: dict[str, str] = {}
            try:
                caller, scope = await self._recognised(access, dict(scope))
                if caller.key is not None:
                    _note(caller.key)
                await _count(access, caller, scope, held, headers)
            except SilhouetteError as error:
                await _refuse(error, headers, scope, receive, send)
                return
            set_caller(scope, caller)
            await self.app(scope, receive, _marked(send, caller, headers))

    async def _recognised(self, access: Access, scope: Scope) -> tuple[Caller, Scope]:
        """Who asks, and the request without a signature. Raises UnauthorizedError, ForbiddenError."""
        headers, method = Headers(scope=scope), scope["method"]
        parsed = signing.parse(scope["query_string"].decode("latin-1")) if method == "GET" else None
        if parsed is not None:
            pairs, given = parsed
            record = await access.ring.find(signing.key_of(pairs))
            until = signing.check(record, scope["path"], pairs, given)
            assert record is not None
            scope["query_string"] = signing.without_signature(pairs)
            return Caller(record, tightest(record.limits, access.limits), until), scope
        if is_foreign_write(method, headers, self.allowed_origins):
            raise ForbiddenError(FOREIGN)
        if await access.is_open():
            return Caller(limits=access.open_limits), scope
        record = await _holder(access, token_of(headers))
        needed = scope_of(method, scope["path"])
        if needed not in record.scopes:
            raise ForbiddenError(f"This key lacks the scope {needed.value}.", code="missing-scope", scope=needed.value)
        return Caller(record, tightest(record.limits, access.limits)), scope


async def _holder(access: Access, token: str | None) -> KeyRecord:
    """The record of the key that a token is of. Raises UnauthorizedError."""
    if token is None:
        raise UnauthorizedError(NO_KEY)
    parts = parse_token(token)
    record = None if parts is None else await access.ring.find(parts[0])
    if parts is None or record is None or not is_secret_of(record, parts[1]):
        raise UnauthorizedError(UNKNOWN_KEY)
    if has_expired(record):
        raise UnauthorizedError(EXPIRED_KEY)
    return record


def _note(key: KeyRecord) -> None:
    if (record := current_request()) is not None:
        record.key = key.id


async def _count(access: Access, caller: Caller, scope: Scope, held: ExitStack, headers: dict[str, str]) -> None:
    """Count the request, and the picture that it wants as long as `held` lasts; what the client learns goes into `headers`.

    Raises QuotaError.
    """
    owner = f"address {address_of(scope)}" if caller.key is None else caller.key.id
    if caller.limits.requests_per_minute is not None:
        try:
            counted = await access.requests.count(owner, caller.limits.requests_per_minute)
        except OverRateError as error:
            headers |= error.counted.headers()
            raise
        headers |= counted.headers()
    if is_picture(scope["path"]):
        held.enter_context(access.renders.one_more(owner, caller.limits.concurrent_renders))


async def _refuse(error: SilhouetteError, headers: dict[str, str], scope: Scope, receive: Receive, send: Send) -> None:
    asked = Headers(scope=scope)
    response = error_response(error)
    response.headers.update(headers)
    if isinstance(error, UnauthorizedError):
        for challenge in challenges(asked):
            response.headers.append("WWW-Authenticate", challenge)
    if "expect" not in asked:  # a client that asks before it sends has sent nothing yet
        await drain(receive)
    await response(scope, receive, send)


def _marked(send: Send, caller: Caller, headers: dict[str, str]) -> Send:
    """Sends answers with `headers`, and so that no cache keeps them longer or for more people than it may."""

    async def send_marked(message: Message) -> None:
        if message["type"] == "http.response.start":
            answer = MutableHeaders(scope=message)
            answer.update(headers)
            if caller.key is not None:
                answer["Cache-Control"] = _cache_control(answer.get("cache-control", ""), caller.signed_until)
            if (caller.key is None or caller.signed_until is not None) and answer.get("content-type", "").startswith("image/"):
                answer["Cross-Origin-Resource-Policy"] = "cross-origin"  # it may stand in anybody's page
        await send(message)

    return send_marked


def _cache_control(given: str, signed_until: int | None) -> str:
    """What caches may do with an answer that is not for everyone: by key, only the client's own; by signature, all until it expires."""
    parts = [part.strip() for part in given.split(",") if part.strip()]
    if "no-store" in parts:
        return given
    if signed_until is None:
        return ", ".join(["private", *(part for part in parts if part not in ("public", "private"))])
    if not any(part.startswith("max-age=") for part in parts):
        return given or "private, no-cache"
    left = max(0, signed_until - int(time.time()))
    aged = [f"max-age={min(left, int(part.removeprefix('max-age=')))}" if part.startswith("max-age=") else part for part in parts]
    return ", ".join([*(part for part in aged if part != "immutable"), "must-revalidate"])
