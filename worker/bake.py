"""Normal and colour maps over the hull.

Paper: Silhouette Clipping, section 4 (texture creation by normal shooting).
What departs from it: the tiles' right angle stands opposite the longest side of the face; texels lie on the lattice that
includes the sides, so that faces sharing an edge agree along it; a ray leaves its face by at least six degrees, where the
interpolated normal alone would run along it or outwards; a ray ignores the inner sides of faces, and one that leaves the
hull again without having met the original has missed (the surface beyond belongs to another part of the hull).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from geometry.boxes import build_boxes
from geometry.tile_layout import TileLayout
from geometry.topology import face_normals, vertex_normals
from schemas.conventions import F4, F8, I4, U1, Array
from worker.kernels import bake_boxes, bake_color, bake_tiles

LIFT = 4e-6
"""Normalised units by which a ray starts outside the hull: some thirty units in the last place of a float32 at 1."""
RAYS_AT_ONCE = 1 << 18
MOST_HALVINGS = 3
"""Of a texture that is finer than the map: deeper means would mix what a texture has side by side (`worker.loading.colors.GAP`)."""
MOST_INNER_SIDES = 16
"""Inner sides a ray passes before it counts as a miss; only self-intersecting originals have any before an outer side."""


@dataclass(frozen=True)
class Maps:
    """What a bake made.

    tile_uv: (hf, 3, 2) f4, v downwards. normal: (h, w, 3) u1, object space, n * 127.5 + 127.5. color: (h, w, 4) u1 sRGB,
    straight alpha, or None. missed: rays that took the closest point instead. texel_count: rays. tile_side: lattice steps
    along a tile's leg.
    """

    tile_uv: F4
    normal: U1
    color: U1 | None
    missed: int
    texel_count: int
    tile_side: int

    def tensors(self) -> dict[str, Array]:
        """The tensors of `schemas.artifacts.MAPS`."""
        tensors: dict[str, Array] = {"tile_uv": self.tile_uv, "normal": self.normal}
        return tensors if self.color is None else {**tensors, "color": self.color}


def hull_normals(positions: F4, faces: I4) -> F4:
    """(hv, 3) f4 unit normals to interpolate and shoot along, for a closed oriented hull.

    Angle-weighted; where such a normal does not face all faces about its vertex, the direction is taken that faces the
    worst of them best (the point of their normals' convex hull that is closest to the origin, by Gilbert's algorithm).
    """
    normal = vertex_normals(positions, faces).astype(np.float64)
    across = face_normals(positions, faces)
    corner = faces.ravel()
    about = np.repeat(across, 3, axis=0)
    worst = _least_facing(normal, about, corner)
    bad = np.flatnonzero(worst < 2.0 * bake_tiles.LEAST_FACING)
    for vertex in bad:
        best = _best_facing(about[corner == vertex], normal[vertex])
        if best is not None:
            normal[vertex] = best
    return normal.astype(np.float32)


def _least_facing(normal: F8, about: F8, corner: I4) -> F8:
    worst = np.ones(len(normal))
    np.minimum.at(worst, corner, np.einsum("ij,ij->i", normal[corner], about))
    return worst


def _best_facing(around: F8, start: F8) -> F8 | None:
    """Unit direction with the greatest least dot product with `around` (k, 3); None when none faces them all."""
    point = start
    for _ in range(64):
        support = around[np.argmin(around @ point)]
        step = support - point
        length2 = float(step @ step)
        if length2 == 0.0:
            break
        along = min(1.0, max(0.0, float(-(point @ step)) / length2))
        if along == 0.0:
            break
        point = point + along * step
    length = float(np.linalg.norm(point))
    if length < 1e-6 or np.min(around @ point) <= 0.0:
        return None
    return np.asarray(point / length)


class Surface:
    """A triangle mesh to shoot at. positions (v, 3) f4, faces (f, 3) i4, facing as they are wound."""

    def __init__(self, positions: F4, faces: I4) -> None:
        self.positions, self.faces = positions, faces
        self._scene = EmbreeScene(robust=True)
        TriangleMesh(self._scene, np.ascontiguousarray(positions, np.float32), np.ascontiguousarray(faces, np.int32))

    def shoot(self, origins: F8, directions: F8, *, outer: bool) -> tuple[I4, F8, F8]:
        """First face that each ray meets from its outer (or inner) side: (face (n,) i4 or -1, weights (n, 3), distance (n,)).

        Faces met from the other side are passed.
        """
        count = len(origins)
        found = np.full(count, -1, np.int32)
        weights, distance = np.zeros((count, 3)), np.full(count, np.inf)
        live, start = np.arange(count), np.zeros(count)
        for _ in range(MOST_INNER_SIDES):
            o = origins[live] + start[live, None] * directions[live]
            met = self._scene.run(o.astype(np.float32), directions[live].astype(np.float32)).astype(np.int32)
            w, t = np.zeros((len(live), 3)), np.zeros(len(live))
            is_outer = bake_tiles.ray_hits(self.positions, self.faces, o, directions[live], met, w, t)
            good = (met >= 0) & (is_outer == outer)
            hit = live[good]
            found[hit], weights[hit], distance[hit] = met[good], w[good], start[hit] + t[good]
            passed = (met >= 0) & ~good
            live = live[passed]
            if not len(live):
                break
            start[live] += np.maximum(t[passed], 0.0) + LIFT
        return found, weights, distance


class _Shooter:
    """Finds the point of the original that belongs to each texel of the hull."""

    def __init__(self, hull: tuple[F4, I4], original: tuple[F4, I4]) -> None:
        self._hull, self._original = Surface(*hull), Surface(*original)
        self._boxes: tuple[Array, Array] | None = None
        self.missed = 0

    def find(self, origins: F8, directions: F8) -> tuple[I4, F8]:
        """(face (n,) i4, weights (n, 3) f8) on the original for rays from the hull, (n, 3) f8 each."""
        lifted = origins - LIFT * directions
        face, weights, distance = self._original.shoot(lifted, directions, outer=True)
        _, _, leaving = self._hull.shoot(lifted, directions, outer=False)
        missed = np.flatnonzero((face < 0) | (distance > leaving + 2.0 * LIFT))
        if len(missed):
            face[missed], weights[missed] = self._closest(origins[missed])
            self.missed += len(missed)
        return face, weights

    def _closest(self, points: F8) -> tuple[I4, F8]:
        positions, faces = self._original.positions, self._original.faces
        if self._boxes is None:
            self._boxes = build_boxes(positions, faces)
        order, boxes = self._boxes
        face, weights, _ = bake_boxes.closest_points(positions, faces, order, boxes, points)
        return face, weights


class _Colors:
    """The original's appearance, ready to be sampled: positions (v, 3) f4, faces (f, 3) i4."""

    def __init__(self, appearance: dict[str, Array], positions: F4, faces: I4) -> None:
        self._corner = appearance.get("corner_color")
        self._uv, self._texture = appearance.get("corner_uv"), appearance.get("texture")
        self._table = bake_color.linear_table()
        if self._uv is not None and self._texture is not None:
            self._texels, self._levels = _pyramid(np.array(self._texture, np.uint8), self._table)
            height, width = self._texture.shape[:2]
            self._density = bake_color.texel_densities(self._uv, positions, faces, width, height)

    @property
    def any(self) -> bool:
        """Whether there is a colour at all; coordinates without a texture are none."""
        return self._corner is not None or (self._uv is not None and self._texture is not None)

    def sample(self, face: I4, weights: F8, areas: F8) -> F8:
        """(n, 4) f8 linear, straight alpha; areas (n,) f8: of the surface that each sample stands for."""
        color = np.ones((len(face), 4))
        if self._corner is not None:
            color *= bake_color.corner_colors(self._corner, face, weights, self._table)
        if self._uv is not None and self._texture is not None:
            footprints = areas * self._density[face]
            color *= bake_color.texture_colors(self._uv, self._texels, self._levels, face, weights, footprints, self._table)
        return color


