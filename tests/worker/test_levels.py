"""Silhouette levels: sizes worth having, hulls that enclose, bounds that hold, trees that find every edge."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.silhouettes import silhouette_scalar
from geometry.topology import build_edges, signed_volume
from schemas.artifacts import LEVEL_TREES, LEVELS, MOST_LEVELS
from schemas.errors import CancelledError
from service.silhouette.extract import SilhouetteTree
from tests.meshes import bumpy_sphere, eyes, knot, normalised
from tests.worker.test_distance import brute_farthest
from worker import levels as module
from worker.enclosure import enclosure_fault
from worker.hull import build_hull
from worker.levels import FEWEST_LEVELS, LEAST_FACES, LEAST_RATIO, build_levels, hull_levels, level_sizes


def quiet(_):
    pass


@pytest.mark.parametrize(
    ("faces", "hull"), [(2000, 500), (5120, 200), (69_664, 1000), (185_856, 500), (400_000, 2240), (871_306, 1000), (10**7, 400)]
)
def test_levels_go_from_coarser_than_the_mesh_down_to_its_hull_by_steps_worth_taking(faces, hull):
    sizes = level_sizes(faces, hull)
    assert 1 <= len(sizes) <= MOST_LEVELS
    assert sizes[-1] == hull
    ratios = np.array([faces, *sizes[:-1]]) / np.array(sizes)
    assert ratios.min() >= LEAST_RATIO * 0.99
    assert ratios.max() <= 1.01 * ratios.min()
    assert len(sizes) >= FEWEST_LEVELS or ratios.min() < LEAST_RATIO ** ((len(sizes) + 1) / len(sizes))


@pytest.mark.parametrize(("faces", "hull"), [(LEAST_FACES - 1, 4), (100_000, 60_000), (4, 4), (5000, 5000)])
def test_meshes_too_small_to_gain_have_no_levels(faces, hull):
    assert level_sizes(faces, hull) == []


@pytest.fixture(scope="module", params=[bumpy_sphere(4), knot(100, 16)], ids=["bumpy", "knot"])
def made(request):
    positions, faces, _ = normalised(request.param)
    hull = build_hull(positions, faces, 150, quiet)
    return (positions, faces), hull, build_levels(positions, faces, (hull.step_vertices, hull.step_positions), len(hull.faces), quiet)


def test_every_level_encloses_the_original_and_the_last_is_the_drawn_hull(made):
    original, hull, levels = made
    assert len(levels) >= 3
    for level in levels:
        assert enclosure_fault(*original, level.hull.positions, level.hull.faces) == 0
    assert np.array_equal(levels[-1].hull.faces, hull.faces)
    assert np.array_equal(levels[-1].hull.positions, hull.positions)


def test_no_point_of_a_level_is_further_than_its_bound(made):
    original, _, levels = made
    for level in levels:
        some = np.random.default_rng(0).choice(len(level.hull.faces), 30)
        assert brute_farthest((level.hull.positions, level.hull.faces[some]), original, 3) <= level.hull.bound
    assert [level.hull.bound for level in levels] == sorted(level.hull.bound for level in levels)


def test_a_levels_tree_finds_its_silhouette(made):
    _, _, levels = made
    for level in levels:
        tensors = level.tensors()
        tree = SilhouetteTree(tensors, level.tree.tensors())
        for eye in eyes(6, orthographic=2):
            mesh = (level.hull.positions, level.hull.faces, level.edge_vertices, level.edge_faces)
            assert set(map(tuple, tree.extract(eye).edges)) == set(map(tuple, silhouette_scalar(*mesh, eye)))


def test_volumes_are_over_the_originals(made):
    original, _, levels = made
    for level in levels:
        gained = signed_volume(level.hull.positions, level.hull.faces) / signed_volume(*original) - 1.0
        assert level.hull.volume_excess == pytest.approx(gained, rel=1e-6)


def test_tensors_fit_their_layouts(made):
    _, _, levels = made
    for level, layout, tree_layout in zip(levels, LEVELS, LEVEL_TREES, strict=False):
        assert {name: array.dtype.str for name, array in level.tensors().items()} == {n: kind for n, (kind, _) in layout.tensors.items()}
        assert set(level.tree.tensors()) == set(tree_layout.tensors)


def test_inner_hulls_have_their_distances_too():
    positions, faces, _ = normalised(bumpy_sphere(3))
    hull = build_hull(positions, faces, 100, quiet, side="inner")
    (level,) = hull_levels(positions, faces, (hull.step_vertices, hull.step_positions), [100], quiet)
    assert level.volume_excess < 0.0
    assert enclosure_fault(level.positions, level.faces, positions, faces) == 0
    assert brute_farthest((level.positions, level.faces), (positions, faces), 4) <= level.bound


def test_a_hull_that_reaches_too_far_out_is_no_level():
    positions, faces, _ = normalised(bumpy_sphere(2))
    steps = (np.array([[0, -1]], np.int32), np.array([[100.0, 0, 0]], np.float32))
    assert hull_levels(positions, faces, steps, [len(faces)], quiet) == []


def test_progress_rises_to_one_and_may_cancel(made, monkeypatch):
    (positions, faces), hull, _ = made
    monkeypatch.setattr(module, "LEAST_FACES", 4)
    steps, seen = (hull.step_vertices, hull.step_positions), []
    build_levels(positions, faces, steps, len(hull.faces), seen.append)
    assert seen == sorted(seen) and seen[-1] == 1.0 and len(seen) > 10

    def cancel(part):
        if part > 0.6:
            raise CancelledError("the mesh was deleted")

    with pytest.raises(CancelledError):
        build_levels(positions, faces, steps, len(hull.faces), cancel)


def test_edges_are_those_of_the_level(made):
    for level in made[2]:
        table = build_edges(level.hull.faces)
        assert np.array_equal(level.edge_vertices, table.vertices) and np.array_equal(level.edge_faces, table.faces)
