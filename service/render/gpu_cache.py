"""What the GL holds of the assets in use, least recently used first to go when it is too much together."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar, cast

import moderngl
import numpy as np

from schemas.conventions import F4, I4, Array
from service.assets import DrawnHull, MeshAsset
from service.render.context import GlContext
from service.render.edge_mesh import EdgeMesh
from service.render.halved_maps import halved_maps
from service.render.targets import SRGB8_ALPHA8

Fields = list[tuple[str, str, int]]
"""Name, numpy dtype and count of the attributes of one vertex, in order."""

_GL_FORMAT = {"<f4": "f", "|u1": "f1"}


class ChosenFaces:
    """Indices that are given anew for every frame, over vertices that stay."""

    def __init__(self) -> None:
        self._indices: moderngl.Buffer | None = None
        self._arrays: dict[moderngl.Program, moderngl.VertexArray] = {}

    def array(self, gl: GlContext, program: moderngl.Program, content: tuple[Any, ...], corners: I4) -> moderngl.VertexArray:
        """corners (k, 3) i4 of the vertices that `content` says."""
        if self._indices is None or self._indices.size < corners.nbytes:
            self.release()
            self._indices = gl.ctx.buffer(reserve=2 * corners.nbytes, dynamic=True)
        gl.fill(self._indices, corners)
        if program not in self._arrays:
            self._arrays[program] = gl.ctx.vertex_array(program, [content], self._indices)
        array = self._arrays[program]
        array.vertices = corners.size
        return array

    def release(self) -> None:
        """Delete the indices."""
        for array in self._arrays.values():
            array.release()
        self._arrays.clear()
        if self._indices is not None:
            self._indices.release()
            self._indices = None


@dataclass
class Surface:
    """A drawable surface. fields: its vertex attributes, without the prefix "in_". definitions: for the surface shaders.
    edge_ends: (e, 2) rows of the ends of all edges of a hull, in the order of its edge table. shows: the positions that its vertices have,
    where they may be moved.
    """

    fields: Fields
    vertices: moderngl.Buffer
    indices: moderngl.Buffer | None
    textures: dict[str, moderngl.Texture]
    definitions: frozenset[str]
    nbytes: int
    edge_ends: Array | None = None
    shows: F4 | None = None
    arrays: dict[moderngl.Program, moderngl.VertexArray] = field(default_factory=dict)
    chosen: ChosenFaces = field(default_factory=ChosenFaces)

    def array(self, ctx: moderngl.Context, program: moderngl.Program) -> moderngl.VertexArray:
        """The surface as input of a program."""
        if program not in self.arrays:
            layout, names = attributes(self.fields, "in_", set(program))
            self.arrays[program] = ctx.vertex_array(program, [(self.vertices, layout, *names)], self.indices)
        return self.arrays[program]

    def some_faces(self, gl: GlContext, program: moderngl.Program, corners: I4) -> moderngl.VertexArray:
        """A few of its faces as input of a program; they last until the next call. corners: (k, 3) i4 rows of its vertices."""
        layout, names = attributes(self.fields, "in_", set(program))
        return self.chosen.array(gl, program, (self.vertices, layout, *names), corners)

    def release(self) -> None:
        """Delete everything in it."""
        self.chosen.release()
        for one in (*self.arrays.values(), *self.textures.values(), self.vertices, self.indices):
            if one is not None:
                one.release()


def attributes(fields: Fields, prefix: str, used: set[str]) -> tuple[str, list[str]]:
    """(moderngl format, attribute names) of interleaved vertices; what a program does not use is skipped as padding."""
    parts, names = [], []
    for name, dtype, count in fields:
        if prefix + name in used:
            parts.append(f"{count}{_GL_FORMAT[dtype]}")
            names.append(prefix + name)
        else:
            parts.append(f"{count * np.dtype(dtype).itemsize}x")
    return " ".join(parts), names


class _Kept(Protocol):
    @property
    def nbytes(self) -> int: ...

    def release(self) -> None: ...


T = TypeVar("T", bound=_Kept)


class GpuCache:
    """Surfaces by asset and hull, and edge meshes by asset. A single one larger than the limit is kept as long as it is the latest."""

    def __init__(self, gl: GlContext, capacity_mib: int) -> None:
        self._gl, self._capacity = gl, capacity_mib << 20
        self._largest_texture = int(gl.ctx.info["GL_MAX_TEXTURE_SIZE"])
        self._kept: OrderedDict[tuple[Any, ...], _Kept] = OrderedDict()

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def nbytes(self) -> int:
        """Bytes of all that is kept."""
        return sum(one.nbytes for one in self._kept.values())

    def get(self, asset: MeshAsset, number: int | None, *, colored: bool, halvings: int = 0) -> Surface:
        """The hull of that number, with its maps halved so often, or the mesh (None); coloured where it has colours and they are wanted."""
        hull = None if number is None else asset.hulls[number]
        colored = colored and has_color(asset, hull)
        key = (asset.id, number, halvings, colored)
        surface = self._keep(key, lambda: self._upload(asset, _halved(hull, halvings), colored=colored))
        if asset.base is not None and surface.shows is not asset.positions:
            self._gl.fill(surface.vertices, mesh_rows(asset, colored=colored))
            surface.shows = asset.positions
        return surface

    def edge_mesh(self, asset: MeshAsset) -> EdgeMesh:
        """The edges of the mesh; where its vertices were moved, those of its base at their new places."""
        base = asset.base
        if base is None:
            return self._keep((asset.id, "edge mesh"), lambda: EdgeMesh.of(self._gl, asset))
        mesh = self._keep((asset.id, "edge mesh"), lambda: self.edge_mesh(base).at(asset.positions))
        mesh.move(asset.positions)
        return mesh

    def _keep(self, key: tuple[Any, ...], make: Callable[[], T]) -> T:
        """What is kept under the key, made if it is not there, as the latest."""
        if key not in self._kept:
            self._kept[key] = make()
        self._kept.move_to_end(key)
        while len(self._kept) > 1 and self.nbytes > self._capacity:
            self._kept.popitem(last=False)[1].release()
        return cast(T, self._kept[key])

    def drop(self, asset_id: str) -> None:
        """Delete what there is of one asset."""
        for key in [key for key in self._kept if key[0] == asset_id]:
            self._kept.pop(key).release()

    def release(self) -> None:
        """Delete everything."""
        while self._kept:
            self._kept.popitem()[1].release()

    def _upload(self, asset: MeshAsset, hull: DrawnHull | None, *, colored: bool) -> Surface:
        images = surface_images(asset, hull, colored=colored)
        unindexed = hull is not None or colored  # neighbouring faces have different attributes at the same vertex
        if hull is not None:
            rows = corner_rows(asset, hull, np.arange(3 * hull.faces, dtype=np.int32), colored=colored)
        else:
            rows = mesh_rows(asset, colored=colored)
        names = set(rows.dtype.names or ())
        definitions = {name.upper() for name in names & {"normal", "uv", "color"}} | {name.upper() for name in images}
        if "normal_map" in images:
            definitions.discard("NORMAL")
        indices = None if unindexed else np.ascontiguousarray(asset.shading_faces, "<i4")
        edge_ends = None
        if hull is not None:
            edge_ends = rows[edge_corners(hull.hull["faces"], hull.edges.vertices, hull.edges.faces[:, 0])]
        return Surface(
            fields_of(rows.dtype),
            self._gl.buffer(rows.tobytes()),
            None if indices is None else self._gl.buffer(indices.tobytes()),
            {name: self._texture(image, srgb=name == "color_map", repeat=hull is None) for name, image in images.items()},
            frozenset(definitions),
            rows.nbytes + (0 if indices is None else indices.nbytes) + sum(4 * i.shape[0] * i.shape[1] for i in images.values()),
            edge_ends,
            asset.positions if hull is None else None,
        )

    def _texture(self, image: Array, *, srgb: bool, repeat: bool) -> moderngl.Texture:
        step = -(-max(image.shape[:2]) // self._largest_texture)  # every step-th texel of one that the GL cannot hold
        image = image[::step, ::step]
        height, width, channels = image.shape
        data = np.ascontiguousarray(image).tobytes()
        texture = self._gl.texture((width, height), channels, data, SRGB8_ALPHA8 if srgb else None)
        texture.repeat_x = texture.repeat_y = repeat
        return texture


def _halved(hull: DrawnHull | None, times: int) -> DrawnHull | None:
    return DrawnHull(hull.hull, halved_maps(hull.maps, times)) if hull is not None and times else hull


def has_color(asset: MeshAsset, hull: DrawnHull | None) -> bool:
    """Whether the hull, or the mesh where there is none, has colours of its own."""
    if hull is not None:
        return "color" in hull.maps
    appearance: Mapping[str, Array] = asset.appearance or {}
    return "corner_color" in appearance or {"corner_uv", "texture"} <= set(appearance)


def surface_images(asset: MeshAsset, hull: DrawnHull | None, *, colored: bool) -> dict[str, Array]:
    """Textures of that surface by the name of their sampler."""
    if hull is not None:
        images = {"normal_map": hull.maps["normal"]} if "normal" in hull.maps else {}
        return images | ({"color_map": hull.maps["color"]} if colored else {})
    appearance = asset.appearance or {}
    textured = colored and {"corner_uv", "texture"} <= set(appearance)
    return {"color_map": appearance["texture"]} if textured else {}


def fields_of(dtype: np.dtype) -> Fields:
    """The attributes of a structured array's rows."""
    fields = []
    for name in dtype.names or ():
        base, shape = dtype[name].base, dtype[name].shape
        fields.append((name, base.str, shape[0]))
    return fields


