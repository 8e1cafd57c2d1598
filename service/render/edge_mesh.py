"""The edge mesh: every edge of a mesh as the GL wants it to decide, frame by frame, whether the edge is a line.

Based on: Fast Silhouettes, "Algorithm Overview" and the last paragraph of "Rendering Implementation" (models that deform).
Departures: the article has four vertices an edge, each with a copy of a position and of both faces' normals (160 bytes an edge and its
indices beside). Here an edge is the numbers of its two ends and of the two vertices opposite to it, whose positions a vertex shader looks
up to know both normals: 20 bytes an edge with its angle, and 16 a vertex. So the mesh deforms by giving new positions, and
a geometry shader makes triangles only of edges that are lines. The article's flag for ridges and valleys is the angle itself:
thresholds may differ from picture to picture.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import moderngl
import numpy as np

from geometry.topology import directed_edges
from schemas.conventions import F4, I4, Array
from service.assets import MeshAsset
from service.kernels.edge_mesh import edge_angles, edges_of_any, opposite_vertices
from service.render.context import GlContext

COLUMNS = 2048
"""Texels in a row of the texture of positions, as `shaders/edge_mesh_positions.part.glsl` has it."""


@dataclass(frozen=True)
class Edges:
    """Edges of triangles. vertices (e, 4) i4: opposite on the left, two ends, opposite on the right (the first end again at a border).

    angles (e,) f4 degrees by which the surface turns there, above 0 where it is convex (`kernels.edge_mesh.edge_angles`).
    """

    vertices: I4
    angles: F4


def find_edges(positions: F4, faces: I4, edges: tuple[I4, I4] | None) -> Edges:
    """All edges of faces (f, 3) i4 with positions (v, 3) f4. edges: the edge table of a closed mesh, None where there is none.

    An edge of more than two faces is several, one for each pair of faces that bounds a piece of the solid.
    """
    if edges is not None:
        vertices = opposite_vertices(faces, *edges)
    else:
        half = directed_edges(np.asarray(faces, np.int32))
        low, high = half.min(axis=1).astype(np.int64), half.max(axis=1)
        key = low * len(positions) + high
        opposite = np.ascontiguousarray(faces[:, [2, 0, 1]]).reshape(-1)
        vertices = edges_of_any(positions, half, opposite, key, np.argsort(key, kind="stable"))
    return Edges(vertices, edge_angles(positions, vertices))


@dataclass
class EdgeMesh:
    """Edges in the GL. borders: whether some edge has one face only. shows: the positions that it has. moved: whether the angles are no
    longer those of the positions.
    """

    gl: GlContext
    count: int
    vertex_count: int
    borders: bool
    rows: moderngl.Buffer
    positions: moderngl.Texture
    shows: Array
    moved: bool = False
    arrays: dict[moderngl.Program, moderngl.VertexArray] = field(default_factory=dict)

    @classmethod
    def of(cls, gl: GlContext, asset: MeshAsset) -> EdgeMesh:
        """The edge mesh of an asset."""
        edges = find_edges(asset.positions, asset.faces, asset.edges)
        rows = np.empty(len(edges.vertices), [("edge", "<i4", 4), ("angle", "<f4")])
        rows["edge"], rows["angle"] = edges.vertices, edges.angles
        return cls(
            gl,
            len(rows),
            len(asset.positions),
            bool(np.any(edges.vertices[:, 1] == edges.vertices[:, 3])),
            gl.buffer(rows.tobytes() or bytes(rows.itemsize)),
            _texture(gl, asset.positions),
            asset.positions,
        )

    def at(self, positions: Array) -> EdgeMesh:
        """Another edge mesh with these edges, moved to (v, 3) f4 positions; what it holds in the GL is its own."""
        rows = self.gl.ctx.buffer(reserve=self.rows.size)
        self.gl.ctx.copy_buffer(rows, self.rows)
        return EdgeMesh(self.gl, self.count, self.vertex_count, self.borders, rows, _texture(self.gl, positions), positions, moved=True)

    @property
    def nbytes(self) -> int:
        """Bytes that the GL holds of it."""
        return int(self.rows.size) + 16 * self.positions.width * self.positions.height

    def move(self, positions: Array) -> None:
        """Deform the mesh: normals and angles follow in the GL. positions: (v, 3) f4 in the normalised frame, in the order of the mesh's.

        Raises ValueError when there are not as many as before.
        """
        if positions.shape != (self.vertex_count, 3):
            raise ValueError(f"an edge mesh of {self.vertex_count} vertices cannot be moved to positions {positions.shape}")
        if positions is not self.shows:
            self.gl.fill_texture(self.positions, _texels(positions))
            self.shows, self.moved = positions, True

    def array(self, program: moderngl.Program) -> moderngl.VertexArray:
        """The edges as input of a program, one point each."""
        if program not in self.arrays:
            angles = "in_angle" in program
            names = ["in_edge", "in_angle"] if angles else ["in_edge"]
            self.arrays[program] = self.gl.ctx.vertex_array(program, [(self.rows, "4i 1f" if angles else "4i 4x", *names)])
        return self.arrays[program]

    def release(self) -> None:
        """Delete everything in it."""
        for array in self.arrays.values():
            array.release()
        self.rows.release()
        self.positions.release()


def _texture(gl: GlContext, positions: Array) -> moderngl.Texture:
    texels = _texels(positions)
    return gl.texture((COLUMNS, texels.shape[0]), 4, texels.tobytes(), dtype="f4")


def _texels(positions: Array) -> F4:
    """(rows, COLUMNS, 4) f4: positions (v, 3), padded."""
    texels = np.zeros((-(-len(positions) // COLUMNS) or 1, COLUMNS, 4), "<f4")
    texels.reshape(-1, 4)[: len(positions), :3] = positions
    return texels
