"""Layout of the artifact files: safetensors layout, little-endian, C order. All positions are in the normalised frame.

v vertices, f faces, e edges of the original; hv, hf of the hull; n tree nodes; s steps, l levels.

An artifact is described by a table: tensor -> (dtype, shape); a dimension is a number (fixed) or a letter (bound to the
same value everywhere in the file). A name in `optional` may be absent.
"""

from __future__ import annotations

from dataclasses import dataclass, field

Dim = int | str


@dataclass(frozen=True)
class Layout:
    """Tensors of one artifact file, and its file name in the store."""

    file: str
    tensors: dict[str, tuple[str, tuple[Dim, ...]]]
    optional: frozenset[str] = field(default_factory=frozenset)


MESH = Layout(
    "mesh.safetensors",
    {
        "positions": ("<f4", ("v", 3)),
        "faces": ("<i4", ("f", 3)),
        # Unit, outward, angle-weighted, one for each smooth group of a vertex's faces: row i belongs to normal_vertices[i], and
        # corner_normals are the rows of each face's corners. Without these two, row i is vertex i's and faces name the rows.
        "normals": ("<f4", ("n", 3)),
        "normal_vertices": ("<i4", ("n",)),
        "corner_normals": ("<i4", ("f", 3)),
        # directed edge from edge_vertices[:, 0] to [:, 1]; left face has it in its own order, right face reversed.
        # Present when the mesh is a closed oriented 2-manifold.
        "edge_vertices": ("<i4", ("e", 2)),
        "edge_faces": ("<i4", ("e", 2)),
    },
    optional=frozenset({"normal_vertices", "corner_normals", "edge_vertices", "edge_faces"}),
)

FILE_VERTICES = Layout(
    "file_vertices.safetensors",
    {"file_vertices": ("<i4", ("v",))},  # number of each vertex of MESH in the upload, any of those that were welded; -1: made by repair
)

APPEARANCE = Layout(
    "appearance.safetensors",
    {
        # sRGB, straight alpha. The colour of a surface point is corner_color interpolated times the texture at corner_uv.
        "corner_color": ("|u1", ("f", 3, 4)),
        "corner_uv": ("<f4", ("f", 3, 2)),  # v upwards, as in OBJ: row 0 of the texture is v = 1
        "texture": ("|u1", ("h", "w", 4)),
    },
    optional=frozenset({"corner_color", "corner_uv", "texture"}),
)
"""Absent when the original has no colour at all."""

HULL = Layout(
    "hull.safetensors",
    {
        "positions": ("<f4", ("hv", 3)),
        "faces": ("<i4", ("hf", 3)),
        "normals": ("<f4", ("hv", 3)),  # unit; what the bake shot along (negated)
    },
)

HULL_SEQUENCE = Layout(
    "hull_sequence.safetensors",
    {
        # Steps of `geometry.hull_sequence`: collapses, moves and flips, each a row; every prefix is a hull.
        "step_vertices": ("<i4", ("s", 2)),
        "step_positions": ("<f4", ("s", 3)),
        # Hulls that were shrunk: after the first level_steps[i] steps there are level_faces[i] faces, in falling order.
        "level_faces": ("<i4", ("l",)),
        "level_steps": ("<i4", ("l",)),
    },
)

INNER_SEQUENCE = Layout("inner_sequence.safetensors", HULL_SEQUENCE.tensors)
"""The same for hulls that the original encloses."""

MAPS = Layout(
    "maps.safetensors",
    {
        "tile_uv": ("<f4", ("hf", 3, 2)),  # texture coordinates of each hull corner; v downwards: row 0 is v = 0
        "normal": ("|u1", ("h", "w", 3)),  # object space, n * 127.5 + 127.5 rounded
        "color": ("|u1", ("h", "w", 4)),  # sRGB, straight alpha
    },
    optional=frozenset({"color"}),
)

OTHER_HULLS = tuple(Layout(f"hull_{k}.safetensors", HULL.tensors) for k in (1, 2))
OTHER_MAPS = tuple(Layout(f"maps_{k}.safetensors", MAPS.tensors, MAPS.optional) for k in (1, 2))
"""Hulls of other sizes than was asked for, with their maps: one of fewer faces, one of more; a mesh has both, either, or none."""

TREE = Layout(
    "tree.safetensors",
    {
        # Preorder. Node i owns edges [edge_start[i], edge_start[i + 1]) of the permuted edge arrays; culled, the walk goes
        # on at skip[i]. scaled_normal is n / cos(theta); all zero where the node has no cone (never culled).
        "scaled_normal": ("<f4", ("n", 3)),
        "front_anchor": ("<f4", ("n", 3)),
        "back_anchor": ("<f4", ("n", 3)),
        "separation": ("<f4", ("n",)),
        "skip": ("<i4", ("n",)),
        "edge_start": ("<i4", ("m",)),  # m = n + 1
        "edge_index": ("<i4", ("e",)),  # row in mesh.edge_vertices / edge_faces
    },
)

MOST_LEVELS = 6
LEVELS = tuple(
    Layout(
        f"level_{k}.safetensors",
        {
            "positions": ("<f4", ("v", 3)),
            "faces": ("<i4", ("f", 3)),
            "edge_vertices": ("<i4", ("e", 2)),  # as in MESH
            "edge_faces": ("<i4", ("e", 2)),
            "bound": ("<f8", (1,)),  # no point of the level is further from the original, normalised units
        },
    )
    for k in range(MOST_LEVELS)
)
"""Hulls that stand for the original in far views, the finest first; a mesh has the first few of them, or none."""

LEVEL_TREES = tuple(Layout(f"level_{k}_tree.safetensors", TREE.tensors, TREE.optional) for k in range(MOST_LEVELS))
"""Their search trees; edge_index is a row of the level's edges."""

HULL_GLB = "hull.glb"
ORIGINAL_GLB = "original.glb"
"""Made from MESH when it is asked for."""
FILE_VERTEX = "_FILE_VERTEX"
"""Its attribute of the numbers that its vertices had in the upload; -1 for those that repair made."""
NORMAL_PNG = "normal.png"
COLOR_PNG = "color.png"

LAYOUTS = (
    *(MESH, FILE_VERTICES, APPEARANCE, HULL, HULL_SEQUENCE, INNER_SEQUENCE, MAPS),
    *(*OTHER_HULLS, *OTHER_MAPS, TREE, *LEVELS, *LEVEL_TREES),
)
DOWNLOADS = {
    HULL_GLB: "model/gltf-binary",
    NORMAL_PNG: "image/png",
    COLOR_PNG: "image/png",
}
