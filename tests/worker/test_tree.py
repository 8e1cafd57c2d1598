import itertools

import numpy as np
import pytest

from geometry.predicates import front_facing
from geometry.topology import build_edges
from schemas.artifacts import TREE
from tests import eye_cases, meshes
from worker.kernels import forest
from worker.kernels.cones import NO_CONE, miss_probability
from worker.kernels.gilbert import closest_to_origin
from worker.tree import Tree, build_tree

SHAPES = {
    "cube": meshes.cube(3),
    "torus": meshes.torus(),
    "bumpy sphere": meshes.bumpy_sphere(3),
    "knot": meshes.knot(60, 8),
    "two components": meshes.joined(meshes.sphere(2), meshes.cube()),
}


def quiet(_):
    return None


def built(mesh, progress=quiet):
    positions, faces, _ = meshes.normalised(mesh)
    edges = build_edges(faces)
    return build_tree(positions, faces, edges.vertices, edges.faces, progress), positions, faces, edges


def face_clusters(tree, edges):
    """F(n) of every node, as arrays of faces."""
    for i in range(len(tree.skip)):
        rows = tree.edge_index[tree.edge_start[i] : tree.edge_start[tree.skip[i]]]
        yield i, np.unique(edges.faces[rows])


def in_cones(tree, eye):
    """(front, back) (n,) bool: the eye is in the exact cone of the stored float32 values, rounding outward."""
    s, w = tree.scaled_normal.astype(np.float64), eye[3]
    sides = []
    for sign, anchor in ((1.0, tree.front_anchor), (-1.0, tree.back_anchor)):
        x = eye[:3] - w * anchor.astype(np.float64)
        along = sign * np.einsum("ij,ij->i", s, x)
        sides.append((along > 0) & (along**2 >= (x**2).sum(axis=1) * (1 - 1e-12)))
    return sides[0], sides[1] & (tree.separation < NO_CONE)


def reached(tree, eye):
    """(e,) bool: rows that the paper's walk tests."""
    culled = np.logical_or(*in_cones(tree, eye))
    found, i = np.zeros(len(tree.edge_index), bool), 0
    while i < len(tree.skip):
        if culled[i]:
            i = tree.skip[i]
            continue
        found[tree.edge_index[tree.edge_start[i] : tree.edge_start[i + 1]]] = True
        i += 1
    return found


@pytest.mark.parametrize("name", SHAPES)
def test_every_edge_is_in_exactly_one_node(name):
    tree, _, _, edges = built(SHAPES[name])
    assert np.array_equal(np.sort(tree.edge_index), np.arange(len(edges.vertices)))
    assert np.all(np.diff(tree.edge_start) >= 0)


@pytest.mark.parametrize("name", SHAPES)
def test_subtrees_are_nested(name):
    tree, *_ = built(SHAPES[name])
    ends = []
    for i, end in enumerate(tree.skip):
        while ends and ends[-1] <= i:
            ends.pop()
        assert not ends or end <= ends[-1]
        ends.append(end)


@pytest.mark.parametrize("name", SHAPES)
def test_an_eye_in_a_cone_has_the_whole_cluster_on_one_side(name):
    tree, positions, faces, edges = built(SHAPES[name])
    clusters = list(face_clusters(tree, edges))
    eyes = [*meshes.eyes(40, nearest=0.1, orthographic=15), *eye_cases.awkward(positions, faces).values()]
    for eye in eyes:
        side = front_facing(positions, faces, eye)
        front, back = in_cones(tree, eye)
        for i, cluster in clusters:
            assert not front[i] or side[cluster].all()
            assert not back[i] or not side[cluster].any()


