"""Who a request is from, for taking turns."""

from __future__ import annotations

from fastapi import Request


def owner_of(request: Request) -> str:
    """The client's address: requests that come through one proxy share it, unless the server is told to trust what the proxy says."""
    return "" if request.client is None else request.client.host
