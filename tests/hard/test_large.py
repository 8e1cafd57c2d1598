"""Hard meshes of full size: what is hard about them must not cost more than their size does."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.topology import build_edges, signed_volume
from tests.hard.answers import assert_enclosed, assert_silhouettes
from tests.hard.pipeline import through
from tests.hard.shapes import bipyramid, many_components, pierced_slab
from tests.hard.standing import standpoints
from tests.meshes import cube, normalised
from tests.service.render.made import quiet
from worker.hull import build_hull
from worker.kernels.verify_enclosure import without_area

pytestmark = pytest.mark.heavy


def test_a_cube_of_ten_thousand_faces_a_side_becomes_twelve_without_any_gain():
    positions, faces, _ = normalised(cube(71))
    assert len(faces) // 6 > 10_000
    hull = build_hull(positions, faces, 12, quiet)
    assert len(hull.faces) == 12
    assert hull.volume_excess == 0.0
    assert signed_volume(hull.positions, hull.faces) == pytest.approx(signed_volume(positions, faces), rel=1e-12)
    assert not without_area(hull.positions, hull.faces).any()


def test_a_vertex_of_twenty_thousand_edges_is_collapsed_and_enclosed():
    positions, faces, _ = normalised(bipyramid(20_000))
    hull = build_hull(positions, faces, 100, quiet)
    assert len(hull.faces) == 100
    # a polygon of fifty sides about a circle gains 0.13 %
    assert hull.volume_excess < 0.003
    build_edges(hull.faces)


@pytest.mark.parametrize(("name", "build"), [("5,000 components", lambda: many_components(5_000)), ("genus 50", pierced_slab)])
def test_a_body_of_very_many_parts_or_holes_goes_through_every_stage(name, build):
    mesh = build()
    outcome = through(mesh)
    assert outcome.clips, outcome.reason
    stats = outcome.manifest.stats
    euler = stats.vertices - stats.edges + stats.faces
    if name == "genus 50":
        assert (stats.components, euler) == (1, 2 - 2 * 50)
    else:
        assert (stats.components, euler) == (5_000, 2 * 5_000)
    asset = outcome.asset
    assert_enclosed(asset)
    assert_silhouettes(asset, standpoints(asset.positions, asset.faces))
    assert np.isfinite(outcome.manifest.hull.volume_excess)
