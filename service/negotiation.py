"""Which of the media types a resource has does a client want: `Accept` with weights, RFC 9110 section 12.5.1."""

from __future__ import annotations

from collections.abc import Sequence

from starlette.exceptions import HTTPException

from schemas.render import ImageFormat

IMAGE_TYPES = {
    ImageFormat.PNG: "image/png",
    ImageFormat.WEBP: "image/webp",
    ImageFormat.JPEG: "image/jpeg",
    ImageFormat.RAW: "application/octet-stream",
}
"""Media type of each encoding, in the service's own order of preference."""

JSON = "application/json"

SUFFIXES = {"png": ImageFormat.PNG, "webp": ImageFormat.WEBP, "jpg": ImageFormat.JPEG}
"""File name endings of image addresses."""


def choose(accept: str | None, offered: Sequence[str]) -> str:
    """The media type of `offered` (the server's order of preference) that `accept` weighs highest.

    No header accepts anything. Raises HTTPException 406 when nothing offered is acceptable.
    """
    if not accept or not accept.strip():
        return offered[0]
    ranges = [_media_range(item) for item in accept.split(",") if item.strip()]
    weights = [_weight(media, ranges) for media in offered]
    best = max(weights)
    if best <= 0.0:
        raise HTTPException(status_code=406)
    return offered[weights.index(best)]


def image_format(accept: str | None) -> ImageFormat:
    """The image encoding a client wants by its Accept header; PNG when it does not care."""
    media = choose(accept, list(IMAGE_TYPES.values()))
    return next(form for form, name in IMAGE_TYPES.items() if name == media)


def wants_json(accept: str | None) -> bool:
    """Whether a client that could have a picture would rather have JSON. Raises HTTPException 406 when it wants neither."""
    return choose(accept, [*IMAGE_TYPES.values(), JSON]) == JSON


def _media_range(item: str) -> tuple[str, float]:
    name, *parameters = (part.strip().lower() for part in item.split(";"))
    weight = 1.0
    for parameter in parameters:
        key, _, value = parameter.partition("=")
        if key.strip() == "q":
            try:
                weight = min(max(float(value), 0.0), 1.0)
            except ValueError:
                weight = 0.0
    return name, weight


def _weight(media: str, ranges: list[tuple[str, float]]) -> float:
    """Weight of a media type: that of the most specific range it falls in."""
    family = media.split("/", 1)[0] + "/*"
    for wanted in (media, family, "*/*"):
        found = [weight for name, weight in ranges if name == wanted]
        if found:
            return max(found)
    return 0.0
