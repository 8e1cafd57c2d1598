"""Takes the bytes of a mesh off the wire and onto the disk: counted, hashed and bounded as they arrive, never whole in memory."""

from __future__ import annotations

import hashlib
from collections.abc import AsyncIterator, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from anyio import to_thread
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from schemas.errors import InvalidRequestError, MeshRejectedError, StorageFullError, TooLargeError, UnknownFormatError
from schemas.mesh import PreprocessOptions
from service.access.caller import Caller
from service.draining import drain

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

WRITE_BYTES = 1 << 20
"""Bytes that go to the disk at a time, in a thread: about a millisecond of hashing."""

FIELD_BYTES = 1 << 12
"""Largest form field that is not the file."""

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
    content_type, parameters = parse_options_header(request.headers.get("content-type", ""))
    form = content_type == b"multipart/form-data"
    if not form:  # what can be refused before the bytes come is
        described = _described(query, content_type.decode("latin-1"))
    body, kept = _Body(request), dict[str, str]()
    try:
        _check_room(int(request.headers.get("content-length", "0")), limits)
        spool = _Spool(file, limits.max_bytes)
        if form:
            fields = await _receive_form(body, parameters.get(b"boundary", b""), spool)
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


class _Body:
    """The body of a request as it arrives; knows whether it ended, so that a refusal can swallow the rest."""

    def __init__(self, request: Request) -> None:
        self._request = request
        self._ended = False

    async def chunks(self) -> AsyncIterator[bytes]:
        while not self._ended:
            message = await self._request.receive()
            if message["type"] == "http.disconnect":
                self._ended = True
                raise ClientDisconnect
            self._ended = not message.get("more_body", False)
            yield message.get("body", b"")

    async def drain(self) -> None:
        if not self._ended:
            self._ended = True
            await drain(self._request.receive)


class _Spool:
    """A file being written: gathers, hashes and counts."""

    def __init__(self, file: BinaryIO, max_bytes: int) -> None:
        self.file = file
        self.max_bytes = max_bytes
        self.digest = hashlib.sha256()
        self.size = 0
        self.pending = bytearray()

    async def write(self, data: bytes) -> None:
        self.size += len(data)
        if self.size > self.max_bytes:
            raise _too_large(self.max_bytes)
        self.pending += data
        if len(self.pending) >= WRITE_BYTES:
            await self.flush()

    async def flush(self) -> None:
        data, self.pending = bytes(self.pending), bytearray()
        await to_thread.run_sync(self._put, data)

    def _put(self, data: bytes) -> None:
        self.digest.update(data)
        self.file.write(data)
        self.file.flush()


class _Form:
    """Callbacks of the multipart parser: fields are kept, the bytes of `file` are handed on chunk by chunk."""

    def __init__(self) -> None:
        self.fields: dict[str, str] = {}
        self.file_chunks: list[bytes] = []
        self.has_file = False
        self._name = ""
        self._value = bytearray()
        self._header = [b"", b""]
        self._disposition = b""

    def on_part_begin(self) -> None:
        self._disposition, self._value = b"", bytearray()

    def on_header_field(self, data: bytes, start: int, end: int) -> None:
        self._header[0] += data[start:end]

    def on_header_value(self, data: bytes, start: int, end: int) -> None:
        self._header[1] += data[start:end]

    def on_header_end(self) -> None:
        if self._header[0].lower() == b"content-disposition":
            self._disposition = self._header[1]
        self._header = [b"", b""]

    def on_headers_finished(self) -> None:
        _, options = parse_options_header(self._disposition)
        self._name = options.get(b"name", b"").decode("utf-8", "replace")
        if self._name == "file":
            if self.has_file:
                raise InvalidRequestError("One mesh an upload: the form has more than one file.", field="file")
            self.has_file = True
            if b"filename" in options:
                self.fields.setdefault("name", options[b"filename"].decode("utf-8", "replace"))

    def on_part_data(self, data: bytes, start: int, end: int) -> None:
        if self._name == "file":
            self.file_chunks.append(data[start:end])
            return
        self._value += data[start:end]
        if len(self._value) > FIELD_BYTES or len(self.fields) > 16:
            raise TooLargeError("A field of the form is too large.", limit=FIELD_BYTES)

    def on_part_end(self) -> None:
        if self._name != "file":
            self.fields[self._name] = self._value.decode("utf-8", "replace")


async def _receive_form(body: _Body, boundary: bytes, spool: _Spool) -> dict[str, str]:
    form = _Form()
    names = ("part_begin", "header_field", "header_value", "header_end", "headers_finished", "part_data", "part_end")
    try:
        parser = MultipartParser(boundary, {f"on_{name}": getattr(form, f"on_{name}") for name in names})  # type: ignore[arg-type]
        async for chunk in body.chunks():
            parser.write(chunk)
            for piece in form.file_chunks:
                await spool.write(piece)
            form.file_chunks.clear()
        parser.finalize()
    except FormParserError as error:
        raise HTTPException(status_code=400) from error
    if not form.has_file:
        raise InvalidRequestError("The form has no field `file` with the mesh.", field="file")
    return form.fields


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


def _check_room(declared: int, limits: UploadLimits) -> None:
    if declared > limits.max_bytes + FIELD_BYTES:
        raise _too_large(limits.max_bytes)
    if declared > limits.room_bytes:
        raise StorageFullError("The store has no room for this upload.")


def _too_large(max_bytes: int) -> TooLargeError:
    return TooLargeError(f"The upload is larger than the {max_bytes / 2**20:g} MiB that are taken here (max_upload_mib).", limit=max_bytes)
