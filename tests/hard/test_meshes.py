"""Meshes that are hard on purpose, through the whole pipeline: the right answer or a clear refusal, however they are turned."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from geometry.topology import signed_volume
from tests.hard.answers import assert_enclosed, assert_picture, assert_silhouettes
from tests.hard.pipeline import Outcome, through
from tests.hard.shapes import CLIPPED
from tests.hard.standing import standpoints
from tests.meshes import eyes

NAMES = [pytest.param(name, marks=pytest.mark.xdist_group(f"hard body: {name}")) for name in CLIPPED]
"""Tests of one body stay in one process of a parallel run, where it is made once."""


@cache
def made(name: str) -> Outcome:
    return through(CLIPPED[name]())


def general_eyes(count: int = 4) -> dict[str, np.ndarray]:
    """In no special position whatever the axes are."""
    return {f"eye {k}": eye for k, eye in enumerate(eyes(count, seed=8, orthographic=1))}


@pytest.mark.parametrize("name", NAMES)
def test_a_hard_body_is_clipped_by_a_hull_that_encloses_it(name):
    outcome = made(name)
    assert outcome.clips, outcome.reason
    assert outcome.manifest.capabilities["inner"].available
    assert_enclosed(outcome.asset)
    hull = outcome.manifest.hull
    gained = signed_volume(outcome.asset.hull["positions"], outcome.asset.hull["faces"]) - volume(outcome)
    assert hull.volume_excess == pytest.approx(gained / volume(outcome), rel=1e-3, abs=1e-6)
    assert gained >= -1e-12


def volume(outcome: Outcome) -> float:
    return signed_volume(outcome.asset.positions, outcome.asset.faces)


@pytest.mark.parametrize("name", NAMES)
def test_a_hard_body_has_exact_silhouettes_that_close(name):
    asset = made(name).asset
    hull = (asset.hull["positions"], asset.hull["faces"])
    assert_silhouettes(asset, general_eyes() | standpoints(asset.positions, asset.faces, hull))


@pytest.mark.parametrize("name", NAMES)
def test_a_hard_body_looks_as_rays_see_it(gpu, name):
    for eye in general_eyes(2).values():
        assert_picture(gpu, made(name).asset, eye)


@pytest.mark.parametrize("name", NAMES)
def test_what_a_hard_body_tells_of_itself_is_finite(name):
    outcome = made(name)
    told = outcome.manifest.model_dump(mode="json")
    assert all(np.isfinite(number) for number in numbers(told))
    asset = outcome.asset
    arrays = [asset.positions, asset.normals, *asset.hull.values(), *asset.maps.values()]
    assert all(np.isfinite(array.astype(np.float64)).all() for array in arrays)


def numbers(value):
    """All numbers in a JSON value."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return [number for item in value for number in numbers(item)]
    return [value] if isinstance(value, int | float) else []


TURNED, MIRRORED = "turned and in another order", "mirrored"
TURN = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
MIRROR = np.diag([-1.0, 1.0, 1.0])
WAYS = {TURNED: TURN, MIRRORED: MIRROR}


def another_way(mesh, way: str):
    """The same body, turned or mirrored without any rounding; when turned, its vertices, its faces and their corners in another order."""
    vertices, faces = mesh
    vertices = vertices @ WAYS[way].T
    if way == MIRRORED:
        return vertices, np.ascontiguousarray(faces[:, ::-1])
    rng = np.random.default_rng(6)
    place = rng.permutation(len(vertices))
    moved = np.empty_like(vertices)
    moved[place] = vertices
    return moved, np.roll(place[rng.permutation(faces)], 1, axis=1).astype(np.int32)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", NAMES)
def test_a_hard_body_is_the_same_however_it_is_turned_and_ordered(name, way):
    one, other = made(name), through(another_way(CLIPPED[name](), way))
    assert other.clips, other.reason
    assert (other.manifest.stats.faces, other.manifest.stats.components) == (one.manifest.stats.faces, one.manifest.stats.components)
    assert volume(other) == pytest.approx(volume(one), rel=1e-5, abs=1e-12)
    for label, eye in general_eyes(3).items():
        seen = np.array([*(WAYS[way] @ eye[:3]), eye[3]])
        edges = other.asset.tree.extract(seen).edges
        edges = edges[:, ::-1] if way == MIRRORED else edges
        assert segments(other.asset.positions @ WAYS[way], edges) == segments(one.asset.positions, one.asset.tree.extract(eye).edges), label


def segments(positions, edges):
    """Edges as a set of pairs of places."""
    places = positions.astype(np.float64) + 0.0
    return {tuple(map(tuple, places[edge].tolist())) for edge in edges}
