"""Where a request comes from, as far as that tells one client from another."""

from __future__ import annotations

from ipaddress import IPv6Address, IPv6Network, ip_address

from starlette.types import Scope as Connection

NETWORK_BITS = 64  # of an IPv6 address: what one client is given, who then chooses the rest at will


def address_of(connection: Connection) -> str:
    """The client's IPv4 address, or the network of its IPv6 address; empty when it is not known."""
    host = "" if connection.get("client") is None else str(connection["client"][0])
    try:
        address = ip_address(host)
    except ValueError:
        return host
    if not isinstance(address, IPv6Address):
        return host
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(IPv6Network((address, NETWORK_BITS), strict=False))
