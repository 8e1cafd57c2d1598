"""A silhouette service from Python.

with Client("http://127.0.0.1:8000") as client:
    mesh = client.wait(client.upload("bunny.ply").id)
    Path("bunny.png").write_bytes(client.render(mesh.id, camera={"orbit": {"azimuth_deg": 40}}))
    edges = client.silhouette(mesh.id)["edges"]
"""

from __future__ import annotations

import json
import os
import ssl
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import httpx
from pydantic_core import to_jsonable_python

from client.errors import MeshFailedError, UnreachableError, error_of
from schemas.access import DEFAULT_SIGNED_S, KeyInfo, KeyPage, MadeKey, SignedUrl
from schemas.ladder import AccuracyReport
from schemas.mesh import MeshInfo, MeshPage, MeshStatus, Problem
from schemas.plan import PlanReport
from schemas.render import ImageFormat
from schemas.sequence import SequenceFormat

if TYPE_CHECKING:  # numpy is imported by the calls about vertices alone: it takes a quarter of what a command without any takes to start
    from client.positions import Original, Positions

DEFAULT_URL = "http://127.0.0.1:8000"
KEY_VARIABLE = "SILHOUETTE_API_KEY"
SEQUENCE_TIMEOUT = httpx.Timeout(3600.0, connect=5.0)
"""A sequence is answered when all of it is drawn."""
CHUNK_BYTES = 1 << 18
SILHOUETTE_TYPES = {"json": "application/json", "svg": "image/svg+xml", "binary": "application/octet-stream", "dxf": "image/vnd.dxf"}

ENCODING = ("encode", "write")
"""Passes that make a file of pixels."""

UploadProgress = Callable[[int, int], None]
"""Called with (bytes sent, bytes in all)."""

WaitProgress = Callable[[MeshInfo], None]
"""Called with each change of the mesh."""


@dataclass(frozen=True)
class Picture:
    """A rendered picture and what the service says of it.

    body: encoded bytes. passes: (name, milliseconds) in order, encoding last. plan: the passes that ran. accuracy: rung and error.
    """

    body: bytes
    media_type: str
    passes: tuple[tuple[str, float], ...]
    plan: str
    accuracy: str

    @property
    def frame_ms(self) -> float:
        """Milliseconds from camera to pixels, encoding apart."""
        return sum(ms for name, ms in self.passes if name not in ENCODING)


