import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.silhouettes import silhouette_scalar
from geometry.topology import build_edges
from schemas.errors import CorruptArtifactError
from service.silhouette.extract import SilhouetteTree
from tests import eye_cases, meshes, oracles
from worker.tree import build_tree

ROOT = Path(__file__).resolve().parents[2]
SHAPES = {
    "cube": meshes.cube(2),
    "many coplanar faces": meshes.cube(12),
    "torus": meshes.torus(),
    "bumpy sphere": meshes.bumpy_sphere(3),
    "knot": meshes.knot(60, 8),
    "two components": meshes.joined(meshes.sphere(2), meshes.cube()),
    "tetrahedron": (
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32),
    ),
    "needle": (meshes.bumpy_sphere(1)[0] * (1.0, 1e-12, 1e-12), meshes.bumpy_sphere(1)[1]),
}


def quiet(_):
    return None


def tensors(positions, faces):
    """(mesh, tree) as stored."""
    edges = build_edges(faces)
    tree = build_tree(positions, faces, edges.vertices, edges.faces, quiet)
    return {"positions": positions, "faces": faces, "edge_vertices": edges.vertices, "edge_faces": edges.faces}, tree.tensors()


@pytest.fixture(scope="module")
def prepared():
    made = {}
    for name, shape in SHAPES.items():
        positions, faces, _ = meshes.normalised(shape)
        mesh, tree = tensors(positions, faces)
        made[name] = SilhouetteTree(mesh, tree)
    return made


def brute(tree, eye):
    return oracles.edge_set(silhouette_scalar(tree.positions, tree.faces, tree.edge_vertices, tree.edge_faces, eye))


@pytest.mark.parametrize("name", SHAPES)
def test_extraction_is_brute_force(prepared, name):
    tree = prepared[name]
    for eye in meshes.eyes(150, nearest=0.1, orthographic=50):
        assert oracles.edge_set(tree.extract(eye).edges) == brute(tree, eye)


@pytest.mark.parametrize("name", SHAPES)
def test_extraction_is_brute_force_for_awkward_eyes(prepared, name):
    tree = prepared[name]
    for label, eye in eye_cases.awkward(tree.positions, tree.faces).items():
        assert oracles.edge_set(tree.extract(eye).edges) == brute(tree, eye), label


@settings(max_examples=200, deadline=None)
@given(eye_cases.strategy(), st.sampled_from(sorted(SHAPES)))
def test_extraction_is_brute_force_for_any_eye(prepared, eye, name):
    tree = prepared[name]
    assert oracles.edge_set(tree.extract(eye).edges) == brute(tree, eye)


@settings(max_examples=25, deadline=None)
@given(eye_cases.strategy(), st.sampled_from(["cube", "torus", "two components"]))
def test_extraction_is_the_rational_silhouette(prepared, eye, name):
    tree = prepared[name]
    assert oracles.edge_set(tree.extract(eye).edges) == oracles.silhouette(tree.positions, tree.faces, eye)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(SHAPES)), st.data())
def test_extraction_is_brute_force_on_the_planes_of_faces(prepared, name, data):
    tree = prepared[name]
    corners = tree.positions[tree.faces[data.draw(st.integers(0, len(tree.faces) - 1))]].astype(np.float64)
    s, t = (data.draw(st.integers(-12, 12)) / 4.0 for _ in range(2))
    eye = np.array([*(corners[0] + s * (corners[1] - corners[0]) + t * (corners[2] - corners[0])), 1.0])
    assert oracles.edge_set(tree.extract(eye).edges) == brute(tree, eye)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 0.6), eye_cases.strategy())
def test_extraction_is_brute_force_on_random_meshes(seed, amplitude, eye):
    positions, faces, _ = meshes.normalised(meshes.bumpy_sphere(2, amplitude, seed))
    tree = SilhouetteTree(*tensors(positions, faces))
    assert oracles.edge_set(tree.extract(eye).edges) == brute(tree, eye)


def test_a_mesh_with_a_face_without_area_is_extracted_exactly():
    v, faces = meshes.sphere(2)
    a, b, c = faces[0]
    faces = np.concatenate([faces[1:], [[a, b, len(v)], [b, c, len(v)], [c, a, len(v)]]]).astype(np.int32)
    v[[a, b]] = np.round(v[[a, b]] * 64) / 64
    positions = np.concatenate([v, [(v[a] + v[b]) / 2.0]]).astype(np.float32)
    tree = SilhouetteTree(*tensors(positions, faces))
    for eye in meshes.eyes(100, nearest=0.1, orthographic=20):
        assert oracles.edge_set(tree.extract(eye).edges) == brute(tree, eye)


