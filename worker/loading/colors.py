"""Colours of a parsed file as corner colours, corner texture coordinates and one texture. Runs only in the limited child.

Several textures are packed into one. In it coordinates cannot repeat, so a face that reaches over the border of its own
texture even after a whole-number shift takes the texture's colours at its three corners instead.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from schemas.conventions import F4, F8, U1, Array
from worker.loading.limits import LoadLimits
from worker.loading.parsed import Piece
from worker.loading.srgb import encoded, multiplied, resized

NO_COLOR = (200, 200, 200, 255)
"""Of a part without any colour beside parts that have one; the default of `schemas.render.Shading`."""
MAX_PIXELS = 1 << 27
"""Pixels of a picture that is decoded at all."""
GAP = 16
"""Texels about each packed texture, filled with its border so that filtering never mixes two, by means of 8 x 8 texels either."""


def collect(pieces: list[Piece], kind: str, limits: LoadLimits) -> tuple[dict[str, Array], dict[str, Any]]:
    """(tensors of artifacts.APPEARANCE over all corners in order, notes); no tensors where the file has no colour."""
    linear = kind == "glb"
    colors = [_corner_colors(p, linear) for p in pieces]
    # of the formats read here only GLB carries its pictures; elsewhere the reader makes some up
    images, use, broken = _images(pieces) if kind == "glb" else ([], [None] * len(pieces), 0)
    notes = {"unreadable_textures": broken} if broken else {}
    if not images:
        if all(c is None for c in colors):
            return {}, notes
        return {"corner_color": _joined(pieces, colors, NO_COLOR)}, notes
    tensors: dict[str, Array] = {}
    textures = [_shrunk(image, limits.max_texture_px) for image in images]
    uv = [_corner_uv(p) if k is not None else np.zeros((len(p.faces), 3, 2), np.float32) for p, k in zip(pieces, use, strict=True)]
    if len(textures) == 1 and all(k == 0 for k in use):
        tensors["texture"] = textures[0]
        if any(c is not None for c in colors):
            tensors["corner_color"] = _joined(pieces, colors, (255, 255, 255, 255))
        tensors["corner_uv"] = np.concatenate(uv)
        return tensors, notes
    tinted = [c if c is not None or k is not None else _constant(p, NO_COLOR) for p, c, k in zip(pieces, colors, use, strict=True)]
    corner_color = _joined(pieces, tinted, (255, 255, 255, 255))
    tensors["texture"], tensors["corner_uv"] = _packed(textures, use, uv, corner_color, limits.max_texture_px)
    tensors["corner_color"] = corner_color
    return tensors, notes


def _constant(piece: Piece, color: tuple[int, int, int, int]) -> U1:
    return np.full((len(piece.faces), 3, 4), color, np.uint8)


def _joined(pieces: list[Piece], colors: list[U1 | None], default: tuple[int, int, int, int]) -> U1:
    return np.concatenate([_constant(p, default) if c is None else c for p, c in zip(pieces, colors, strict=True)])


def _corner_colors(piece: Piece, linear: bool) -> U1 | None:
    """(f, 3, 4) u1 sRGB, or None where the piece says nothing about its colour apart from a texture."""
    raw, visual = piece.raw, piece.raw.get("visual")
    vertex = raw.get("vertex_colors")
    if vertex is None and visual is not None:
        vertex = visual.vertex_attributes.get("color")
    face = raw.get("face_colors")
    material = getattr(visual, "material", None)
    factor = getattr(material, "baseColorFactor", None) if linear else None
    color: U1 | None = raw.get("corner_colors")
    if vertex is not None and len(vertex) == len(piece.vertices):
        color = _as_bytes(np.asarray(vertex), linear)[piece.faces]
    elif face is not None and len(face) == len(piece.faces):
        color = np.repeat(_as_bytes(np.asarray(face), linear)[:, None], 3, axis=1)
    if factor is not None:
        tint = _as_bytes(np.asarray(factor).reshape(1, -1), linear)
        base = _constant(piece, (255, 255, 255, 255)) if color is None else color
        color = multiplied(base, tint[0])
    if color is not None and linear and getattr(material, "alphaMode", None) in (None, "OPAQUE"):
        color[..., 3] = 255
    return color


def _as_bytes(values: Array, linear: bool) -> U1:
    """(n, 3 or 4) colours of any type, linear or sRGB, as (n, 4) u1 sRGB."""
    if values.dtype.kind == "f":
        unit = np.nan_to_num(values.astype(np.float64))
        # OBJ and PLY do not say whether their floats end at 1 or at 255
        unit = np.clip(unit / 255.0 if not linear and unit.max(initial=0.0) > 1.0 else unit, 0.0, 1.0)
    else:
        full = {"i1": 127, "i2": 32767, "u2": 65535}.get(values.dtype.str[1:], 255)
        unit = np.clip(values.astype(np.float64) / full, 0.0, 1.0)
    if unit.shape[1] == 3:
        unit = np.column_stack([unit, np.ones(len(unit))])
    if linear:
        return np.column_stack([encoded(unit[:, :3]), np.rint(unit[:, 3] * 255.0).astype(np.uint8)])
    return np.rint(unit * 255.0).astype(np.uint8)


def _images(pieces: list[Piece]) -> tuple[list[Any], list[int | None], int]:
    """(decoded pictures, the picture of each piece, how many cannot be read)."""
    known: dict[tuple[int, bool], int | None] = {}
    decoded: list[Any] = []
    use: list[int | None] = []
    for piece in pieces:
        visual = piece.raw.get("visual")
        material = getattr(visual, "material", None)
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        uv = getattr(visual, "uv", None)
        if image is None or uv is None or len(uv) != len(piece.vertices):
            use.append(None)
            continue
        opaque = getattr(material, "alphaMode", None) in (None, "OPAQUE")
        key = (id(image), opaque)
        if key not in known:
            known[key] = _decode(image, opaque, decoded)
        use.append(known[key])
    return decoded, use, sum(k is None for k in known.values())


def _decode(image: Any, opaque: bool, decoded: list[Any]) -> int | None:
    """Append the picture as RGBA and return its number; None where it cannot be read."""
    if image.width * image.height > MAX_PIXELS:
        return None
    try:
        picture = image.convert("RGBA")
    except MemoryError:
        raise
    except Exception:
        return None
    if opaque:
        picture.putalpha(255)
    decoded.append(picture)
    return len(decoded) - 1


def _shrunk(image: Any, longest: int) -> U1:
    factor = longest / max(image.size)
    if factor < 1.0:
        return resized(image, *(max(1, int(s * factor)) for s in image.size))
    return np.ascontiguousarray(np.asarray(image, np.uint8))


def _corner_uv(piece: Piece) -> F4:
    """(f, 3, 2) f4; faces wholly outside the unit square are shifted into it by whole numbers, as textures repeat."""
    uv = np.nan_to_num(np.asarray(piece.raw["visual"].uv, np.float64)[:, :2], nan=0.0, posinf=0.0, neginf=0.0)[piece.faces]
    outside = ((uv < 0.0) | (uv > 1.0)).any(axis=1, keepdims=True)
    return np.where(outside, uv - np.floor(uv.min(axis=1, keepdims=True)), uv).astype(np.float32)


def _packed(textures: list[U1], use: list[int | None], uv: list[F4], corner_color: U1, longest: int) -> tuple[U1, F4]:
    """One texture of several, and coordinates into it; `corner_color` takes the colours of faces that repeat theirs.

    +--+------+----+   one row: a white patch for untextured pieces, then the textures,
    |  |      |    |   each in a border of GAP texels
    +--+      |    |
       +------+    |
    """
    width = sum(t.shape[1] + 2 * GAP for t in textures) + 1 + 2 * GAP
    if width > longest:
        factor = (longest - (len(textures) + 1) * (2 * GAP + 2)) / width
        textures = [_scaled(t, max(factor, 1.0 / 64.0)) for t in textures]
    parts = [np.full((1, 1, 4), 255, np.uint8), *textures]
    height = max(t.shape[0] for t in parts) + 2 * GAP
    framed = [np.pad(t, ((GAP, height - GAP - t.shape[0]), (GAP, GAP), (0, 0)), mode="edge") for t in parts]
    left = np.cumsum([0] + [t.shape[1] for t in framed])[:-1] + GAP
    atlas = np.concatenate(framed, axis=1)
    placed, first = [], 0
    for number, coordinates in zip(use, uv, strict=True):
        part = 0 if number is None else number + 1
        inside = coordinates.astype(np.float64)
        if number is None:
            inside = np.full_like(inside, 0.5)
        over = np.flatnonzero((inside > 1.0).any(axis=(1, 2)))
        if len(over):
            corner_color[first + over] = _sampled(parts[part], inside[over], corner_color[first + over])
            inside[over] = 0.5
        box = np.full(len(inside), part)
        box[over] = 0
        size = np.array([[t.shape[1], t.shape[0]] for t in parts], np.float64)[box][:, None]
        x = (left[box][:, None] + inside[..., 0] * size[..., 0]) / atlas.shape[1]
        y = (GAP + (1.0 - inside[..., 1]) * size[..., 1]) / atlas.shape[0]
        placed.append(np.stack([x, 1.0 - y], axis=-1).astype(np.float32))
        first += len(inside)
    return atlas, np.concatenate(placed)


def _scaled(texture: U1, factor: float) -> U1:
    from PIL import Image

    return resized(Image.fromarray(texture), *(max(1, int(s * factor)) for s in (texture.shape[1], texture.shape[0])))


def _sampled(texture: U1, uv: F8, tint: U1) -> U1:
    """Nearest texel at repeated (n, 3, 2) coordinates, times the (n, 3, 4) tint."""
    wrapped = uv - np.floor(uv)
    x = np.minimum((wrapped[..., 0] * texture.shape[1]).astype(int), texture.shape[1] - 1)
    y = np.minimum(((1.0 - wrapped[..., 1]) * texture.shape[0]).astype(int), texture.shape[0] - 1)
    return multiplied(texture[y, x], tint)
