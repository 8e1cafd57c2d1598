"""Part of `benchmarks.exactness`: silhouettes of hard little meshes for awkward eyes, found in every way, against whole numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.extraction import silent
from benchmarks.report import Result
from geometry.silhouettes import face_planes, silhouette_edgewise, silhouette_scalar, silhouette_simd
from geometry.topology import build_edges
from schemas.conventions import F4, F8, I4
from service.silhouette.extract import SilhouetteTree
from tests import meshes
from tests.degenerate import nudged
from tests.oracles_integer import Facing
from worker.tree import build_tree

Shape = tuple[F8, I4]
CHUNK = 500
WAYS = ("tree", "tree_many", "scalar", "edgewise", "simd")


def fan(valence: int = 2000) -> Shape:
    """Two vertices of this many faces each, over and under a ring."""
    turn = np.arange(valence) / valence * 2.0 * np.pi
    ring = np.column_stack([np.cos(turn), np.sin(turn), 0.1 * np.sin(3.0 * turn)])
    here, there = np.arange(valence), np.roll(np.arange(valence), -1)
    above = np.column_stack([here, there, np.full(valence, valence)])
    below = np.column_stack([there, here, np.full(valence, valence + 1)])
    return np.concatenate([ring, [[0.0, 0.0, 1.0], [0.0, 0.0, -0.5]]]), np.concatenate([above, below]).astype(np.int32)


def without_area() -> Shape:
    """A cube with the middles of some edges on one side only: faces without area close the gaps."""
    v, f = meshes.cube(4)
    points, faces = v.tolist(), f.tolist()
    for number in range(0, len(f), 7):
        a, b, c = faces[number]
        middle = len(points)
        points.append(((v[a] + v[b]) / 2.0).tolist())
        faces[number] = [a, middle, c]
        faces += [[middle, b, c], [a, b, middle]]
    return np.array(points), np.array(faces, np.int32)


def _turned_over(shape: Shape) -> Shape:
    return shape[0], np.ascontiguousarray(shape[1][:, ::-1])


def _scaled(shape: Shape, *by: float) -> Shape:
    return shape[0] * by, shape[1]


def _moved(shape: Shape, *by: float) -> Shape:
    return shape[0] + by, shape[1]


SHAPES: dict[str, Callable[[], Shape]] = {
    "sphere": lambda: meshes.sphere(2),
    "torus": meshes.torus,
    "knot": lambda: meshes.knot(60, 10),
    "cube of coplanar fans": lambda: meshes.cube(6),
    "bumpy sphere": lambda: meshes.bumpy_sphere(3, 0.6),
    "two cubes that touch": lambda: meshes.joined(meshes.cube(4), _moved(meshes.cube(4), 1.0, 0.0, 0.0)),
    "needles": lambda: _scaled(meshes.bumpy_sphere(2), 1.0, 1e-5, 1e-9),
    "flat box": lambda: _scaled(meshes.cube(5), 1.0, 1.0, 1e-6),
    "fan of 2000": fan,
    "shell": lambda: meshes.joined(meshes.sphere(2), _turned_over(meshes.sphere(2, 0.9))),
    "crossing tori": lambda: meshes.joined(
        meshes.torus(20, 10), _moved((meshes.torus(20, 10)[0][:, [2, 0, 1]], meshes.torus(20, 10)[1]), 0.8, 0, 0)
    ),
    "faces without area": without_area,
}


def _corners(rng: np.random.Generator, positions: F4, faces: I4, count: int) -> F8:
    return positions[faces[rng.integers(0, len(faces), count)]].astype(np.float64)


def _on_vertices(rng: np.random.Generator, corners: F8) -> F8:
    return corners[:, 0]


def _on_edge_lines(rng: np.random.Generator, corners: F8) -> F8:
    t = np.where(
        rng.random((len(corners), 1)) < 0.3, rng.choice([0.5, 2.0, -1.0, 0.25], (len(corners), 1)), rng.uniform(-3, 3, (len(corners), 1))
    )
    return corners[:, 0] + t * (corners[:, 1] - corners[:, 0])


def _in_planes(rng: np.random.Generator, corners: F8) -> F8:
    s, t = rng.uniform(-3.0, 3.0, (2, len(corners), 1))
    return corners[:, 0] + s * (corners[:, 1] - corners[:, 0]) + t * (corners[:, 2] - corners[:, 0])


def _in_faces(rng: np.random.Generator, corners: F8) -> F8:
    weights = rng.dirichlet(np.ones(3), len(corners))
    return np.einsum("nk,nki->ni", weights, corners)


def _ulps_off(rng: np.random.Generator, corners: F8) -> F8:
    places = np.array([_on_vertices(rng, corners), _on_edge_lines(rng, corners), _in_planes(rng, corners)])
    return nudged(rng, places[rng.integers(0, 3, len(corners)), np.arange(len(corners))])


def _barely_off(rng: np.random.Generator, corners: F8) -> F8:
    return _in_faces(rng, corners) + 1e-9 * rng.normal(size=(len(corners), 3))


def _far_in_planes(rng: np.random.Generator, corners: F8) -> F8:
    return corners[:, 0] + 1e12 * (_in_planes(rng, corners) - corners[:, 0])


def _inside(rng: np.random.Generator, corners: F8) -> F8:
    return rng.uniform(0.0, 0.95, (len(corners), 1)) * corners.mean(axis=1)


def _beyond_float32(rng: np.random.Generator, corners: F8) -> F8:
    return (_in_planes(rng, corners) - corners[:, 0]) * 10.0 ** rng.uniform(30.0, 300.0, (len(corners), 1))


def _next_to_nothing(rng: np.random.Generator, corners: F8) -> F8:
    return corners[:, 0] * 10.0 ** rng.uniform(-322.0, -20.0, (len(corners), 1))


def _usual(rng: np.random.Generator, corners: F8) -> F8:
    direction = rng.normal(size=(len(corners), 3))
    return direction * (rng.uniform(1.5, 4.0, (len(corners), 1)) / np.linalg.norm(direction, axis=1, keepdims=True))


def _along_edges(rng: np.random.Generator, corners: F8) -> F8:
    return corners[:, 1] - corners[:, 0]


def _along_faces(rng: np.random.Generator, corners: F8) -> F8:
    along = _in_planes(rng, corners) - corners[:, 0]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    return np.divide(along, length, out=along, where=length > 1e-150)


PLACES = (
    _on_vertices, _on_edge_lines, _in_planes, _in_faces, _ulps_off, _barely_off, _far_in_planes, _inside, _beyond_float32,
    _next_to_nothing, _usual,
)  # fmt: skip
DIRECTIONS = (_along_edges, _along_faces, _usual, _next_to_nothing)


def awkward_eyes(rng: np.random.Generator, positions: F4, faces: I4, count: int) -> F8:
    """(count, 4) f8, in turn from each of PLACES, and at infinity in each of DIRECTIONS."""
    kinds = [(place, 1.0) for place in PLACES] + [(direction, 0.0) for direction in DIRECTIONS]
    each = -(-count // len(kinds))
    made = [np.column_stack([place(rng, _corners(rng, positions, faces, each)), np.full(each, w)]) for place, w in kinds]
    return np.stack(made, axis=1).reshape(-1, 4)[:count]


class Prepared:
    """A shape ready for all ways of finding its silhouette."""

    def __init__(self, name: str) -> None:
        self.positions, self.faces, _ = meshes.normalised(SHAPES[name]())
        edges = build_edges(self.faces)
        table = {"edge_vertices": edges.vertices, "edge_faces": edges.faces}
        tree = build_tree(self.positions, self.faces, edges.vertices, edges.faces, silent)
        self.edge_vertices, self.edge_faces = edges.vertices, edges.faces
        self.tree = SilhouetteTree({"positions": self.positions, "faces": self.faces} | table, tree.tensors())
        self.planes, self.facing = face_planes(self.positions, self.faces), Facing(self.positions, self.faces)

    def keys(self, edges: I4) -> I4:
        """(s,) i8 sorted: a number for every directed edge."""
        return np.sort(edges[:, 0].astype(np.int64) * len(self.positions) + edges[:, 1])

    def exact(self, eye: F8) -> I4:
        """The keys of the silhouette by whole numbers."""
        front = self.facing.front(eye)[self.edge_faces]
        some = front[:, 0] != front[:, 1]
        ends = self.edge_vertices[some]
        return self.keys(np.where(front[some, :1], ends, ends[:, ::-1]))

    def brute(self, eye: F8) -> dict[str, I4]:
        """The edges by each brute force."""
        table = (self.positions, self.faces, self.edge_vertices, self.edge_faces, eye)
        return {
            "scalar": silhouette_scalar(*table),
            "edgewise": silhouette_edgewise(self.planes, *table),
            "simd": silhouette_simd(self.planes, *table),
        }


def count_mismatches(name: str, count: int, seed: int) -> Result:
    """For how many awkward eyes each way differs from whole numbers; edges: of all silhouettes together."""
    ready, rng = Prepared(name), np.random.default_rng(seed)
    wrong, edges, faults = dict.fromkeys(WAYS, 0), 0, []
    for begin in range(0, count, CHUNK):
        eyes = awkward_eyes(rng, ready.positions, ready.faces, min(CHUNK, count - begin))
        for eye, at_once in zip(eyes, ready.tree.extract_many(eyes), strict=True):
            expected = ready.exact(eye)
            edges += len(expected)
            found = {"tree": ready.tree.extract(eye).edges, "tree_many": at_once.edges} | ready.brute(eye)
            for way, chosen in found.items():
                if not np.array_equal(ready.keys(chosen), expected):
                    wrong[way] += 1
                    faults.append([way, *map(float.hex, eye.tolist())])
    return {"mesh": name, "faces": len(ready.faces), "eyes": count, "silhouette_edges": edges, "mismatches": wrong, "faults": faults[:10]}
