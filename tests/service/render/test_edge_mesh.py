"""Which edges there are, how they fold, and what they cost, against oracles that look at every pair of faces."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise

import numpy as np
import pytest

from geometry.predicates import front_facing
from geometry.topology import face_normals
from service.render.edge_mesh import EdgeMesh, find_edges
from service.render.programs import shader_source
from tests import meshes
from tests.service.render.lined import asset_of, drawn_with_lines, inked

L_BLOCK = ((0, 0, 0), (1, 0, 0), (0, 1, 0))
CORNER_TO_CORNER = ((0, 0, 0), (1, 1, 0))
SHAPES = {
    "cube": lambda: meshes.cube(2),
    "L": lambda: meshes.blocks(*L_BLOCK),
    "torus": lambda: meshes.torus(24, 12),
    "bumpy": lambda: meshes.bumpy_sphere(3, 0.5),
    "sheet": lambda: meshes.sheet(6),
}


def faces_at_edges(faces):
    """Undirected edge -> [(face, whether it runs along it from the smaller number)]."""
    found = defaultdict(list)
    for f, corners in enumerate(faces.tolist()):
        for a, b in pairwise([*corners, corners[0]]):
            found[min(a, b), max(a, b)].append((f, a < b))
    return found


def slow_angles(positions, faces):
    """Undirected edge -> degrees, above 0 where it is convex; None at a border. Two faces at most."""
    p = positions.astype(np.float64)
    normals = face_normals(p, faces)
    angles = {}
    for edge, found in faces_at_edges(faces).items():
        if len(found) == 1:
            angles[edge] = None
            continue
        (f, _), (g, _) = found
        cosine = np.clip(normals[f] @ normals[g], -1.0, 1.0)
        beyond = p[faces[g]].mean(axis=0) - p[edge[0]]
        angles[edge] = np.degrees(np.arccos(cosine)) * (-1.0 if normals[f] @ beyond > 0.0 else 1.0)
    return angles


def by_edge(edges):
    return {
        (min(a, b), max(a, b)): (o, q, angle) for (o, a, b, q), angle in zip(edges.vertices.tolist(), edges.angles.tolist(), strict=True)
    }


@pytest.mark.parametrize(
    ("name", "table"), [(name, table) for name in SHAPES for table in (True, False) if not (table and name == "sheet")]
)
def test_every_edge_is_there_once_with_its_angle(name, table):
    asset = asset_of(SHAPES[name](), name)
    found = find_edges(asset.positions, asset.faces, asset.edges if table else None)
    slow = slow_angles(asset.positions, asset.faces)
    fast = by_edge(found)
    assert len(found.vertices) == len(fast) == len(slow)
    for edge, angle in slow.items():
        opposite, other, got = fast[edge]
        corners = {c for f, _ in faces_at_edges(asset.faces)[edge] for c in asset.faces[f]} if len(slow) < 200 else None
        assert corners is None or corners == {*edge, opposite, other}
        assert got == 0.0 if angle is None else abs(got - angle) < 2e-3


def test_cube_has_twelve_ridges_and_is_flat_elsewhere():
    asset = asset_of(meshes.cube(1), "cube")
    angles = find_edges(asset.positions, asset.faces, asset.edges).angles
    assert sorted(angles.tolist()) == [0.0] * 6 + [90.0] * 12


def test_inner_edge_of_an_l_is_its_only_valley():
    asset = asset_of(meshes.blocks(*L_BLOCK), "L")
    edges = find_edges(asset.positions, asset.faces, asset.edges)
    valley = np.flatnonzero(edges.angles < 0.0)
    assert edges.angles[valley].tolist() == [-90.0]
    ends = asset.frame.to_model(asset.positions[edges.vertices[valley[0], 1:3]])
    assert {tuple(np.round(end, 5)) for end in ends} == {(1.0, 1.0, 0.0), (1.0, 1.0, 1.0)}


def test_sign_of_a_fold_is_exact_where_float64_sees_none():
    height = np.float32(2.0**-60)
    positions = np.array([[0, 0, 0], [1, 0, 0], [0.25, 1, 0], [0.5, -1, 0]], np.float32)
    faces = np.array([[0, 1, 2], [1, 0, 3]], np.int32)
    for lift, sign in ((height, -1.0), (-height, 1.0), (np.float32(0.0), 0.0)):
        positions[3, 2] = lift
        assert np.sign(by_edge(find_edges(positions, faces, None))[0, 1][2]) == sign


def test_open_sheet_has_its_border_and_no_other():
    asset = asset_of(meshes.sheet(6), "sheet")
    edges = find_edges(asset.positions, asset.faces, None)
    borders = edges.vertices[edges.vertices[:, 1] == edges.vertices[:, 3]]
    assert {(min(a, b), max(a, b)) for _, a, b, _ in borders.tolist()} == {e for e, f in faces_at_edges(asset.faces).items() if len(f) == 1}
    assert len(borders) == 24


def test_edge_where_two_cubes_meet_is_a_ridge_of_each():
    asset = asset_of(meshes.blocks(*CORNER_TO_CORNER), "two cubes")
    edges = find_edges(asset.positions, asset.faces, None)
    assert not np.any(edges.vertices[:, 1] == edges.vertices[:, 3])
    assert np.count_nonzero(edges.angles == 90.0) == 24
    shared = max(faces_at_edges(asset.faces).items(), key=lambda item: len(item[1]))[0]
    pairs = [(o, q) for o, a, b, q in edges.vertices.tolist() if {a, b} == set(shared)]
    assert len(pairs) == 2
    for pair in pairs:  # the faces of one cube: their other corners are on the same side of the plane between the cubes
        x, y = asset.frame.to_model(asset.positions[list(pair)])[:, :2].T
        assert np.all(x + y < 2.0 - 1e-5) or np.all(x + y > 2.0 + 1e-5)


def test_faces_around_an_edge_are_in_their_exact_order():
    rng = np.random.default_rng(0)
    for count in (3, 4, 6, 10):
        turns = np.sort(rng.uniform(0.0, 2.0 * np.pi, 2 * count)) + rng.uniform(0.0, 6.0)
        fan = np.column_stack([np.cos(turns), np.sin(turns), rng.uniform(-1.0, 1.0, 2 * count)])
        positions = np.concatenate([[[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], fan]).astype(np.float32)
        # wedge i of the solid lies between the faces 2 i and 2 i + 1 of the fan
        faces = [[1, 0, 2 + i] if i % 2 == 0 else [0, 1, 2 + i] for i in rng.permutation(2 * count)]
        edges = find_edges(positions, np.array(faces, np.int32), None).vertices
        pairs = {(min(o, q) - 2, max(o, q) - 2) for o, a, b, q in edges.tolist() if {a, b} == {0, 1}}
        assert pairs == {(2 * i, 2 * i + 1) for i in range(count)}


def test_third_sheet_at_an_edge_ends_there():
    positions = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0]], np.float32)
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]], np.int32)
    edges = find_edges(positions, faces, None).vertices
    at = edges[(np.minimum(edges[:, 1], edges[:, 2]) == 0) & (np.maximum(edges[:, 1], edges[:, 2]) == 1)]
    assert sorted(len({*row}) for row in at.tolist()) == [3, 4]


@pytest.mark.parametrize("name", ["torus", "sheet"])
def test_edges_take_less_than_forty_bytes_a_face(gpu, name):
    asset = asset_of({"torus": lambda: meshes.torus(64, 32), "sheet": lambda: meshes.sheet(62)}[name](), f"sized {name}")
    mesh = gpu.cache.edge_mesh(asset)
    assert mesh.nbytes < 40 * len(asset.faces)
    assert gpu.cache.edge_mesh(asset) is mesh
    assert gpu.cache.nbytes >= mesh.nbytes


def test_other_thresholds_give_nothing_to_the_gl(gpu):
    asset = asset_of(meshes.bumpy_sphere(3, 0.5), "thresholds")
    styles = {"ridge": {}, "valley": {}, "silhouette": None}
    drawn_with_lines(gpu, asset, styles | {"ridge_deg": 5.0})
    ink = []
    for degrees in (5.0, 10.0, 20.0, 170.0):
        lined = drawn_with_lines(gpu, asset, styles | {"ridge_deg": degrees, "valley_deg": degrees})
        assert lined.work.draws == 1
        assert lined.work.uploaded_bytes == 0
        ink.append(int(inked(lined.pixels).sum()))
    assert ink[0] > ink[1] > ink[2] > ink[3] == 0


def test_moved_mesh_draws_as_one_made_anew(gpu):
    shapes = [meshes.bumpy_sphere(3, amplitude, seed) for amplitude, seed in ((0.2, 0), (0.6, 1))]
    before, after = (asset_of(mesh, f"moving {i}") for i, mesh in enumerate(shapes))
    lines = {"ridge": {"color": "#ff0000"}, "valley": {"color": "#0000ff"}, "ridge_deg": 12.0, "valley_deg": 12.0}
    mesh = EdgeMesh.of(gpu.gl, before)
    unmoved = drawn_with_lines(gpu, after, lines, mesh=mesh).pixels
    mesh.move(after.positions)
    moved, anew = drawn_with_lines(gpu, after, lines, mesh=mesh), drawn_with_lines(gpu, after, lines)
    assert mesh.nbytes == gpu.cache.edge_mesh(after).nbytes
    mesh.release()
    same = np.all(moved.pixels == anew.pixels, axis=2)
    assert same.mean() > 0.9995
    assert np.all(unmoved == anew.pixels, axis=2).mean() < 0.98
    assert moved.work.uploaded_bytes == 0


def test_mesh_is_not_moved_to_fewer_vertices(gpu):
    mesh = EdgeMesh.of(gpu.gl, asset_of(meshes.cube(1), "still"))
    with pytest.raises(ValueError, match="8 vertices"):
        mesh.move(np.zeros((7, 3), np.float32))
    mesh.release()


NEAR_SURFACE = [[0.0, 0.0, 1.0005, 1.0], [0.7, 0.7, 0.3, 1.0], [1.2, 0.1, 0.0, 1.0], [3e5, -2e5, 1e6, 1.0], [0.3, 0.1, 0.2, 1.0]]


@pytest.mark.parametrize("backs_hidden", [False, True])
@pytest.mark.parametrize("name", ["bumpy", "torus", "L", "sheet"])
def test_kinds_in_the_shader_are_those_of_the_exact_rule(gpu, name, backs_hidden):
    asset = asset_of(SHAPES[name](), name)
    mesh = EdgeMesh.of(gpu.gl, asset)
    edges = find_edges(asset.positions, asset.faces, asset.edges)
    definitions = {"CREASES"} | ({"BORDERS"} if mesh.borders else set()) | ({"BACKS_HIDDEN"} if backs_hidden else set())
    program = gpu.ctx.program(vertex_shader=shader_source("edge_mesh.vert.glsl", definitions), varyings=["kind"])
    mesh.positions.use(1)
    gpu.programs.set(program, positions=1, only=-1, half_widths=(1.0, 1.0, 1.0, 1.0), ridge_deg=25.0, valley_deg=15.0)
    out = gpu.ctx.buffer(reserve=4 * mesh.count)
    for eye in [*meshes.eyes(12, nearest=1.05, farthest=4.0, orthographic=4), *np.array(NEAR_SURFACE)]:
        middle, rest, seen_from = as_the_shader_takes_it(eye)
        gpu.programs.set(program, middle=middle, middle_rest=rest, eye=seen_from)
        mesh.array(program).transform(out, gpu.ctx.POINTS, mesh.count)
        got = np.frombuffer(out.read(), np.int32)
        expected, doubtful = slow_kinds(asset.positions, edges, eye, backs_hidden)
        assert np.array_equal(got[~doubtful], expected[~doubtful])
        assert doubtful.mean() < 0.02 or name in ("L", "sheet")
    for one in (mesh, out, program):
        one.release()


def as_the_shader_takes_it(eye):
    """(middle, rest of it, eye less the middle), each as a tuple: of an eye (4,)."""
    near = eye[3] > 0.0 and np.linalg.norm(eye[:3]) < 2.0
    middle = eye[:3] if near else np.zeros(3)
    rounded = middle.astype(np.float32)
    less = np.append(eye[:3] - eye[3] * middle, eye[3]) / max(1.0, np.abs(eye).max())
    return tuple(rounded.tolist()), tuple((middle - rounded).astype(np.float32).tolist()), tuple(less.tolist())


def slow_kinds(positions, edges, eye, backs_hidden):
    """((e,) kind of each edge by the exact rule, (e,) whether a face beside it is within float32 of edge-on)."""
    o, a, b, q = edges.vertices.T
    left = front_facing(positions, np.column_stack([a, b, o]).astype(np.int32), eye)
    right = front_facing(positions, np.column_stack([b, a, q]).astype(np.int32), eye)
    border, folds = q == a, left != right
    kinds = np.select([border, folds, edges.angles > 25.0, edges.angles < -15.0], [1, 0, 2, 3], -1)
    if backs_hidden:
        kinds[~border & ~left & ~right] = -1
    p = positions.astype(np.float64)
    doubtful = np.zeros(len(edges.vertices), bool)
    for x, y, z in ((a, b, o), (b, a, q)):
        u, v, to_eye = p[y] - p[x], p[z] - p[x], eye[:3] - eye[3] * p[x]
        height = np.abs(np.einsum("ij,ij->i", np.cross(u, v), to_eye))
        doubtful |= ~border & (height <= 2e-6 * np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1) * np.linalg.norm(to_eye, axis=1))
    return kinds, doubtful
