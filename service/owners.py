"""Who a request is from, for taking turns."""

from __future__ import annotations

from fastapi import Request

from service.access.addresses import address_of
from service.access.caller import caller_of


def owner_of(request: Request) -> str:
    """The key it came with, or the client's address."""
    key = caller_of(request).key
    if key is not None:
        return f"key {key.id}"
    return address_of(request.scope)
