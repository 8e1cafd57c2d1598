import numpy as np
import pytest

from service.camera import resolve_camera
from service.measure.views import spread_view
from tests import meshes


def directions(views):
    frame = meshes.normalised(meshes.sphere(1))[2]
    eyes = np.array([resolve_camera(spread_view(view, views), frame, 64, 64).eye[:3] for view in range(views)])
    return eyes / np.linalg.norm(eyes, axis=1)[:, None]


@pytest.mark.parametrize("views", [12, 100])
def test_no_direction_is_far_from_all_cameras_and_no_two_cameras_are_close(views):
    cameras = directions(views)
    rng = np.random.default_rng(0)
    anywhere = rng.normal(size=(4000, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1)[:, None]
    # caps of an even spread have this radius, in radians
    even = np.arccos(1.0 - 2.0 / views)
    assert np.arccos(np.clip((anywhere @ cameras.T).max(axis=1), -1, 1)).max() < 2.0 * even
    together = cameras @ cameras.T - 2.0 * np.eye(views)
    assert np.arccos(together.max()) > even


def test_cameras_balance_around_the_mesh():
    assert np.abs(directions(12).mean(axis=0)).max() < 0.1
