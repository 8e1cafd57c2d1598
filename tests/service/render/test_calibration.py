from __future__ import annotations

from concurrent.futures import Future

import numpy as np
import pytest

from geometry.topology import build_edges
from schemas.render import Accuracy, RenderRequest
from service.costs import NOMINAL
from service.render.calibration import calibrate, octasphere, sphere
from service.render.frame import render_frame


@pytest.mark.parametrize("level", [0, 1, 3])
def test_octasphere_is_a_closed_sphere_of_so_many_faces(level):
    positions, faces = octasphere(level)
    assert len(faces) == 8 * 4**level
    assert np.allclose(np.linalg.norm(positions, axis=1), 1.0, atol=1e-6)
    edges = build_edges(faces)
    assert len(edges.vertices) == 3 * len(faces) // 2 and len(positions) - len(edges.vertices) + len(faces) == 2
    corners = positions[faces].astype(float)
    outward = np.einsum("ij,ij->i", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners.mean(axis=1))
    assert (outward > 0.0).all()


def test_the_hull_of_a_calibration_sphere_holds_it():
    asset = sphere(3, 2)
    corners = asset.hull["positions"].astype(float)[asset.hull["faces"]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", normals, corners[:, 0]).min() > 1.0


def test_calibration_finds_a_cost_for_every_kind_of_pass(gpu):
    def submit(asset, request):
        done = Future()
        done.set_result(render_frame(gpu, asset, request, true_times=True))
        return done

    found = calibrate(submit)
    assert set(found) == set(NOMINAL)
    assert all(value > 0.0 for of_pass in found.values() for value in of_pass.values())
    assert all(of_pass for of_pass in found.values())


def test_calibration_pictures_show_the_sphere(gpu):
    asset = sphere(3, 2)
    for antialias in ("none", "line", "coverage"):
        image = render_frame(gpu, asset, RenderRequest(width=96, height=96, accuracy=Accuracy(source="clipped", antialias=antialias)))
        assert (image.pixels[..., 3] > 0).mean() == pytest.approx(np.pi / 4 * 0.96, abs=0.06)
