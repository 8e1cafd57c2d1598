"""Checks of levels and inner hulls: what is right passes, and tampering is named."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.errors import CorruptArtifactError
from tests.meshes import bumpy_sphere, normalised
from worker.enclosure import Solid
from worker.hull import build_hull
from worker.levels import hull_levels, silhouette_levels
from worker.verify_levels import sampled_points, verify_inner, verify_level


def quiet(_):
    pass


SEQUENCE = ("step_vertices", "step_positions", "level_faces", "level_steps")


@pytest.fixture(scope="module")
def made():
    positions, faces, _ = normalised(bumpy_sphere(3))
    hull, inner = (build_hull(positions, faces, 200, quiet, side=side) for side in ("outer", "inner"))
    (level,) = silhouette_levels(hull_levels(positions, faces, (hull.step_vertices, hull.step_positions), [300], quiet), quiet)
    return (positions, faces), level, {name: getattr(inner, name) for name in SEQUENCE}


@pytest.fixture
def level(made):
    """(original, level tensors, tree tensors) to tamper with."""
    tensors, tree = made[1].tensors(), made[1].tree.tensors()
    return Solid(*made[0]), *({name: array.copy() for name, array in part.items()} for part in (tensors, tree))


def refused(original, tensors, tree, match):
    with pytest.raises(CorruptArtifactError, match=match):
        verify_level(original, tensors, tree)


def test_what_the_stages_make_passes(made, level):
    report = verify_level(*level)
    assert report["grazing_points"] == 0 and 0.0 < report["farthest"] <= report["bound"]
    assert report["faces"] == 300
    assert verify_inner(level[0], made[2])["faces"] == [200]


def test_a_bound_that_points_exceed_is_named(level):
    level[1]["bound"] *= 0.9
    refused(*level, "further from the original")


def test_a_bound_that_is_no_number_is_named(level):
    level[1]["bound"][0] = np.nan
    refused(*level, "further from the original")


def test_a_vertex_pulled_into_the_original_is_named(level):
    level[1]["positions"][5] *= np.float32(0.9)
    refused(*level, "level hull is wrong|a cone")


def test_an_edge_with_its_faces_swapped_is_named(level):
    level[1]["edge_faces"][3] = level[1]["edge_faces"][3, ::-1].copy()
    refused(*level, "edge")


def test_a_tree_of_another_mesh_is_named(level):
    level[2]["edge_index"] = level[2]["edge_index"][:-3].copy()
    refused(*level, "tree is wrong")


def test_an_inner_hull_that_sticks_out_is_named(made):
    sequence = {**made[2], "step_positions": made[2]["step_positions"] * np.float32(1.2)}
    with pytest.raises(CorruptArtifactError, match="inner hull is wrong"):
        verify_inner(Solid(*made[0]), sequence)


def test_an_inner_level_beyond_its_sequence_is_named(made):
    sequence = {**made[2], "level_steps": np.array([10**6], np.int32)}
    with pytest.raises(CorruptArtifactError, match="steps that are not there"):
        verify_inner(Solid(*made[0]), sequence)


def test_samples_are_on_the_surface_and_all_over_it():
    positions, faces, _ = normalised(bumpy_sphere(2))
    points = sampled_points(positions, faces, 2000)
    assert np.array_equal(points[: len(positions)], positions.astype(np.float64))
    spread = points[len(positions) :]
    assert len(spread) == 2000
    octants = np.unique((spread > 0.0) @ [1, 2, 4], return_counts=True)[1]
    assert len(octants) == 8 and octants.min() > 150
    assert np.array_equal(points, sampled_points(positions, faces, 2000))
