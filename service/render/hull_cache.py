"""What drawing hulls on the CPU keeps of the assets in use, least recently used first to go when it is too much together."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from schemas.conventions import F4, I4, U1, Array
from service.assets import DrawnHull, MeshAsset
from service.render.halved_maps import halved_maps


@dataclass(frozen=True)
class HullSurface:
    """A hull as the kernels take it: arrays of their own, contiguous, whatever file the asset is mapped from.

    positions (v, 3) f4, faces (f, 3) i4; edge_vertices, edge_faces (e, 2) i4. uv: (f, 3, 2) f4 texels, v downwards. normals: u4
    texels, row by row, red in the lowest byte, and a row more; colors: the same, the normals again where there are none.
    size: (width, height) of the maps.
    """

    positions: F4
    faces: I4
    edge_vertices: I4
    edge_faces: I4
    uv: F4
    normals: Array
    colors: Array
    size: tuple[int, int]

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        arrays = (self.positions, self.faces, self.edge_vertices, self.edge_faces, self.uv, self.normals)
        return sum(a.nbytes for a in arrays) + (0 if self.colors is self.normals else self.colors.nbytes)


@dataclass(frozen=True)
class PlacedHull:
    """A hull in the image, as `service.kernels.hull_bands.place_hull` makes it. points (v, 4) f8, sense: 1, or -1 for a view that mirrors;
    seen (n,) i4, rows (n, 2) i4: faces that show; ends, places (k, 4) f8: edges of its outline.
    """

    surface: HullSurface
    points: Array
    sense: float
    seen: Array
    rows: Array
    ends: Array
    places: Array


class HullCache:
    """Hull surfaces by asset. A single one larger than the limit is kept as long as it is the latest."""

    def __init__(self, capacity_mib: int) -> None:
        self._capacity = capacity_mib << 20
        self._kept: OrderedDict[tuple[str, int, int], HullSurface] = OrderedDict()

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def nbytes(self) -> int:
        """Bytes of all surfaces."""
        return sum(surface.nbytes for surface in self._kept.values())

    def get(self, asset: MeshAsset, number: int = 0, halvings: int = 0) -> HullSurface:
        """A hull of a clippable asset, with its maps halved so often."""
        key = asset.id, number, halvings
        if key not in self._kept:
            self._kept[key] = hull_surface(asset.hulls[number], halvings)
            while len(self._kept) > 1 and self.nbytes > self._capacity:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]


def hull_surface(drawn: DrawnHull, halvings: int = 0) -> HullSurface:
    """Copy a hull and its maps. Raises ValueError when it has none."""
    if not drawn.maps:
        raise ValueError("only a hull with maps can be drawn")
    hull, maps, edges = drawn.hull, halved_maps(drawn.maps, halvings), drawn.edges
    height, width = maps["normal"].shape[:2]
    normals = _texels(maps["normal"])
    return HullSurface(
        np.array(hull["positions"], np.float32),
        np.array(hull["faces"], np.int32),
        np.array(edges.vertices, np.int32),
        np.array(edges.faces, np.int32),
        maps["tile_uv"] * np.array([width, height], np.float32),
        normals,
        _texels(maps["color"]) if "color" in maps else normals,
        (width, height),
    )


def _texels(image: U1) -> Array:
    """(w * (h + 1) + 1,) u4 of (h, w, 3 or 4) u1: neighbours of the last texel may be read, though nothing comes of them."""
    height, width, channels = image.shape
    texels = np.zeros(width * (height + 1) + 1, np.uint32)
    texels[: width * height].view(np.uint8).reshape(height, width, 4)[:, :, :channels] = image
    return texels
