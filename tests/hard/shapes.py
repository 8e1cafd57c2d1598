"""Meshes that are hard on purpose: (vertices (v, 3) f8, faces (f, 3) i4), small; each is named for what is hard about it."""

from __future__ import annotations

from itertools import product

import numpy as np
import trimesh

from tests.meshes import bumpy_sphere, cube, joined, sphere, torus

GENUS = 50
VALENCE = 300


def moved(mesh, offset=(0.0, 0.0, 0.0), scale=(1.0, 1.0, 1.0)):
    """A mesh scaled about the origin, then moved."""
    return mesh[0] * np.asarray(scale, float) + np.asarray(offset, float), mesh[1]


def inside_out(mesh):
    """The same surface facing the other way."""
    return mesh[0], np.ascontiguousarray(mesh[1][:, ::-1])


def crossing_at(mesh, angle_deg=35.0):
    """A mesh turned about an axis in general position, so that nothing is parallel to anything."""
    turn = trimesh.transformations.rotation_matrix(np.radians(angle_deg), (0.3, -0.7, 0.6))[:3, :3]
    return mesh[0] @ turn.T, mesh[1]


def voxels(solid):
    """The outer faces of unit cubes, solid (x, y, z) bool, two triangles a square; bodies that touch share vertices."""
    padded = np.pad(np.asarray(solid, bool), 1)
    index: dict[tuple[int, ...], int] = {}
    faces = []
    for cell in np.argwhere(padded):
        for axis, side in product(range(3), (0, 1)):
            beside = cell.copy()
            beside[axis] += 1 if side else -1
            if padded[tuple(beside)]:
                continue
            u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
            base = cell + np.eye(3, dtype=int)[axis] * side
            a, b, c, d = (index.setdefault(tuple(int(x) for x in p), len(index)) for p in (base, base + u, base + u + v, base + v))
            faces += [[a, b, c], [a, c, d]] if side else [[c, b, a], [d, c, a]]
    return np.array(list(index), np.float64), np.array(faces, np.int32)


def pierced_slab(holes: int = GENUS):
    """A slab with so many holes in a row: its genus."""
    solid = np.ones((2 * holes + 1, 3, 1), bool)
    solid[1::2, 1] = False
    return voxels(solid)


def many_components(count: int):
    """So many tetrahedra on a grid."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    side = int(np.ceil(count ** (1 / 3)))
    places = np.array(list(product(range(side), repeat=3))[:count], float) * 1.5
    vertices = (places[:, None] + corners).reshape(-1, 3)
    faces = (4 * np.arange(count, dtype=np.int32)[:, None, None] + triangles).reshape(-1, 3)
    return vertices, faces


def bipyramid(around: int = VALENCE):
    """Two apexes over a ring: both of valence `around`."""
    t = np.arange(around) / around * 2 * np.pi
    ring = np.column_stack([np.cos(t), np.sin(t), 0 * t])
    i = np.arange(around, dtype=np.int32)
    j = (i + 1) % around
    top, bottom = np.full_like(i, around), np.full_like(i, around + 1)
    faces = np.concatenate([np.column_stack([i, j, top]), np.column_stack([j, i, bottom])])
    return np.vstack([ring, [[0, 0, 0.7], [0, 0, -0.7]]]), faces


def cube_with_coplanar_fans(around: int = 60):
    """A cube whose six sides are fans about their middles, with `around` points on each side's border."""
    per_edge = around // 4
    out: dict[tuple[float, ...], int] = {}
    faces = []
    for axis in range(3):
        for side in (0.0, 1.0):
            middle = np.full(3, 0.5)
            middle[axis] = side
            u, w = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            corner = np.eye(3)[axis] * side
            border = []
            for start, along in ((0 * u, u), (u, w), (u + w, -u), (w, -w)):
                border += [corner + start + along * k / per_edge for k in range(per_edge)]
            ring = [out.setdefault(tuple(np.round(p, 12).tolist()), len(out)) for p in border]
            hub = out.setdefault(tuple(middle.tolist()), len(out))
            for a, b in zip(ring, ring[1:] + ring[:1], strict=True):
                faces.append([a, b, hub] if side else [b, a, hub])
    return np.array(list(out), np.float64), np.array(faces, np.int32)