def test_eyes_at_the_rim_of_a_cone_have_the_whole_cluster_on_one_side():
    tree, positions, faces, edges = built(meshes.bumpy_sphere(2))
    rng = np.random.default_rng(1)
    for i, cluster in face_clusters(tree, edges):
        s = tree.scaled_normal[i].astype(np.float64)
        length = np.linalg.norm(s)
        if length == 0.0:
            continue
        for sign, anchor in ((1.0, tree.front_anchor[i]), (-1.0, tree.back_anchor[i])):
            across = np.cross(s, rng.normal(size=3))
            across /= np.linalg.norm(across)
            rim = sign * s / length / length + across * np.sqrt(1.0 - 1.0 / length**2) * (1 - 1e-9)
            for far in (0.0, 1e-3, 1.0, 100.0):
                eye = np.array([*(anchor.astype(np.float64) + far * rim), 1.0])
                side = front_facing(positions, faces[cluster], eye)
                assert side.all() if sign > 0 else not side.any()


@pytest.mark.parametrize("name", SHAPES)
def test_no_culled_node_has_a_silhouette_edge(name):
    tree, positions, faces, edges = built(SHAPES[name])
    for eye in [*meshes.eyes(30, nearest=0.2, orthographic=10), *eye_cases.awkward(positions, faces).values()]:
        side = front_facing(positions, faces, eye)
        on_silhouette = side[edges.faces[:, 0]] != side[edges.faces[:, 1]]
        assert not np.any(on_silhouette & ~reached(tree, eye))


def test_a_smooth_mesh_is_mostly_culled():
    tree, _, _, edges = built(meshes.sphere(5))
    tested = [reached(tree, eye).sum() for eye in meshes.eyes(20)]
    assert np.median(tested) < 0.1 * len(edges.vertices)


def test_a_face_without_area_is_never_culled_as_back_facing():
    v, faces = meshes.sphere(2)
    a, b, c = faces[0]
    faces = np.concatenate([faces[1:], [[a, b, len(v)], [b, c, len(v)], [c, a, len(v)]]]).astype(np.int32)
    v = np.concatenate([v, [(v[a] + v[b]) / 2.0]])
    v[[a, b]] = np.round(v[[a, b]] * 64) / 64
    v[-1] = (v[a] + v[b]) / 2.0
    positions = v.astype(np.float32)
    edges = build_edges(faces)
    tree = build_tree(positions, faces, edges.vertices, edges.faces, quiet)
    flat = len(faces) - 3
    assert front_facing(positions, faces, np.array([0.0, 0, 0, 1]))[flat]
    for i, cluster in face_clusters(tree, edges):
        assert flat not in cluster or tree.separation[i] in (NO_CONE, 0.0)
    for eye in meshes.eyes(50, orthographic=10):
        side = front_facing(positions, faces, eye)
        assert not np.any((side[edges.faces[:, 0]] != side[edges.faces[:, 1]]) & ~reached(tree, eye))


def test_faces_too_thin_for_a_normal_are_never_culled():
    v, faces = meshes.bumpy_sphere(1)
    tree, _, _, edges = built((v * (1.0, 1e-12, 1e-12), faces))
    thin = 0
    for i, _ in face_clusters(tree, edges):
        thin += not tree.scaled_normal[i].any()
    assert thin > 0


def test_the_same_mesh_gives_the_same_tree():
    first, *_ = built(SHAPES["torus"])
    second, *_ = built(SHAPES["torus"])
    for name, values in first.tensors().items():
        assert np.array_equal(values, second.tensors()[name])


def test_tensors_are_those_of_the_artifact():
    tree, *_ = built(SHAPES["torus"])
    tensors = tree.tensors()
    assert set(tensors) == set(TREE.tensors)
    for name, (dtype, _) in TREE.tensors.items():
        assert tensors[name].dtype == np.dtype(dtype)


def test_progress_rises_to_one():
    seen = []
    built(SHAPES["bumpy sphere"], seen.append)
    assert seen[0] == 0.0
    assert seen[-1] == 1.0
    assert all(a <= b for a, b in itertools.pairwise(seen))


@pytest.mark.parametrize("after", [1, 3, 5])
def test_what_progress_raises_ends_the_build(after):
    calls = itertools.count(1)

    def cancel(_):
        if next(calls) >= after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        built(SHAPES["bumpy sphere"], cancel)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e3])
