"""Replaying a stored sequence, against a slow replay that keeps a list of faces."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.hull_sequence import MOVE, cut_hull, replay_steps, steps_to
from geometry.topology import NotManifoldError, build_edges
from tests.meshes import normalised, sphere


class SlowMesh:
    """Faces as lists of vertex numbers; vanished ones are None."""

    def __init__(self, positions, faces):
        self.positions = positions.copy()
        self.faces = [list(f) for f in faces.tolist()]

    def edge(self, a, b):
        """The two faces beside an edge, the one that has it from a to b first."""
        directed = [f and [(f[k], f[(k + 1) % 3]) for k in range(3)] for f in self.faces]
        return [next(i for i, d in enumerate(directed) if d and way in d) for way in ((a, b), (b, a))]

    def flip(self, a, b):
        f, g = self.edge(a, b)
        apex_f, apex_g = (next(v for v in self.faces[i] if v not in (a, b)) for i in (f, g))
        larger, smaller = max(a, b), min(a, b)
        self.faces[f] = [apex_g if v == larger else v for v in self.faces[f]]
        self.faces[g] = [apex_f if v == smaller else v for v in self.faces[g]]
        return f, g

    def collapse(self, a, b):
        merged = [f and [a if v == b else v for v in f] for f in self.faces]
        self.faces = [f if f and len(set(f)) == 3 else None for f in merged]

    def sound(self):
        try:
            build_edges(np.array([f for f in self.faces if f], np.int32))
        except (NotManifoldError, ValueError):
            return False
        return True

    def mesh(self):
        kept = np.array([f for f in self.faces if f])
        used = np.unique(kept)
        return self.positions[used], np.searchsorted(used, kept)


def random_steps(positions, faces, seed, count):
    """Random sound steps and what the slow mesh is after each."""
    rng = np.random.default_rng(seed)
    slow, steps, places, states = SlowMesh(positions, faces), [], [], [SlowMesh(positions, faces).mesh()]
    while len(steps) < count:
        before = [f and list(f) for f in slow.faces], slow.positions.copy()
        alive = [f for f in slow.faces if f]
        a, b = rng.permutation(alive[rng.integers(len(alive))])[:2].tolist()
        place = rng.normal(size=3).astype(np.float32)
        kind = rng.integers(3)
        if kind == 0 and len(alive) > 8:
            slow.collapse(a, b)
            slow.positions[a] = place
            step = (a, b)
        elif kind == 1:
            f, g = slow.flip(a, b)
            step = (~f, ~g)
        else:
            slow.positions[a] = place
            step = (a, MOVE)
        if not slow.sound():
            slow.faces, slow.positions = before
            continue
        steps.append(step)
        places.append(place)
        states.append(slow.mesh())
    return np.array(steps, np.int32), np.array(places, np.float32), states


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_every_prefix_is_what_the_steps_say(seed):
    positions, faces, _ = normalised(sphere(1))
    vertices, places, states = random_steps(positions, faces, seed, 40)
    for count in range(0, 41, 5):
        moved, kept = replay_steps(positions, faces, vertices, places, count)
        assert np.array_equal(moved, states[count][0])
        assert np.array_equal(kept, states[count][1])


def test_flips_name_faces_the_same_way_on_a_mesh_turned_inside_out():
    positions, faces, _ = normalised(sphere(1))
    vertices, places, _ = random_steps(positions, faces, 3, 60)
    inside_out = replay_steps(positions, np.ascontiguousarray(faces[:, ::-1]), vertices, places, 60)[1]
    assert np.array_equal(inside_out[:, ::-1], replay_steps(positions, faces, vertices, places, 60)[1])


def test_a_cut_takes_the_moves_that_follow_its_last_collapse():
    steps = np.array([(0, MOVE), (3, 4), (5, MOVE), (~9, ~10), (1, 2)], np.int32)
    assert steps_to(steps, 80, 80) == 1
    assert steps_to(steps, 80, 79) == steps_to(steps, 80, 78) == 4
    assert steps_to(steps, 80, 76) == steps_to(steps, 80, 4) == 5


def test_no_steps_leave_the_original():
    positions, faces, _ = normalised(sphere(1))
    cut = cut_hull(positions, faces, np.empty((0, 2), np.int32), np.empty((0, 3), np.float32), 4)
    assert np.array_equal(cut[0], positions)
    assert np.array_equal(cut[1], faces)