def _pyramid(texture: U1, table: F8) -> tuple[U1, Array]:
    """(texels (t, 4) u1, levels (l, 3) i8 first texel, width, height): a texture and its means over 2 x 2 to 8 x 8 texels."""
    images = [texture]
    while len(images) <= MOST_HALVINGS and max(images[-1].shape[:2]) > 1:
        images.append(bake_color.halved(images[-1], table))
    sizes = [(image.shape[0] * image.shape[1], image.shape[1], image.shape[0]) for image in images]
    first = np.cumsum([0, *(count for count, _, _ in sizes)])[:-1]
    levels = np.array([(start, width, height) for start, (_, width, height) in zip(first, sizes, strict=True)], np.int64)
    return np.concatenate([image.reshape(-1, 4) for image in images]), levels


def _encode_normals(normals: F8) -> U1:
    return np.rint(np.clip(normals, -1.0, 1.0) * 127.5 + 127.5).astype(np.uint8)


def _encode_colors(linear: F8) -> U1:
    c = np.clip(linear, 0.0, 1.0)
    srgb = np.where(c <= 0.0031308, 12.92 * c, 1.055 * np.power(c, 1.0 / 2.4) - 0.055)
    srgb[:, 3] = c[:, 3]
    return np.rint(srgb * 255.0).astype(np.uint8)