def needles_and_caps(seed: int = 3):
    """A sphere with edges of every length down to 1e-7 and faces as flat as 1e-7: vertices split and pushed together."""
    v, f = sphere(2)
    rng = np.random.default_rng(seed)
    vertices, faces = list(v), f.tolist()
    for n in range(60):
        # cut a face in three at a point very near to one of its corners (needles) or edges (caps)
        at = int(rng.integers(len(faces)))
        a, b, c = faces[at]
        tiny = 10.0 ** -rng.uniform(3, 7)
        weights = (1 - 2 * tiny, tiny, tiny) if n % 2 else (0.5 - tiny, 0.5 - tiny, 2 * tiny)
        new = len(vertices)
        vertices.append(weights[0] * vertices[a] + weights[1] * vertices[b] + weights[2] * vertices[c])
        faces[at : at + 1] = [[a, b, new], [b, c, new], [c, a, new]]
    return np.array(vertices), np.array(faces, np.int32)


def cut_at_middles(mesh, share: float, seed: int = 1):
    """Faces cut in two at the exact middle of an edge, on one side only: T-junctions, with a face of no area in the slit."""
    vertices, faces = list(mesh[0]), mesh[1].tolist()
    rng = np.random.default_rng(seed)
    out = []
    for a, b, c in faces:
        if rng.random() < share:
            new = len(vertices)
            vertices.append((vertices[a] + vertices[b]) / 2)
            out += [[a, new, c], [new, b, c]]
        else:
            out.append([a, b, c])
    return np.array(vertices), np.array(out, np.int32)


def with_faces_without_area(mesh, count: int = 20, seed: int = 2):
    """Edges doubled, with a face of no area between: still closed, the new vertex being the exact middle of the edge."""
    vertices, faces = list(mesh[0]), mesh[1].tolist()
    rng = np.random.default_rng(seed)
    for at in rng.choice(len(faces), count, replace=False):
        a, b, c = faces[at]
        new = len(vertices)
        vertices.append((vertices[a] + vertices[b]) / 2)
        faces[at] = [a, new, c]
        faces += [[new, b, c], [a, b, new]]
    return np.array(vertices), np.array(faces, np.int32)


def doubled(mesh, seed: int = 4):
    """Every vertex there for each of its corners, and a third of the faces there twice, in any order."""
    vertices, faces = mesh
    rng = np.random.default_rng(seed)
    corners = vertices[faces].reshape(-1, 3)
    own = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    again = np.concatenate([own, own[rng.random(len(own)) < 1 / 3]])
    return corners, rng.permutation(again)


def klein_bottle(along: int = 24, around: int = 12):
    """A closed surface that cannot be oriented, as a figure of eight that is turned half round while it goes round."""
    u, v = np.meshgrid(np.arange(along) / along * 2 * np.pi, np.arange(around) / around * 2 * np.pi, indexing="ij")
    r = 2 + np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v)
    z = np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v)
    vertices = np.column_stack([(r * np.cos(u)).ravel(), (r * np.sin(u)).ravel(), z.ravel()])
    i, j = (x.ravel() for x in np.meshgrid(np.arange(along), np.arange(around), indexing="ij"))

    def at(row, column):
        # after one round the eight is turned by half a turn: v goes the other way
        turned = row == along
        return np.where(turned, 0, row) * around + np.where(turned, -column, column) % around

    a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
    return vertices, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype(np.int32)


def sheets(gap: float, across: int = 12):
    """A flat box whose top and bottom are this far apart, bumped alike, so that the sheets nearly coincide."""
    n = across
    x, y = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1), indexing="ij")
    z = 0.1 * np.sin(3 * x) * np.cos(2 * y)
    top = np.column_stack([x.ravel(), y.ravel(), z.ravel() + gap])
    bottom = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    a, b, c, d = i * (n + 1) + j, (i + 1) * (n + 1) + j, (i + 1) * (n + 1) + j + 1, i * (n + 1) + j + 1
    upper = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    lower = upper[:, ::-1] + (n + 1) ** 2
    rim = [*range(0, (n + 1) * n, n + 1), *range((n + 1) * n, (n + 1) ** 2 - 1), *range((n + 1) ** 2 - 1, n, -(n + 1)), *range(n, 0, -1)]
    p, q = np.array(rim), np.roll(rim, -1)
    m = (n + 1) ** 2
    walls = np.concatenate([np.column_stack([q, p, p + m]), np.column_stack([q, p + m, q + m])])
    return np.vstack([top, bottom]), np.concatenate([upper, lower, walls]).astype(np.int32)