def test_positions_outside_the_normalised_frame_are_refused(wrong):
    positions, faces, _ = meshes.normalised(meshes.cube())
    positions[0, 0] = wrong
    edges = build_edges(faces)
    with pytest.raises(ValueError, match="finite"):
        build_tree(positions, faces, edges.vertices, edges.faces, quiet)


def test_a_tree_that_loses_edges_is_refused():
    tree, *_ = built(meshes.cube())
    with pytest.raises(ValueError, match="share out"):
        Tree(**(tree.tensors() | {"edge_index": tree.edge_index[:-1]}))


def closest(points):
    index, simplex = np.arange(len(points), dtype=np.int32), np.empty(3, np.int32)
    *v, least, _ = closest_to_origin(points, index, len(points), simplex)
    return np.array(v), least


def test_the_closest_point_of_a_hull_supports_it():
    rng = np.random.default_rng(2)
    for _ in range(200):
        axis = rng.normal(size=3)
        points = rng.normal(size=(rng.integers(1, 30), 3)) * rng.uniform(0.05, 1.0) + axis / np.linalg.norm(axis)
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        v, least = closest(points)
        if least > 0.0:
            assert (points @ v).min() >= v @ v - 1e-7
        else:
            directions = rng.normal(size=(2000, 3))
            assert (points @ directions.T).min(axis=0).max() < 0.1


def test_a_hull_around_the_origin_has_no_cone():
    assert closest(np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]))[1] <= 0.0


def test_the_probability_of_missing_both_cones_is_a_volume():
    rng = np.random.default_rng(3)
    radius, axis = 4.0, np.array([0.6, 0.0, 0.8])
    eyes = rng.uniform(-radius, radius, (200_000, 3))
    eyes = eyes[(eyes**2).sum(axis=1) < radius**2]
    for opening_deg, depth, aside in ((80, 0.1, 0.0), (50, 1.5, 0.2), (20, 0.5, 0.5)):
        opening = np.radians(opening_deg)
        lateral = np.array([0.0, aside, 0.0])
        front, back = axis * depth + lateral, -axis * depth + lateral
        missed = np.ones(len(eyes), bool)
        for sign, anchor in ((1.0, front), (-1.0, back)):
            x = eyes - anchor
            missed &= sign * (x @ axis) < np.linalg.norm(x, axis=1) * np.cos(opening)
        predicted = miss_probability(axis, np.sin(opening), front, back, True, radius)
        assert predicted == pytest.approx(missed.mean(), abs=0.02)


def test_a_join_is_worth_the_fall_of_the_forest_cost():
    def cost(*nodes):
        return sum(miss * weight for miss, weight in nodes)

    ka = forest.CONE_COST
    miss_a, weight_a, miss_b, weight_b, miss = 0.1, 3.0, 0.2, 5.0, 0.25
    before = 2 * ka + cost((miss_a, weight_a), (miss_b, weight_b))
    after = {
        forest.PARENT: ka + cost((miss, 2 * ka), (miss_a, weight_a), (miss_b, weight_b)),
        forest.ADOPT_FIRST: ka + cost((miss, weight_a + ka), (miss_b, weight_b)),
        forest.ADOPT_SECOND: ka + cost((miss, weight_b + ka), (miss_a, weight_a)),
        forest.MERGE: ka + cost((miss, weight_a + weight_b)),
    }
    change, join = forest.best_join(miss, weight_a, weight_b, miss_a, miss_b, 1, 1)
    assert join == min(after, key=after.get)
    assert change == pytest.approx(after[join] - before)


def test_trees_are_not_higher_than_the_limit():
    tree, *_ = built(meshes.torus(120, 6))
    height, ends = 0, []
    for i, end in enumerate(tree.skip):
        while ends and ends[-1] <= i:
            ends.pop()
        ends.append(end)
        height = max(height, len(ends))
    assert height <= forest.HIGHEST
