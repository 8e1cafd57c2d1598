"""Who a request comes from, as far as routes need to know: what it may ask for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import cast

from fastapi import Request
from starlette.types import Scope as Connection

from schemas.access import KeyLimits, KeyRecord
from schemas.errors import InvalidRequestError

STATE = "caller"


@dataclass(frozen=True)
class Caller:
    """The key that a request came with, itself or by its signature; none where the service is open to everyone.

    limits: the tighter of the key's and the service's. signed_until: seconds since 1970 where it was a signature.
    """

    key: KeyRecord | None = None
    limits: KeyLimits = field(default_factory=KeyLimits)
    signed_until: int | None = None

    def check_picture(self, width: int, height: int) -> None:
        """Raise InvalidRequestError for a picture of more pixels than this caller may have."""
        most = self.limits.max_pixels
        if most is not None and width * height > most:
            whose = "with this key" if self.key is not None and self.key.limits.max_pixels == most else "here"
            raise InvalidRequestError(
                f"The picture has {width * height} pixels; {most} are the most that are drawn {whose} (max_pixels).",
                field="width",
                limit=most,
            )


def caller_of(request: Request) -> Caller:
    """The caller of a request, as the guard found it."""
    return cast(Caller, request.scope["state"][STATE])


def set_caller(connection: Connection, caller: Caller) -> None:
    """Say for all further parts who a request comes from."""
    connection["state"] = {**connection.get("state", {}), STATE: caller}


def tightest(own: KeyLimits, general: KeyLimits) -> KeyLimits:
    """The lower of each limit; None only where both have none."""
    pairs = {name: (getattr(own, name), getattr(general, name)) for name in KeyLimits.model_fields}
    return KeyLimits(**{name: min((x for x in both if x is not None), default=None) for name, both in pairs.items()})