def self_crossing():
    """One closed surface that goes through itself: a tube about a curve with a loop."""
    from client.shapes import tube

    t = np.arange(60) / 60 * 2 * np.pi
    return tube(np.column_stack([(1 + 2 * np.cos(t)) * np.cos(t), (1 + 2 * np.cos(t)) * np.sin(t), 0.05 * np.sin(t)]), 0.35, 10)


def powers_of_two(seed: int = 5):
    """A star-shaped body whose coordinates are all zero or powers of two, of very different size."""
    v, f = sphere(2)
    rounded = np.sign(v) * 2.0 ** np.round(np.log2(np.maximum(np.abs(v), 2.0**-9)))
    return np.where(np.abs(v) < 1e-9, 0.0, rounded), f


def octahedra_touching(what: str):
    """Two bodies that share a vertex, an edge or a face."""
    solid = np.zeros((2, 2, 2), bool)
    solid[0, 0, 0] = True
    solid[{"vertex": (1, 1, 1), "edge": (1, 1, 0), "face": (1, 0, 0)}[what]] = True
    if what == "face":  # each with walls of its own
        one = np.ones((1, 1, 1), bool)
        return joined(voxels(one), moved(voxels(one), (1, 0, 0)))
    return voxels(solid)


CLIPPED = {
    "unit size, ten million away": lambda: moved(bumpy_sphere(2), (1e7, -1e7, 2e7)),
    "scaled by 1e-12": lambda: moved(bumpy_sphere(2), scale=(1e-12,) * 3),
    "scaled by 1e12": lambda: moved(bumpy_sphere(2), scale=(1e12,) * 3),
    "denormal coordinates": lambda: moved(bumpy_sphere(2), scale=(1e-310,) * 3),
    "coordinates near the largest double": lambda: moved(bumpy_sphere(2), scale=(1e307,) * 3),
    "a million times as wide as thick": lambda: moved(sphere(2), scale=(1.0, 1.0, 1e-6)),
    "a million times as long as thick": lambda: moved(sphere(2), scale=(1.0, 1e-6, 1e-6)),
    "a very flat body in general position": lambda: crossing_at(moved(sphere(2), scale=(1.0, 1.0, 1e-6))),
    "needles and caps": needles_and_caps,
    "faces without area": lambda: with_faces_without_area(sphere(2)),
    "coplanar faces without area": lambda: with_faces_without_area(cube(3)),
    "duplicate vertices and faces": lambda: doubled(bumpy_sphere(2)),
    "coplanar fans": cube_with_coplanar_fans,
    "a vertex of very many edges": bipyramid,
    "T-junctions": lambda: cut_at_middles(cube(3), 0.1),
    "concentric bodies": lambda: joined(sphere(2), sphere(2, 0.5), sphere(1, 0.25)),
    "a hollow body": lambda: joined(sphere(2), inside_out(sphere(2, 0.9))),
    "turned inside out": lambda: inside_out(torus()),
    "touching at a vertex": lambda: octahedra_touching("vertex"),
    "touching along an edge": lambda: octahedra_touching("edge"),
    "touching along a face": lambda: octahedra_touching("face"),
    "crossing itself": self_crossing,
    "two bodies that cross": lambda: joined(sphere(2), crossing_at(moved(sphere(2), (0.7, 0.2, 0.1)))),
    "the same body twice, a hair apart": lambda: joined(bumpy_sphere(2), moved(bumpy_sphere(2), scale=(1 + 1e-7,) * 3)),
    "sheets 1e-7 apart": lambda: sheets(1e-7),
    "sheets 1e-5 apart": lambda: sheets(1e-5),
    "many holes": lambda: pierced_slab(12),
    "many components": lambda: many_components(300),
    "powers of two": powers_of_two,
}
"""Closed bodies, or near enough that loading makes them so: each is to be clipped, exactly."""