def test_positions_far_from_the_unit_sphere_are_extracted_exactly():
    v, faces = meshes.torus()
    tree = SilhouetteTree(*tensors((v * 1e-3 + 5.0).astype(np.float32), faces))
    for eye in meshes.eyes(40, orthographic=10):
        eye[:3] = eye[:3] * 2e-3 + 5.0 * eye[3]
        assert oracles.edge_set(tree.extract(eye).edges) == brute(tree, eye)


def test_few_edges_are_tested_on_a_smooth_mesh():
    positions, faces, _ = meshes.normalised(meshes.sphere(5))
    tree = SilhouetteTree(*tensors(positions, faces))
    found = tree.extract(np.array([0.3, 0.5, 2.5, 1.0]))
    assert 0 < len(found.edges) <= found.tested_edges < 0.35 * len(tree.edge_vertices)
    assert 0 < found.tested_nodes < 0.1 * len(tree.edge_vertices)


def same(found, expected):
    return np.array_equal(found.edges, expected.edges) and found[1:] == expected[1:]


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("name", SHAPES)
def test_many_eyes_in_one_call_are_each_as_alone(prepared, name, threads):
    tree = prepared[name]
    eyes = np.stack([*meshes.eyes(20, nearest=0.1, orthographic=5), *eye_cases.awkward(tree.positions, tree.faces).values()])
    for found, eye in zip(tree.extract_many(eyes, threads), eyes, strict=True):
        assert same(found, tree.extract(eye))


def test_no_eyes_have_no_silhouettes(prepared):
    assert prepared["torus"].extract_many(np.empty((0, 4)), threads=2) == []


@pytest.mark.parametrize("name", SHAPES)
def test_leaves_shared_out_to_threads_give_the_same_edges(prepared, name, monkeypatch):
    monkeypatch.setattr("service.silhouette.extract._LEAVES_A_THREAD", 1)
    monkeypatch.setattr("service.silhouette.extract._EDGES_TO_SHARE", 0)
    tree = prepared[name]
    for eye in [*meshes.eyes(10, orthographic=5), *eye_cases.awkward(tree.positions, tree.faces).values()]:
        shared, alone = tree.extract(eye, threads=3), tree.extract(eye)
        assert len(shared.edges) == len(alone.edges) and oracles.edge_set(shared.edges) == oracles.edge_set(alone.edges)
        assert shared[1:] == alone[1:]


def test_threads_share_a_tree(prepared):
    tree, eyes = prepared["bumpy sphere"], meshes.eyes(40)
    expected = [brute(tree, eye) for eye in eyes]
    wrong = []

    def work():
        for _ in range(20):
            for eye, edges in zip(eyes, expected, strict=True):
                if {(int(a), int(b)) for a, b in tree.extract(eye).edges} != edges:
                    wrong.append(eye)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_a_result_outlives_the_next_call(prepared):
    tree, (first, second) = prepared["torus"], meshes.eyes(2)
    edges = tree.extract(first).edges
    kept = edges.copy()
    tree.extract(second)
    assert np.array_equal(edges, kept)


def test_read_only_arrays_are_accepted():
    mesh, tree = tensors(*meshes.normalised(meshes.torus())[:2])
    for values in (*mesh.values(), *tree.values()):
        values.flags.writeable = False
    assert len(SilhouetteTree(mesh, tree).extract(np.array([2.0, 1.0, 1.0, 1.0])).edges)


@pytest.mark.parametrize("eye", [[np.nan, 0, 0, 1], [np.inf, 0, 0, 1], [0, 0, 1, 0.5], [0, 0, 1]])
def test_what_is_no_eye_is_refused(prepared, eye):
    with pytest.raises(ValueError, match="eye"):
        prepared["torus"].extract(np.array(eye, np.float64))
    with pytest.raises(ValueError, match="eye"):
        prepared["torus"].extract_many(np.array([eye], np.float64))


def _shortened(tree, mesh):
    return tree | {"edge_index": tree["edge_index"][:-1]}, mesh


