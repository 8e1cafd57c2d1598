"""A leaf's 16-bit planes: what they are off is measured, and a face called sure is as the exact rule has it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from geometry.predicates import sees_front
from geometry.topology import build_edges
from service.kernels.tree_walk import (
    BELOW,
    BLOCK_WORDS,
    CORNERS,
    COUNTS,
    EDGES_BITS,
    FLIPPED,
    FORCED,
    HEAD_WORDS,
    LEAF,
    LINE,
    MORE_BIT,
    NEXT,
    PLANE,
    PLANE_WORDS,
    STEP,
    TURN_BITS,
    VERTICES_BITS,
    leaf_sides,
    sure_sides,
    turned_eyes,
)
from service.kernels.tree_walk_pack_leaves import STEEPEST, leaf_words, unit_planes
from service.silhouette.packing import pack_tree
from tests import eye_cases, meshes
from worker.tree import build_tree

SHAPES = {
    "cube": meshes.cube(3),
    "torus": meshes.torus(),
    "rough": meshes.bumpy_sphere(3, 0.6, 3),
    "needle": (meshes.bumpy_sphere(1)[0] * (1.0, 1e-12, 1e-12), meshes.bumpy_sphere(1)[1]),
    "flat": (meshes.bumpy_sphere(3)[0] * (1.0, 1.0, 1e-3), meshes.bumpy_sphere(3)[1]),
}


@njit
def sides_of(arena, at, eye):
    eyes = turned_eyes(eye)
    front, doubtful = sure_sides(arena, at, arena[at + COUNTS], eyes)
    over, alarm = leaf_sides(arena, at, arena[at + COUNTS], eyes)
    return front, doubtful, over, alarm


def leaves_of(arena):
    """Words at which the leaves begin."""
    blocks, seen = [0], []
    while blocks:
        at = blocks.pop()
        blocks += [int(b) for b in arena[at + BELOW : at + BELOW + 8] if b >= 0]
        blocks += [int(arena[at + NEXT])] if arena[at + NEXT] >= 0 else []
        for line in arena[at + LEAF : at + LEAF + 8]:
            more, leaf = line >= 0, LINE * int(line)
            while more:
                seen.append(leaf)
                counts = int(arena[leaf + COUNTS])
                more = counts >> MORE_BIT
                leaf += leaf_words(counts & 0xFF, counts >> EDGES_BITS & 0xFF, counts >> VERTICES_BITS & 0xFF)
    return seen


def packed(shape):
    positions, faces, _ = meshes.normalised(shape)
    edges = build_edges(faces)
    tree = build_tree(positions, faces, edges.vertices, edges.faces, lambda _: None)
    arena, _ = pack_tree(positions, faces, edges.vertices, edges.faces, tree.tensors())
    return positions, faces, arena


@pytest.fixture(scope="module")
def prepared():
    return {name: packed(shape) for name, shape in SHAPES.items()}


def corners_of(arena, at):
    """(n, 3) i4 of the faces of a leaf."""
    first, count = arena[at + CORNERS], arena[at + COUNTS] & 0xFF
    return arena[first : first + 3 * count].reshape(-1, 3)


def word(arena, at):
    return int(arena[at : at + 2].view(np.uint64)[0])


@pytest.mark.parametrize("name", SHAPES)
def test_stored_planes_are_off_by_no_more_than_the_leaf_says(prepared, name):
    positions, faces, arena = prepared[name]
    planes, checked = unit_planes(positions, faces), 0
    number_of = {tuple(corners): face for face, corners in enumerate(faces.tolist())}
    for at in leaves_of(arena):
        own = [number_of[tuple(corners)] for corners in corners_of(arena, at).tolist()]
        turn, row = int(arena[at + COUNTS]) >> TURN_BITS & 3, (len(own) + 7) // 8 * 8
        forced, flipped = word(arena, at + FORCED), word(arena, at + FLIPPED)
        plane = int(arena[at + CORNERS]) - PLANE_WORDS if forced else at
        head = arena[plane : plane + PLANE_WORDS].view(np.float32).astype(np.float64)
        assert not forced or not arena[at : at + PLANE_WORDS].any()
        numbers = arena[at + HEAD_WORDS :].view(np.int16)
        for i, face in enumerate(own):
            component = planes[face, turn]
            assert (forced >> i & 1) == (abs(component) < STEEPEST)
            if forced >> i & 1:
                continue
            assert (flipped >> i & 1) == (component < 0.0)
            for k, column in ((1, (turn + 1) % 3), (2, (turn + 2) % 3), (3, 3)):
                stored = head[PLANE + k] + head[STEP + k] * numbers[(k - 1) * row + i]
                assert abs(stored - head[PLANE] * planes[face, column] / component) <= 1.0
            checked += 1
    assert checked > 0 or name == "needle"


def assert_sure_sides_are_exact(prepared, name, eye):
    positions, _faces, arena = prepared[name]
    sure = 0
    for at in leaves_of(arena):
        front, doubtful, over, alarm = (int(bits) for bits in sides_of(arena, at, eye))
        assert alarm or doubtful == 0
        assert alarm or (over ^ front) & ((1 << len(corners_of(arena, at))) - 1) == 0
        for i, corners in enumerate(corners_of(arena, at)):
            if not doubtful >> i & 1:
                sure += 1
                assert front >> i & 1 == sees_front(positions, *corners, eye)
    return sure


@settings(max_examples=150, deadline=None)
@given(eye_cases.strategy(), st.sampled_from(sorted(SHAPES)))
def test_sure_sides_are_exact_for_any_eye(prepared, eye, name):
    assert_sure_sides_are_exact(prepared, name, eye)


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(["cube", "torus", "rough", "flat"]), st.data())
def test_sure_sides_are_exact_by_the_planes_of_faces(prepared, name, data):
    positions, faces, _ = prepared[name]
    corners = positions[faces[data.draw(st.integers(0, len(faces) - 1))]].astype(np.float64)
    s, t = (data.draw(st.floats(-4.0, 4.0)) for _ in range(2))
    beside = data.draw(st.sampled_from([0.0, 1e-7, -1e-7, 3e-7, -3e-7, 1e-6, -1e-6, 3e-6, -3e-6, 1e-5, -1e-5]))
    eye = corners[0] + s * (corners[1] - corners[0]) + t * (corners[2] - corners[0]) + beside
    assert_sure_sides_are_exact(prepared, name, np.array([*eye, 1.0]))


@pytest.mark.parametrize("name", ["torus", "rough", "flat"])
def test_nearly_all_sides_are_sure(prepared, name):
    _, _, arena = prepared[name]
    total = sum(len(corners_of(arena, at)) for at in leaves_of(arena))
    for eye in meshes.eyes(10):
        assert assert_sure_sides_are_exact(prepared, name, eye) >= 0.99 * total


@pytest.mark.parametrize("name", ["torus", "rough"])
def test_faces_of_every_direction_are_parted_into_leaves_with_planes(prepared, name):
    _, _, arena = prepared[name]
    assert not any(word(arena, at + FORCED) for at in leaves_of(arena))


def test_edges_between_perpendicular_faces_share_leaves(prepared):
    _, _, arena = prepared["cube"]
    forced = [at for at in leaves_of(arena) if word(arena, at + FORCED)]
    assert 0 < len(forced) < 12


def test_leaves_begin_on_cache_lines(prepared):
    for _, _, arena in prepared.values():
        assert arena.ctypes.data % (4 * LINE) == 0
        assert len(arena) > BLOCK_WORDS