def mesh_rows(asset: MeshAsset, *, colored: bool) -> Array:
    """(n,) structured rows of the original: one a corner where it is coloured, else one a normal."""
    if colored:
        return corner_rows(asset, None, np.arange(3 * len(asset.faces), dtype=np.int32), colored=True)
    return normal_rows(asset)


def normal_rows(asset: MeshAsset) -> Array:
    """(n,) structured rows of the original's normals and where they are; `shading_faces` name them."""
    return _rows({"position": asset.normal_positions, "normal": asset.normals})


def corner_rows(asset: MeshAsset, hull: DrawnHull | None, corners: I4, *, colored: bool) -> Array:
    """(...) structured rows of corners, numbered 3 face + corner, of a hull or of the coloured original."""
    if hull is not None:
        vertices = hull.hull["faces"].reshape(-1)[corners]
        columns = {"position": hull.hull["positions"][vertices]}
        if "normal" in hull.maps:
            return _rows(columns | {"uv": hull.maps["tile_uv"].reshape(-1, 2)[corners]})
        return _rows(columns | {"normal": hull.hull["normals"][vertices]})
    vertices = asset.faces.reshape(-1)[corners]
    columns = {"position": asset.positions[vertices], "normal": asset.normals[asset.shading_faces.reshape(-1)[corners]]}
    appearance: Mapping[str, Any] = asset.appearance or {}
    if colored and "corner_color" in appearance:
        columns["color"] = appearance["corner_color"].reshape(-1, 4)[corners]
    if colored and {"corner_uv", "texture"} <= set(appearance):
        # v upwards, while row 0 of the texture is uploaded first, at v = 0
        columns["uv"] = appearance["corner_uv"].reshape(-1, 2)[corners] * np.array([1, -1], "<f4") + np.array([0, 1], "<f4")
    return _rows(columns)


def edge_corners(faces: I4, edges: I4, beside: I4) -> I4:
    """(e, 2) numbers of the corners at the ends of edges (e, 2), on the faces (e,) beside them."""
    return 3 * beside[:, None] + np.argmax(faces[beside][:, None, :] == edges[:, :, None], axis=2)


def _rows(columns: dict[str, Array]) -> Array:
    shape = columns["position"].shape[:-1]
    rows = np.empty(shape, [(name, column.dtype.str, column.shape[-1:]) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    return rows