def _texel_areas(positions: F4, faces: I4, side: int) -> F8:
    """(hf,) f8: area of a hull face that one texel of its tile stands for."""
    p = positions.astype(np.float64)[faces]
    return np.asarray(np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / side**2)


def _right_angles(positions: F4, faces: I4) -> I4:
    """(hf,) i4: the corner opposite each face's longest side."""
    p = positions.astype(np.float64)
    opposite = p[faces[:, [1, 2, 0]]] - p[faces[:, [2, 0, 1]]]
    return np.argmax(np.einsum("fki,fki->fk", opposite, opposite), axis=1).astype(np.int32)


def bake_maps(  # noqa: PLR0913, PLR0917 - two meshes of three arrays each
    hull_positions: F4,
    hull_faces: I4,
    hull_normals: F4,
    positions: F4,
    faces: I4,
    normals: F4,
    appearance: dict[str, Array] | None,
    texels: int,
    progress: Callable[[float], None],
    *,
    corner_normals: I4 | None = None,
) -> Maps:
    """Sample the original's normals and colours over the hull by shooting along the hull's interpolated normals.

    hull_positions, hull_normals (hv, 3) f4, hull_faces (hf, 3) i4: closed, enclosing, normals as by `hull_normals`.
    positions (v, 3) f4, faces (f, 3) i4: the original in the same frame, facing outwards. normals (n, 3) f4, corner_normals
    (f, 3) i4: its normals and their rows at the corners of faces; without these, n = v and row i is vertex i's. appearance: tensors of
    `artifacts.APPEARANCE`. texels: longest side of the maps, exceeded only where a hull of many faces leaves less than the
    smallest tile for each. progress is called with 0..1 often; what it raises goes through.
    """
    layout = TileLayout.fitting(len(hull_faces), texels)
    turns = _right_angles(hull_positions, hull_faces)
    across = face_normals(hull_positions, hull_faces)
    colors = _Colors(appearance or {}, positions, faces)
    areas = _texel_areas(hull_positions, hull_faces, layout.side)
    normal = np.full((layout.height, layout.width, 3), (128, 128, 255), np.uint8)
    color = np.zeros((layout.height, layout.width, 4), np.uint8) if colors.any else None
    rows = faces if corner_normals is None else corner_normals
    progress(0.0)
    shooter = _Shooter((hull_positions, hull_faces), (positions, faces))
    per_tile = int(bake_tiles.texels_per_tile(layout.side))
    step = max(1, RAYS_AT_ONCE // per_tile)
    for first in range(0, layout.faces, step):
        last = min(first + step, layout.faces)
        place = (layout.side, layout.columns, first, last)
        rays = bake_tiles.tile_rays(hull_positions, hull_faces, hull_normals, across, turns, layout.side, first, last)
        face, weights = shooter.find(*rays)
        found = bake_tiles.sampled_normals(positions, faces, normals, rows, face, weights)
        bake_tiles.place_texels(_encode_normals(bake_tiles.with_padding(found, layout.side)), normal, *place)
        if color is not None:
            found = colors.sample(face, weights, np.repeat(areas[first:last], per_tile))
            bake_tiles.place_texels(_encode_colors(bake_tiles.with_padding(found, layout.side)), color, *place)
        progress(last / layout.faces)
    return Maps(layout.tile_uv(turns), normal, color, shooter.missed, layout.faces * per_tile, layout.side)


def bake_hull(
    mesh: dict[str, Any], hull: dict[str, Any], appearance: dict[str, Array] | None, texels: int, progress: Callable[[float], None]
) -> Maps:
    """The same of stored tensors: mesh of `schemas.artifacts.MESH`, hull of HULL, appearance of APPEARANCE."""
    return bake_maps(
        hull["positions"],
        hull["faces"],
        hull["normals"],
        mesh["positions"],
        mesh["faces"],
        mesh["normals"],
        appearance,
        texels,
        progress,
        corner_normals=mesh.get("corner_normals"),
    )
