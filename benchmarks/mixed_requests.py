"""What clients ask of a service that is in use: a table of kinds of requests, and how often each comes."""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.http_load import Request

THUMBNAIL = "thumbnail"
"""Kind of the thumbnails that the bar is about: 256 pixels, asked for before."""

LEAVES_AFTER_S = (0.002, 0.08)
JSON_BODY = {"Content-Type": "application/json"}
SVG, BINARY = "image/svg+xml", "application/octet-stream"
EFFECTS: Sequence[Mapping[str, Any]] = (
    {"shading": {"mode": "gooch"}},
    {"shading": {"mode": "depth"}},
    {"shading": {"mode": "flat"}},
    {"shading": {"mode": "matcap"}},
    {"lines": {"method": "fattened", "charcoal": True}},
)
LINES: Sequence[Mapping[str, Any]] = (
    {"lines": {"method": "edge_mesh", "ridge": {}}},
    {"lines": {"method": "wireframe"}},
    {"lines": {"method": "translated"}},
    {"lines": {"method": "fattened", "silhouette": {"width": 3.0}}},
    {"lines": {"method": "strokes"}, "shading": {"fill": "none"}},
)


@dataclass(frozen=True)
class Known:
    """What the clients know of a service. meshes: ids of meshes that stay. tags: path -> entity tag. upload: bytes of a small PLY."""

    meshes: Sequence[str]
    tags: Mapping[str, str]
    upload: bytes

    def mesh(self, chance: random.Random) -> str:
        """The address of one of the meshes."""
        return f"/v1/meshes/{chance.choice(self.meshes)}"


Make = Callable[[Known, random.Random], Request]


def thumbnail_paths(meshes: Sequence[str]) -> list[str]:
    """Those of the bar."""
    return [f"/v1/meshes/{mesh}/thumbnail.png?size=256" for mesh in meshes]


def mixed(known: Known, seed: int = 0) -> Iterator[Request]:
    """Requests without end, the same for the same seed."""
    chance = random.Random(seed)
    makes, weights = zip(*MIX, strict=True)
    while True:
        yield chance.choices(makes, weights)[0](known, chance)


def _thumbnail(known: Known, chance: random.Random) -> Request:
    return Request(chance.choice(thumbnail_paths(known.meshes)), THUMBNAIL)


def _other_thumbnail(known: Known, chance: random.Random) -> Request:
    size, suffix = chance.choice([(64, "webp"), (128, "webp"), (128, "jpg"), (512, "png")])
    return Request(f"{known.mesh(chance)}/thumbnail.{suffix}?size={size}", "other thumbnail")


def _unchanged(known: Known, chance: random.Random) -> Request:
    path = chance.choice(list(known.tags))
    return Request(path, "not modified", headers={"If-None-Match": known.tags[path]}, expected=frozenset({304}))


def _view(side: int, suffix: str = "png", **query: str) -> Make:
    """A picture that nobody has asked for before."""
    said = "".join(f" {value}" for value in query.values())
    kind = f"{side}{said}" if suffix == "png" else f"{side}{said} {suffix}"

    def make(known: Known, chance: random.Random) -> Request:
        more = "".join(f"&{name}={value}" for name, value in query.items())
        return Request(f"{known.mesh(chance)}/render.{suffix}?width={side}&height={side}&{_around(chance)}{more}", kind)

    return make


def _drawn(kind: str, choices: Sequence[Mapping[str, Any]]) -> Make:
    def make(known: Known, chance: random.Random) -> Request:
        return _posted(f"{known.mesh(chance)}/render", kind, {"camera": _orbit(chance), **chance.choice(choices)}, "image/png")

    return make


def _silhouette(kind: str, media: str, **fields: Any) -> Make:
    def make(known: Known, chance: random.Random) -> Request:
        return _posted(f"{known.mesh(chance)}/silhouette", kind, {"camera": _orbit(chance), **fields}, media)

    return make


def _scene(known: Known, chance: random.Random) -> Request:
    objects = [{"mesh": chance.choice(known.meshes), "transform": {"translate": [2.0 * n, 0.0, 0.0]}} for n in range(3)]
    return _posted("/v1/scenes/render", "scene", {"objects": objects, "camera": _orbit(chance)}, "image/png")


