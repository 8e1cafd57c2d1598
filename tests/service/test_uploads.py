"""What happens to bytes on their way from the wire to the disk."""

import asyncio
import hashlib
import io

import pytest
from starlette.requests import ClientDisconnect, Request

from schemas.errors import InvalidRequestError, MeshRejectedError, StorageFullError, TooLargeError
from service.forms import WRITE_BYTES
from service.uploads import UploadLimits, receive_upload

PLENTY = UploadLimits(max_bytes=1 << 30, room_bytes=1 << 30)


def upload(chunks, *, query="name=a.ply", headers=(), limits=PLENTY, leaves=False):
    """(Upload, its bytes, how many chunks were read) of a request whose body arrives in these chunks."""
    left = list(chunks)
    read = 0

    async def receive():
        nonlocal read
        if not left:
            return {"type": "http.disconnect"} if leaves else await asyncio.Future()
        read += 1
        return {"type": "http.request", "body": left.pop(0), "more_body": bool(left) or leaves}

    scope = {"type": "http", "query_string": query.encode(), "headers": [(k.encode(), v.encode()) for k, v in headers]}
    file = io.BytesIO()
    received = asyncio.run(receive_upload(Request(scope, receive), file, limits))
    return received, file.getvalue(), read


def form(*parts: bytes) -> bytes:
    return b"".join(b"--sep\r\n" + part + b"\r\n" for part in parts) + b"--sep--\r\n"


FORM = (("content-type", "multipart/form-data; boundary=sep"),)
FILE_HEAD = b'Content-Disposition: form-data; name="file"; filename="ball.stl"\r\n\r\n'


@pytest.mark.parametrize("size", [1, WRITE_BYTES - 1, WRITE_BYTES, 2 * WRITE_BYTES + 7])
@pytest.mark.parametrize("chunk", [1 << 16, 1 << 22])
def test_bytes_arrive_whole_counted_and_hashed(size, chunk):
    body = bytes(i % 251 for i in range(1009)) * (size // 1009 + 1)
    body = body[:size]
    received, written, _ = upload([body[i : i + chunk] for i in range(0, size, chunk)])
    assert written == body
    assert (received.size, received.sha256) == (size, hashlib.sha256(body).hexdigest())


def test_form_gives_the_same_bytes_however_it_is_cut():
    content = bytes(range(256)) * 40 + b"\r\n--se\r\n--sepa"
    body = form(b'Content-Disposition: form-data; name="texels"\r\n\r\n128', FILE_HEAD + content)
    for step in (1, 7, 1000, len(body)):
        received, written, _ = upload([body[i : i + step] for i in range(0, len(body), step)], query="", headers=FORM)
        assert written == content
        assert (received.name, received.extension, received.options.texels) == ("ball.stl", "stl", 128)


def test_form_with_two_files_is_refused():
    with pytest.raises(InvalidRequestError) as refused:
        upload([form(FILE_HEAD + b"a", FILE_HEAD + b"b")], query="", headers=FORM)
    assert refused.value.where["field"] == "file"


def test_endless_form_field_is_refused():
    with pytest.raises(TooLargeError):
        upload([form(b'Content-Disposition: form-data; name="texels"\r\n\r\n' + bytes(1 << 16))], query="", headers=FORM)


def test_declared_size_over_the_room_is_refused_and_the_rest_is_swallowed():
    chunks = [bytes(1000)] * 5
    with pytest.raises(StorageFullError):
        upload(chunks, headers=(("content-length", "5000"),), limits=UploadLimits(max_bytes=1 << 30, room_bytes=4999))


def test_declared_size_over_the_limit_is_refused_before_it_is_read():
    with pytest.raises(TooLargeError) as refused:
        upload([b"x"], headers=(("content-length", "100000"),), limits=UploadLimits(max_bytes=10, room_bytes=1 << 30))
    assert refused.value.where["limit"] == 10


def test_size_that_is_not_declared_is_counted():
    with pytest.raises(TooLargeError):
        upload([bytes(100)] * 3, limits=UploadLimits(max_bytes=250, room_bytes=1 << 30))


def test_empty_upload_is_refused():
    with pytest.raises(MeshRejectedError, match="empty"):
        upload([b""])


def test_client_that_leaves_ends_the_upload():
    with pytest.raises(ClientDisconnect):
        upload([b"half of it"], leaves=True)