def _doubled_edge(tree, mesh):
    return tree | {"edge_index": np.where(tree["edge_index"] == 0, 1, tree["edge_index"])}, mesh


def _backward_skip(tree, mesh):
    return tree | {"skip": np.zeros_like(tree["skip"])}, mesh


def _crossing_skip(tree, mesh):
    skip = np.arange(1, len(tree["skip"]) + 1, dtype=np.int32)
    skip[0], skip[1] = 3, 5
    return tree | {"skip": skip}, mesh


def _cone_not_finite(tree, mesh):
    return tree | {"scaled_normal": np.full_like(tree["scaled_normal"], np.nan)}, mesh


def _face_out_of_range(tree, mesh):
    return tree, mesh | {"edge_faces": mesh["edge_faces"] + np.int32(1)}


def _vertex_out_of_range(tree, mesh):
    return tree, mesh | {"faces": mesh["faces"] - np.int32(1)}


@pytest.mark.parametrize(
    "fault",
    [_shortened, _doubled_edge, _backward_skip, _crossing_skip, _cone_not_finite, _face_out_of_range, _vertex_out_of_range],
)
def test_a_tree_of_another_mesh_is_refused(fault):
    mesh, tree = tensors(*meshes.normalised(meshes.torus())[:2])
    tree, mesh = fault(tree, mesh)
    with pytest.raises(CorruptArtifactError):
        SilhouetteTree(mesh, tree)


PLAIN_CPU = """
import sys

import numpy as np

from service.kernels.tree_walk import LINE, walk
from service.kernels.tree_walk_leaf import WIDE

assert not WIDE
with np.load(sys.argv[1]) as stored:
    arena, positions, eyes = (stored[name] for name in ("arena", "positions", "eyes"))
    expected = [stored[f"edges {number}"] for number in range(len(eyes))]
    lanes, scratch, farthest = (stored[name].item() for name in ("lanes", "scratch", "farthest"))
lines = np.zeros(len(arena) + LINE, np.int32)
begin = -(lines.ctypes.data // lines.itemsize) % LINE
lines[begin : begin + len(arena)] = arena
positions.flags.writeable = False
for eye, edges in zip(eyes, expected, strict=True):
    found, _, _ = walk(lines[begin : begin + len(arena)], np.empty(scratch, np.int32), lanes, positions, eye, farthest)
    assert np.array_equal(found[np.lexsort(found.T)], edges)
print("same")
"""


def in_order(edges):
    return edges[np.lexsort(edges.T)]


@pytest.mark.heavy
def test_extraction_is_brute_force_on_a_cpu_without_wide_vectors(tmp_path):
    mesh, tensors_of_tree = tensors(*meshes.normalised(meshes.bumpy_sphere(3))[:2])
    tree = SilhouetteTree(mesh, tensors_of_tree)  # packed here, and the edges are found here: there all kernels are compiled again
    eyes = np.stack([*meshes.eyes(20, orthographic=5)])
    expected = [in_order(silhouette_scalar(tree.positions, tree.faces, tree.edge_vertices, tree.edge_faces, eye)) for eye in eyes]
    parts = {"arena": tree._arena, "positions": tree.positions, "eyes": eyes, "lanes": tree._lanes}
    parts |= {"scratch": len(tree._scratch.words), "farthest": tree._farthest_anchor}
    np.savez(tmp_path / "parts.npz", **parts, **{f"edges {number}": edges for number, edges in enumerate(expected)})
    environment = os.environ | {"NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", PLAIN_CPU, str(tmp_path / "parts.npz")]
    run = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=280, check=True)
    assert run.stdout == "same\n"


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["bunny_closed.ply", "fandisk.ply", "plate_holes.STL", "bones.ply", "ADIS16480.STL"])
def test_extraction_is_brute_force_on_real_meshes(name):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.load(meshes.shared(name), process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    positions, faces, _ = meshes.normalised((np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)))
    tree = SilhouetteTree(*tensors(positions, faces))
    for eye in meshes.eyes(50, nearest=0.3, orthographic=15):
        expected = silhouette_scalar(tree.positions, tree.faces, tree.edge_vertices, tree.edge_faces, eye)
        found = tree.extract(eye).edges
        assert np.array_equal(in_order(found), in_order(expected))
