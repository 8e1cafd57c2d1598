"""Keys, what they allow, and signed addresses (names are final)."""

from __future__ import annotations

from datetime import datetime
from enum import StrEnum
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

NAME_CHARS = 80
MOST_DAYS = 3660
MOST_SIGNED_S = 366 * 86_400
DEFAULT_SIGNED_S = 3600


class Scope(StrEnum):
    """What a key may do; none includes another."""

    READ = "read"
    WRITE = "write"
    ADMIN = "admin"


class KeyLimits(BaseModel):
    """Limits of one key, each only ever tighter than the service's own; None leaves the service's."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    requests_per_minute: int | None = Field(None, ge=1, description="requests a minute")
    concurrent_renders: int | None = Field(None, ge=1, description="pictures and silhouettes in work at once")
    max_pixels: int | None = Field(None, ge=1, description="largest picture, width times height")
    max_faces: int | None = Field(None, ge=1, description="faces of the largest mesh")
    max_upload_mib: int | None = Field(None, ge=1, description="largest upload, MiB")


Scopes = Annotated[list[Scope], Field(min_length=1, description="what the key may do", examples=[["read"]])]
Name = Annotated[str, Field(min_length=1, max_length=NAME_CHARS, pattern=r"^[^\x00-\x1f\x7f]+$", description="for people")]


class NewKey(BaseModel):
    """A key that is to be made."""

    model_config = ConfigDict(extra="forbid")

    name: Name = Field(examples=["shop window"])
    scopes: Scopes = [Scope.READ]
    expires_in_days: float | None = Field(None, gt=0, le=MOST_DAYS, description="days that it lasts; for ever if not given")
    limits: KeyLimits = KeyLimits()


class KeyInfo(BaseModel):
    """A key without its secret, which only whoever made it has seen."""

    id: str
    name: str
    scopes: list[Scope]
    created: datetime
    expires: datetime | None = None
    limits: KeyLimits = KeyLimits()


class KeyRecord(KeyInfo):
    """A key as the store has it.

    secret_sha256: hex. The secret is 256 random bits, which cannot be guessed from their hash however fast that is: no slow hash, as
    passwords need, and no salt.
    """

    secret_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")

    def info(self) -> KeyInfo:
        """The record without the hash."""
        return KeyInfo.model_validate(self.model_dump(exclude={"secret_sha256"}))


class MadeKey(KeyInfo):
    """A key that was just made; the token is shown this once."""

    token: str


class KeyPage(BaseModel):
    """All keys, by id."""

    keys: list[KeyInfo]


class SignRequest(BaseModel):
    """An address that is to work without a key for a while."""

    model_config = ConfigDict(extra="forbid")

    url: str = Field(
        max_length=4096,
        description="address of a picture, a drawing or a download, from its first slash on",
        examples=["/v1/meshes/3f2a917c5be04d1f8a6c0d9e2b7f4a11/thumbnail.webp?size=256"],
    )
    expires_in_s: int = Field(DEFAULT_SIGNED_S, ge=1, le=MOST_SIGNED_S, description="seconds from now")


class SignedUrl(BaseModel):
    """The address with `exp`, `kid` and `sig`, and when it ends: with its key at the latest."""

    url: str
    expires: datetime
