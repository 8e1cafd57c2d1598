"""The files a mesh offers for download, made from its artifacts: the hull with its maps as glTF, and the maps as PNG."""

from __future__ import annotations

import io
from typing import Any, Protocol

import numpy as np
from PIL import Image

from backend.glb import Glb, placed
from geometry.tile_layout import TileLayout
from geometry.topology import face_normals
from schemas.conventions import F4, F8, I4, U1, Frame
from worker.bake import Maps
from worker.kernels import bake_tiles

LINEAR, CLAMP_TO_EDGE = 9729, 33071  # glTF's (OpenGL's) numbers


class HullArrays(Protocol):
    """positions (hv, 3) f4 in the normalised frame and faces (hf, 3) i4 of a hull."""

    @property
    def positions(self) -> F4:
        """(hv, 3) f4."""

    @property
    def faces(self) -> I4:
        """(hf, 3) i4."""


def normal_png(maps: Maps) -> bytes:
    """The object-space normal map as an RGB PNG: n * 127.5 + 127.5, linear."""
    return _png(maps.normal)


def color_png(maps: Maps) -> bytes:
    """The colour map as an RGBA PNG, sRGB, straight alpha. Raises ValueError when the maps have no colour."""
    if maps.color is None:
        raise ValueError("these maps have no colour")
    return _png(maps.color)


def hull_glb(hull: HullArrays, maps: Maps, frame: Frame) -> bytes:
    """Binary glTF 2.0 of the hull in model units with its maps, for any viewer.

    Every face has its own three corners with the face's normal and tangent, so that the tangent-space map that glTF wants
    is the object-space one turned, exactly. The mesh stays in the normalised frame; the node carries centre and scale, so
    that no precision is lost far from the origin. Minification is LINEAR: mipmaps would mix tiles.
    """
    basis, handedness = _tangent_frames(hull.positions, hull.faces, maps.tile_uv)
    count = 3 * len(hull.faces)
    corners = {
        "POSITION": hull.positions[hull.faces].reshape(count, 3),
        "NORMAL": np.repeat(basis[:, 2], 3, axis=0),
        "TANGENT": np.repeat(np.column_stack([basis[:, 0], handedness]), 3, axis=0),
        "TEXCOORD_0": maps.tile_uv.reshape(count, 2),
    }
    images = {"normal": _png(_tangent_map(maps, basis))}
    if maps.color is not None:
        images["color"] = color_png(maps)
    file = Glb()
    attributes = {name: file.add_accessor(np.ascontiguousarray(values, "<f4")) for name, values in corners.items()}
    textures = {name: file.add_texture(name, data) for name, data in images.items()}
    return file.to_bytes(
        scene=0,
        scenes=[{"nodes": [0]}],
        nodes=[placed("hull", frame)],
        meshes=[{"name": "hull", "primitives": [{"attributes": attributes, "material": 0, "mode": 4}]}],
        materials=[_material(textures, maps.color)],
        samplers=[{"magFilter": LINEAR, "minFilter": LINEAR, "wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE}],
    )


def _png(pixels: U1) -> bytes:
    out = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(out, "PNG")
    return out.getvalue()


def _tangent_frames(positions: F4, faces: I4, tile_uv: F4) -> tuple[F8, F8]:
    """(basis (hf, 3, 3) f8 with rows tangent, bitangent, normal; handedness (hf,) f8, 1 or -1).

    The tangent runs where u grows, the bitangent where v shrinks: up in the picture.
    """
    p, uv = positions.astype(np.float64)[faces], tile_uv.astype(np.float64)
    (e1, e2), (d1, d2) = ((x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) for x in (p, uv))
    area = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    along_u = (e1 * d2[:, 1:] - e2 * d1[:, 1:]) / area[:, None]
    along_v = (e2 * d1[:, :1] - e1 * d2[:, :1]) / area[:, None]
    normal = face_normals(positions, faces)
    tangent = along_u / np.linalg.norm(along_u, axis=1, keepdims=True)
    across = np.cross(normal, tangent)
    handedness = np.where(np.einsum("fi,fi->f", across, along_v) < 0.0, 1.0, -1.0)
    return np.stack([tangent, across * handedness[:, None], normal], axis=1), handedness


def _tangent_map(maps: Maps, basis: F8) -> U1:
    """(h, w, 3) u1: the normal map in the frames of the faces that the texels belong to."""
    height, width = maps.normal.shape[:2]
    layout = TileLayout.of(maps.tile_uv, width, height)
    out = np.full_like(maps.normal, (128, 128, 255))
    bake_tiles.turned_normals(maps.normal, basis, layout.side, layout.columns, out)
    return out


def _material(textures: dict[str, int], color: U1 | None) -> dict[str, Any]:
    surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 0.8}
    material: dict[str, Any] = {"name": "hull", "pbrMetallicRoughness": surface, "normalTexture": {"index": textures["normal"]}}
    if color is not None:
        surface["baseColorTexture"] = {"index": textures["color"]}
        alpha = color[..., 3]
        material["alphaMode"] = "BLEND" if np.any((alpha > 0) & (alpha < 255)) else "OPAQUE"
    return material
