"""Bodies as they come off the wire: multipart forms with one file, which goes to the disk as it arrives and is never whole in memory."""

from __future__ import annotations

import hashlib
from collections.abc import AsyncIterator, Mapping
from typing import BinaryIO, TypeVar

from anyio import to_thread
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.types import Scope

from schemas.errors import InvalidRequestError, TooLargeError
from service.draining import drain

Model = TypeVar("Model", bound=BaseModel)

FORM = "multipart/form-data"
REQUEST = "request"
"""Form field of a request as JSON."""

WRITE_BYTES = 1 << 20
"""Bytes that go to the disk at a time, in a thread: about a millisecond of hashing."""

FIELD_BYTES, MOST_FIELDS = 1 << 12, 16
"""Largest form field that is not the file, unless told otherwise, and how many there may be."""


def content_type_of(headers: Mapping[str, str]) -> tuple[str, bytes]:
    """(media type, boundary of a form) that the headers of a request name."""
    content_type, parameters = parse_options_header(headers.get("content-type", ""))
    return content_type.decode("latin-1"), parameters.get(b"boundary", b"")


def parsed(model: type[Model], text: str) -> Model:
    """A request that a field of a form holds as JSON. Raises RequestValidationError, as for a body."""
    try:
        return model.model_validate_json(text)
    except ValidationError as error:
        raise RequestValidationError([{**fault, "loc": ("body", *fault["loc"])} for fault in error.errors()]) from error


def is_form(scope: Scope) -> bool:
    """Whether the body of a request is a form with files."""
    return content_type_of(Headers(scope=scope))[0] == FORM


class Body:
    """The body of a request as it arrives; knows whether it ended, so that a refusal can swallow the rest."""

    def __init__(self, request: Request) -> None:
        self._request = request
        self._ended = False

    async def chunks(self) -> AsyncIterator[bytes]:
        """What comes, as it comes. Raises ClientDisconnect."""
        while not self._ended:
            message = await self._request.receive()
            if message["type"] == "http.disconnect":
                self._ended = True
                raise ClientDisconnect
            self._ended = not message.get("more_body", False)
            yield message.get("body", b"")

    async def drain(self) -> None:
        """Swallow the rest, within bounds."""
        if not self._ended:
            self._ended = True
            await drain(self._request.receive)


class Spool:
    """A file being written: gathers, hashes and counts."""

    def __init__(self, file: BinaryIO, max_bytes: int) -> None:
        self.file = file
        self.max_bytes = max_bytes
        self.digest = hashlib.sha256()
        self.size = 0
        self.pending = bytearray()

    async def write(self, data: bytes) -> None:
        """Take some more. Raises TooLargeError."""
        self.size += len(data)
        if self.size > self.max_bytes:
            raise too_large(self.max_bytes)
        self.pending += data
        if len(self.pending) >= WRITE_BYTES:
            await self.flush()

    async def flush(self) -> None:
        """Put what was gathered into the file."""
        data, self.pending = bytes(self.pending), bytearray()
        await to_thread.run_sync(self._put, data)

    def _put(self, data: bytes) -> None:
        self.digest.update(data)
        self.file.write(data)
        self.file.flush()


class _Form:
    """Callbacks of the multipart parser: fields are kept, the bytes of the file are handed on chunk by chunk."""

    def __init__(self, file_field: str, field_bytes: int) -> None:
        self.fields: dict[str, str] = {}
        self.file_chunks: list[bytes] = []
        self.file_name: str | None = None
        self._file_field, self._field_bytes = file_field, field_bytes
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
        if self._name == self._file_field:
            if self.file_name is not None:
                raise InvalidRequestError(f"One file a request: the form has `{self._name}` more than once.", field=self._name)
            self.file_name = options.get(b"filename", b"").decode("utf-8", "replace")

    def on_part_data(self, data: bytes, start: int, end: int) -> None:
        if self._name == self._file_field:
            self.file_chunks.append(data[start:end])
            return
        self._value += data[start:end]
        if len(self._value) > self._field_bytes or len(self.fields) > MOST_FIELDS:
            raise TooLargeError("A field of the form is too large, or there are too many.", limit=self._field_bytes)

    def on_part_end(self) -> None:
        if self._name != self._file_field:
            self.fields[self._name] = self._value.decode("utf-8", "replace")


async def receive_form(
    body: Body, boundary: bytes, spool: Spool, file_field: str, field_bytes: int = FIELD_BYTES
) -> tuple[dict[str, str], str | None]:
    """(fields, name of the file): the bytes of the field `file_field` go into the spool. No name where there is no such field.

    field_bytes: that another field may have. Raises InvalidRequestError, TooLargeError, ClientDisconnect, and HTTPException 400 for what is
    no form.
    """
    form = _Form(file_field, field_bytes)
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
    return form.fields, form.file_name


def too_large(max_bytes: int) -> TooLargeError:
    """The refusal of a file over the limit."""
    return TooLargeError(f"The upload is larger than the {max_bytes / 2**20:g} MiB that are taken here (max_upload_mib).", limit=max_bytes)
