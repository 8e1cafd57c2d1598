"""Keys, and addresses that work without one for a while."""

from __future__ import annotations

from anyio import to_thread
from fastapi import APIRouter, Request, Response

from schemas.access import KeyInfo, KeyPage, MadeKey, NewKey, SignedUrl, SignRequest
from schemas.errors import InvalidRequestError
from service.access.caller import caller_of
from service.access.signing import sign
from service.caching import NOT_KEPT
from service.routes.documented import problems
from service.state import Parts

router = APIRouter(prefix="/v1", tags=["access"])


@router.get("/keys", response_model_exclude_none=True)
def list_keys(parts: Parts) -> KeyPage:
    """All keys, without their secrets."""
    return KeyPage(keys=[record.info() for record in parts.access.ring.stored.all()])


@router.post("/keys", status_code=201, response_model_exclude_none=True, responses=problems(422, 507))
async def add_key(wanted: NewKey, parts: Parts, response: Response) -> MadeKey:
    """Make a key. The token is in this answer and nowhere else, not even in the store."""
    made = await to_thread.run_sync(parts.access.ring.stored.add, wanted)
    parts.access.ring.forget()
    response.headers["Cache-Control"] = NOT_KEPT
    return made


@router.get("/keys/{key_id}", response_model_exclude_none=True, responses=problems(404))
def key_info(key_id: str, parts: Parts) -> KeyInfo:
    """One key, without its secret."""
    return parts.access.ring.stored.get(key_id).info()


@router.delete("/keys/{key_id}", status_code=204, response_class=Response, responses=problems(404))
async def revoke_key(key_id: str, parts: Parts) -> Response:
    """Revoke a key, and all addresses that it signed: here at once, in other processes of the service within seconds."""
    await to_thread.run_sync(parts.access.ring.stored.revoke, key_id)
    parts.access.ring.forget()
    return Response(status_code=204)


@router.post("/sign", responses=problems(422))
async def sign_address(wanted: SignRequest, request: Request, response: Response) -> SignedUrl:
    """An address of a picture, drawing or download that works without a key until it expires, for a page that everyone sees.

    It is bound to every parameter and to this key: another size is another address, and revoking the key ends it.
    """
    key = caller_of(request).key
    if key is None:
        raise InvalidRequestError("This service asks for no key: the address works as it is.", field="url")
    response.headers["Cache-Control"] = NOT_KEPT
    return sign(key, wanted)