def _turntable(known: Known, chance: random.Random) -> Request:
    path = f"{known.mesh(chance)}/turntable.webp?frames=8&width=128&height=128&{_around(chance)}"
    return Request(path, "turntable")


def _download(known: Known, chance: random.Random) -> Request:
    name = chance.choice(["hull.glb", "original.glb", "normal.png", "hull.glb?faces=300"])
    return Request(f"{known.mesh(chance)}/artifacts/{name}", "download")


def _told(known: Known, chance: random.Random) -> Request:
    path = chance.choice([known.mesh(chance), "/v1/meshes?limit=20", "/readyz", "/healthz"])
    return Request(path, "status")


def _metrics(known: Known, chance: random.Random) -> Request:
    return Request("/metrics", "metrics")


def _once(known: Known, chance: random.Random) -> Request:
    path = f"/v1/render?name=once.ply&width=256&height=256&{_around(chance)}"
    return Request(path, "once", "POST", {"Content-Type": BINARY}, known.upload)


def _leaves(known: Known, chance: random.Random) -> Request:
    asked = _view(1024)(known, chance)
    return Request(asked.path, "leaves", expected=frozenset({0}), leaves_after_s=chance.uniform(*LEAVES_AFTER_S))


def _wrong(known: Known, chance: random.Random) -> Request:
    mesh = known.mesh(chance)
    asked, status = chance.choice(
        [
            (Request(f"/v1/meshes/{'0' * 32}/thumbnail.png"), 404),
            (Request(f"{mesh}/render.png?width=0"), 422),
            (Request(f"{mesh}/render.bmp"), 404),
            (Request(f"{mesh}/render", method="POST", headers=JSON_BODY, body=b"{"), 422),
            (Request(f"{mesh}/render", method="POST", headers=JSON_BODY | {"Accept": "text/css"}, body=b"{}"), 406),
            (Request(f"{mesh}/thumbnail.png", method="POST"), 405),
            (Request("/v1/meshes?name=a.exe", method="POST", body=b"MZ"), 415),
        ]
    )
    return Request(asked.path, "wrong", asked.method, asked.headers, asked.body, frozenset({status}))


def _posted(path: str, kind: str, body: Mapping[str, Any], media: str) -> Request:
    return Request(path, kind, "POST", JSON_BODY | {"Accept": media}, json.dumps(body).encode())


def _orbit(chance: random.Random) -> dict[str, Any]:
    return {"orbit": {"azimuth_deg": round(chance.uniform(0, 360), 3), "elevation_deg": round(chance.uniform(-60, 60), 3)}}


def _around(chance: random.Random) -> str:
    return f"azimuth={chance.uniform(0, 360):.3f}&elevation={chance.uniform(-60, 60):.3f}"


MIX: Sequence[tuple[Make, float]] = (
    (_thumbnail, 30),
    (_other_thumbnail, 6),
    (_unchanged, 10),
    (_view(256, source="clipped"), 12),
    (_view(512), 8),
    (_view(512, "webp"), 2),
    (_view(512, antialias="msaa"), 2),
    (_view(512, antialias="ssaa"), 1),
    (_view(512, antialias="line"), 1),
    (_view(1024, "jpg"), 2),
    (_view(2048), 0.5),
    (_drawn("effect", EFFECTS), 3),
    (_drawn("lines", LINES), 4),
    (_silhouette("silhouette json", "application/json"), 4),
    (_silhouette("silhouette binary", BINARY, contours=False), 1),
    (_silhouette("drawing", SVG), 2),
    (_silhouette("visible lines", SVG, kinds=["silhouette", "ridge"], visible_only=True), 1.5),
    (_scene, 1.5),
    (_turntable, 0.3),
    (_download, 2),
    (_told, 4),
    (_metrics, 0.5),
    (_once, 0.5),
    (_leaves, 2),
    (_wrong, 3),
)
"""Kinds and their shares, of 100 and a little."""
