import numpy as np
import pytest

from benchmarks.models import AbsentError
from benchmarks.offset_hull import DistanceField, offset_hull
from geometry.topology import signed_volume
from tests.meshes import normalised, sphere
from tests.oracles_hull import surface_points, uncovered


def test_an_offset_hull_encloses_with_the_faces_asked_for():
    positions, faces, _ = normalised(sphere(3))
    points = np.concatenate([positions, surface_points(positions, faces, 500)])
    try:
        field = DistanceField(positions, faces, 40)
        made = offset_hull(field, points, 200)
    except AbsentError as absent:
        pytest.skip(str(absent))
    assert made is not None
    distance, hull_positions, hull_faces = made
    assert 0.0 < distance < 0.1
    assert len(hull_faces) <= 200
    assert signed_volume(hull_positions, hull_faces) > signed_volume(positions, faces)
    assert not uncovered(positions, faces, hull_positions, hull_faces, points).any()