class Client:
    """Talks to one service. Every call raises a `client.errors.ServiceError` when it does not succeed.

    key: the API key that the service asks for; that of the environment's SILHOUETTE_API_KEY if not given.
    """

    def __init__(self, base_url: str = DEFAULT_URL, timeout_s: float = 60.0, key: str | None = None) -> None:
        self.base_url = base_url.rstrip("/")
        key = key or os.environ.get(KEY_VARIABLE)
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        tls = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT) if self.base_url.startswith("http://") else True
        # where there is no TLS the authorities it trusts are not read, which takes longer than most calls
        self._http = httpx.Client(base_url=self.base_url, timeout=httpx.Timeout(timeout_s, connect=5.0), headers=headers, verify=tls)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def upload(self, path: str | Path, *, name: str | None = None, on_progress: UploadProgress | None = None, **options: Any) -> MeshInfo:
        """Upload a file; `options` are those of `schemas.mesh.PreprocessOptions`. Returns at once, with the mesh queued."""
        path = Path(path)
        size = path.stat().st_size
        headers = {"Content-Type": "application/octet-stream", "Content-Length": str(size)}
        query = {"name": name or path.name, **options}
        answer = self._send("POST", "/v1/meshes", params=query, content=_chunks(path, size, on_progress), headers=headers)
        return MeshInfo.model_validate_json(answer.content)

    def wait(self, mesh_id: str, *, on_progress: WaitProgress | None = None, timeout_s: float = 3600.0) -> MeshInfo:
        """Return when the mesh is ready. Raises MeshFailedError when it failed, TimeoutError when the time is up."""
        deadline = time.monotonic() + timeout_s
        info = self.info(mesh_id)
        if on_progress:
            on_progress(info)
        while info.status in (MeshStatus.QUEUED, MeshStatus.PROCESSING):
            for change in self._events(mesh_id):
                if change is not None:
                    info = change
                    if on_progress:
                        on_progress(info)
                if time.monotonic() > deadline:
                    raise TimeoutError(f"{info.name} was not ready after {timeout_s:g} seconds")
        if info.status is MeshStatus.FAILED:
            raise MeshFailedError(info.error or Problem(title="Failed", status=422, detail="The mesh could not be processed."))
        return info

    def info(self, mesh_id: str) -> MeshInfo:
        """Everything the service says of a mesh."""
        return MeshInfo.model_validate_json(self._send("GET", f"/v1/meshes/{mesh_id}").content)

    def list(self, limit: int | None = None) -> Iterator[MeshInfo]:
        """Meshes, newest first, page by page as they are taken; at most `limit`."""
        link: str | None = f"/v1/meshes?limit={min(limit or 100, 100)}"
        left = limit
        while link is not None and left != 0:
            page = MeshPage.model_validate_json(self._send("GET", link).content)
            taken = page.meshes[:left]
            yield from taken
            left = None if left is None else left - len(taken)
            link = page.next

    def delete(self, mesh_id: str) -> None:
        """Remove a mesh and everything made from it."""
        self._send("DELETE", f"/v1/meshes/{mesh_id}")

    def render(self, mesh_id: str, *, positions: Positions | None = None, **fields: Any) -> bytes:
        """An encoded picture, PNG unless `format` says otherwise; `fields` are those of `schemas.render.RenderRequest`.

        positions: of the mesh's vertices, (v, 3) model units in the order of `original`; where they are if not given.
        """
        return self.picture(mesh_id, positions=positions, **fields).body

    def picture(self, mesh_id: str, *, positions: Positions | None = None, **fields: Any) -> Picture:
        """A picture with its timings, plan and accuracy."""
        return _picture(self._send_moved(f"/v1/meshes/{mesh_id}/render", positions, {"format": ImageFormat.PNG, **fields}, {}))

    def frames(self, mesh_id: str, *, positions: Positions | None = None, **fields: Any) -> Picture:
        """Pictures one after the other, an animated WebP unless `format` says otherwise; `fields` are those of
        `schemas.sequence.SequenceRequest`. positions: (k, v, 3) for k frames, or (v, 3) for all.
        """
        fields = {"format": SequenceFormat.WEBP, **fields}
        return _picture(self._send_moved(f"/v1/meshes/{mesh_id}/frames", positions, fields, {}, timeout=SEQUENCE_TIMEOUT))

    def original(self, mesh_id: str) -> Original:
        """The mesh's own vertices, in the order that `positions` come in, and faces."""
        from client.positions import original_of

        return original_of(self.download(mesh_id, "original.glb"))

    def render_scene(self, objects: Sequence[Any], **fields: Any) -> bytes:
        """An encoded picture of several meshes: `objects` as `schemas.scene.SceneObject`, `fields` the rest of SceneRequest."""
        return self.scene_picture(objects, **fields).body

    def scene_picture(self, objects: Sequence[Any], **fields: Any) -> Picture:
        """A picture of several meshes with its timings, plan and accuracy."""
        body = _body({"format": ImageFormat.PNG, "objects": list(objects), **fields})
        return _picture(self._send("POST", "/v1/scenes/render", json=body))

    def thumbnail(self, mesh_id: str, size: int = 256, suffix: str = "png") -> bytes:
        """A fitted three-quarter view; suffix png, webp or jpg."""
        return self._send("GET", f"/v1/meshes/{mesh_id}/thumbnail.{suffix}", params={"size": size}).content

    def silhouette(self, mesh_id: str, **fields: Any) -> dict[str, Any]:
        """The silhouette as `schemas.render.Silhouette` describes it; `fields` are those of `schemas.render.SilhouetteRequest`, and
        `positions` as for `render`.
        """
        return dict(json.loads(self.silhouette_document(mesh_id, "json", **fields)))

    def silhouette_document(self, mesh_id: str, form: str = "svg", *, positions: Positions | None = None, **fields: Any) -> bytes:
        """The silhouette as a document: form json, svg, dxf or binary."""
        headers = {"Accept": SILHOUETTE_TYPES[form]}
        return self._send_moved(f"/v1/meshes/{mesh_id}/silhouette", positions, fields, headers).content

    def picture_once(self, path: str | Path, *, repair: str = "auto", **fields: Any) -> Picture:
        """A picture of a file that the service does not keep: nothing is prepared; `fields` as for `render`."""
        return _picture(self._send_file("/v1/render", path, {"repair": repair}, {"format": ImageFormat.PNG, **fields}, {}))

    def silhouette_once(self, path: str | Path, form: str = "svg", *, repair: str = "auto", **fields: Any) -> bytes:
        """The silhouette of a file that the service does not keep, as `silhouette_document`."""
        headers = {"Accept": SILHOUETTE_TYPES[form]}
        return self._send_file("/v1/silhouette", path, {"repair": repair}, fields, headers).content

    def plan(self, mesh_id: str, **fields: Any) -> PlanReport:
        """What `render` would do with these fields, why, and what it is predicted to cost; nothing is drawn."""
        answer = self._send("POST", f"/v1/meshes/{mesh_id}/render", params={"explain": "true"}, json=_body(fields))
        return PlanReport.model_validate_json(answer.content)

    def accuracy(self, mesh_id: str, size: int | None = None, device: str | None = None) -> AccuracyReport:
        """What every way of drawing the mesh has of errors, and costs; size, device: see the API."""
        answer = self._send("GET", f"/v1/meshes/{mesh_id}/accuracy", params=_given(size=size, device=device))
        return AccuracyReport.model_validate_json(answer.content)

    def accuracy_plot(self, mesh_id: str, size: int | None = None, device: str | None = None) -> bytes:
        """The same as a plot, SVG."""
        return self._send("GET", f"/v1/meshes/{mesh_id}/accuracy.svg", params=_given(size=size, device=device)).content

    def download(self, mesh_id: str, artifact: str = "hull.glb") -> bytes:
        """A file made from the mesh: hull.glb, original.glb, normal.png or color.png."""
        return self._send("GET", f"/v1/meshes/{mesh_id}/artifacts/{artifact}").content

    def hull(self, mesh_id: str, faces: int | None = None, side: str = "outer") -> bytes:
        """A hull of at most so many faces as binary glTF, without maps; side `outer` encloses the mesh, `inner` is enclosed by it."""
        query = {"side": side} if faces is None else {"side": side, "faces": str(faces)}
        return self._send("GET", f"/v1/meshes/{mesh_id}/artifacts/hull.glb", params=query).content

    def sign(self, address: str, expires_in_s: int = DEFAULT_SIGNED_S) -> str:
        """The whole address of a picture, drawing or download (`/v1/meshes/ID/thumbnail.webp?size=256`), good without a key for a while."""
        answer = self._send("POST", "/v1/sign", json={"url": address, "expires_in_s": expires_in_s})
        return self.base_url + SignedUrl.model_validate_json(answer.content).url

    def keys(self) -> Sequence[KeyInfo]:
        """The keys of the service; needs the scope admin, as the next two."""
        return KeyPage.model_validate_json(self._send("GET", "/v1/keys").content).keys

    def add_key(self, name: str, **fields: Any) -> MadeKey:
        """Make a key; `fields` are the rest of `schemas.access.NewKey`. Its token is in the answer alone."""
        return MadeKey.model_validate_json(self._send("POST", "/v1/keys", json=_body({"name": name, **fields})).content)

    def revoke_key(self, key_id: str) -> None:
        """Revoke a key and all that it signed."""
        self._send("DELETE", f"/v1/keys/{key_id}")

    def _send(self, method: str, path: str, **arguments: Any) -> httpx.Response:
        with self._reaching():
            answer = self._http.request(method, path, **arguments)
        if answer.is_error:
            raise error_of(answer)
        return answer

    def _send_moved(
        self, address: str, positions: Positions | None, fields: dict[str, Any], headers: dict[str, str], **arguments: Any
    ) -> httpx.Response:
        """Post a request, in a form with positions where there are any."""
        if positions is None:
            return self._send("POST", address, json=_body(fields), headers=headers, **arguments)
        from client.positions import opened

        request = (None, json.dumps(_body(fields)), "application/json")
        with opened(positions) as file:
            return self._send("POST", address, files={"request": request, "positions": ("positions", file)}, headers=headers, **arguments)

    def _send_file(
        self, address: str, path: str | Path, query: dict[str, str], fields: dict[str, Any], headers: dict[str, str]
    ) -> httpx.Response:
        """Post a form of a file and a request."""
        path = Path(path)
        request = (None, json.dumps(_body(fields)), "application/json")
        with path.open("rb") as file:
            return self._send("POST", address, params=query, files={"file": (path.name, file), "request": request}, headers=headers)

    def _events(self, mesh_id: str) -> Iterator[MeshInfo | None]:
        """The mesh at each change, None at each sign of life, until it is ready or failed. Raises NotFoundError when deleted."""
        with self._reaching(), self._http.stream("GET", f"/v1/meshes/{mesh_id}/events") as answer:
            if answer.is_error:
                answer.read()
                raise error_of(answer)
            for line in answer.iter_lines():
                if line.startswith('data: {"id"'):
                    yield MeshInfo.model_validate_json(line.removeprefix("data: "))
                elif line == "event: deleted":
                    self.info(mesh_id)
                elif line.startswith(":"):
                    yield None

    @contextmanager
    def _reaching(self) -> Iterator[None]:
        try:
            yield
        except httpx.ConnectError:
            raise UnreachableError(self.base_url, "the connection was refused") from None
        except httpx.TimeoutException:
            raise UnreachableError(self.base_url, "it took too long") from None
        except httpx.TransportError:
            raise UnreachableError(self.base_url, "the connection broke") from None
        except httpx.InvalidURL:
            raise UnreachableError(self.base_url, "that is no address") from None


