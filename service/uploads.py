"""Takes the bytes of a mesh off the wire and onto the disk: counted, hashed and bounded as they arrive, never whole in memory."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError

from schemas.errors import InvalidRequestError, MeshRejectedError, StorageFullError, TooLargeError, UnknownFormatError
from schemas.mesh import PreprocessOptions
from service.access.caller import Caller
from service.forms import FIELD_BYTES, Body, Spool, content_type_of, is_form, receive_form, too_large

CONTENT_TYPES = {
    "model/stl": "stl",
    "application/sla": "stl",
    "application/vnd.ms-pki.stl": "stl",
    "model/obj": "obj",
    "model/ply": "ply",
    "application/ply": "ply",
    "model/off": "off",
    "model/gltf-binary": "glb",
    "model/3mf": "3mf",
    "application/vnd.ms-package.3dmanufacturing-3dmodel+xml": "3mf",
}
"""Media types that name a format where the file's name does not."""

EXTENSIONS = ("stl", "obj", "ply", "off", "glb", "3mf")
"""Formats the workers load."""

FILE = "file"
"""Form field of the mesh."""

NAME_CHARS = 200


@dataclass(frozen=True)
class UploadLimits:
    """Bounds of an upload: the most bytes, the bytes the store can still give away, and the most faces; None: what a worker takes."""

    max_bytes: int
    room_bytes: int
    max_faces: int | None = None

    def of(self, caller: Caller) -> UploadLimits:
        """The same for one caller, who may have tighter ones."""
        own = caller.limits
        max_bytes = self.max_bytes if own.max_upload_mib is None else min(self.max_bytes, own.max_upload_mib * 2**20)
        return UploadLimits(max_bytes, self.room_bytes, own.max_faces)


@dataclass(frozen=True)
class Upload:
    """A received upload; its bytes are in the file it was received into. `extension` without dot, lower case.

    beside: form fields that say something else than how to process it.
    """

    sha256: str
    size: int
    name: str
    extension: str
    options: PreprocessOptions
    beside: Mapping[str, str] = field(default_factory=dict)


async def receive_upload(request: Request, file: BinaryIO, limits: UploadLimits, beside: Collection[str] = ()) -> Upload:
    """Stream the mesh of a request (raw body or multipart field `file`) into `file`, open for writing.

    Options come from the query, and from form fields where there is a form; what has a name in `beside` is none.
    Raises TooLargeError, StorageFullError, UnknownFormatError, MeshRejectedError (nothing in it), InvalidRequestError,
    RequestValidationError and HTTPException 400.
    """
    query = {name: value for name, value in request.query_params.items() if name not in beside}
    content_type, boundary = content_type_of(request.headers)
    form = is_form(request.scope)
    if not form:  # what can be refused before the bytes come is
        described = _described(query, content_type)
    body, kept = Body(request), dict[str, str]()
    try:
        check_room(int(request.headers.get("content-length", "0")), limits)
        spool = Spool(file, limits.max_bytes)
        if form:
            fields, file_name = await receive_form(body, boundary, spool, FILE)
            if file_name is None:
                raise InvalidRequestError("The form has no field `file` with the mesh.", field=FILE)
            fields = ({"name": file_name} if file_name else {}) | fields
            kept = {name: value for name, value in fields.items() if name in beside}
            described = _described(query | {name: value for name, value in fields.items() if name not in kept}, "")
        else:
            async for chunk in body.chunks():
                await spool.write(chunk)
        await spool.flush()
    except (TooLargeError, StorageFullError):
        await body.drain()
        raise
    if spool.size == 0:
        raise MeshRejectedError("The upload is empty: it has no bytes.", code="empty-file")
    name, extension, options = described
    return Upload(spool.digest.hexdigest(), spool.size, name, extension, options.narrowed(limits.max_faces), kept)


def _described(fields: Mapping[str, str], content_type: str) -> tuple[str, str, PreprocessOptions]:
    """(name, extension, options) from the fields of a request; faults name the field."""
    options = {key: value for key, value in fields.items() if key != "name"}
    try:
        checked = PreprocessOptions.model_validate(options)
    except ValidationError as error:
        raise RequestValidationError(error.errors()) from error
    name = _plain_name(fields.get("name", ""))
    extension = Path(name).suffix.lstrip(".").lower() or CONTENT_TYPES.get(content_type, "")
    known = ", ".join(EXTENSIONS)
    if not extension:
        raise UnknownFormatError(f"The upload does not say its format: add ?name= with one of the endings {known}.", field="name")
    if extension not in EXTENSIONS:
        raise UnknownFormatError(f"No loader knows the ending .{extension}; the formats are {known}.", field="name")
    return name or f"mesh.{extension}", extension, checked


def _plain_name(name: str) -> str:
    """The last part of a path, printable, of bounded length: a name is for people and never opens a file."""
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    return "".join(c for c in last if c.isprintable()).strip()[-NAME_CHARS:]


def check_room(declared: int, limits: UploadLimits) -> None:
    """Refuse what declares to be larger than it may be. Raises TooLargeError, StorageFullError."""
    if declared > limits.max_bytes + FIELD_BYTES:
        raise too_large(limits.max_bytes)
    if declared > limits.room_bytes:
        raise StorageFullError("The store has no room for this upload.")