def _given(**query: Any) -> dict[str, str]:
    """Query parameters without those that are None."""
    return {name: str(value) for name, value in query.items() if value is not None}


def _body(fields: dict[str, Any]) -> Any:
    """Fields as JSON; models of `schemas` may stand in them. The service checks them, and its word counts."""
    return to_jsonable_python(fields, exclude_none=True)


def _chunks(path: Path, size: int, on_progress: UploadProgress | None) -> Iterator[bytes]:
    sent = 0
    with path.open("rb") as file:
        while chunk := file.read(CHUNK_BYTES):
            yield chunk
            sent += len(chunk)
            if on_progress:
                on_progress(sent, size)


def _picture(answer: httpx.Response) -> Picture:
    headers = answer.headers
    return Picture(
        answer.content,
        headers.get("Content-Type", ""),
        _passes(headers.get("Server-Timing", "")),
        headers.get("X-Plan", ""),
        headers.get("X-Accuracy", ""),
    )


def _passes(header: str) -> tuple[tuple[str, float], ...]:
    """`a;dur=1.5, b;dur=2` -> (("a", 1.5), ("b", 2.0))."""
    found = []
    for entry in header.split(","):
        name, _, rest = entry.strip().partition(";")
        if rest.startswith("dur="):
            found.append((name, float(rest.removeprefix("dur="))))
    return tuple(found)
