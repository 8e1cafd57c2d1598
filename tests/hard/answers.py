"""What the right answer for a mesh is, by slow means that share nothing with the code that gives it."""

from __future__ import annotations

from collections import Counter

import numpy as np

from geometry.silhouettes import silhouette_scalar
from geometry.topology import build_edges
from schemas.render import Accuracy, RenderRequest
from service.render.frame import render_view
from service.silhouette.contours import link_contours
from tests import oracles
from tests.oracles_hull import surface_points, uncovered
from tests.oracles_integer import Facing, integers
from tests.service.oracles import covered_by_rays
from tests.service.render.made import seen_from

SIDE, SAMPLES = 24, 8
POINTS = 400
RATIONAL_FACES = 400
"""Meshes of more faces are held against the exact brute force only: rational arithmetic takes 30 us a face."""


def have_area(positions, faces):
    """(f,) bool, exactly."""
    rows, _ = integers(np.asarray(positions, np.float64)[faces].reshape(-1, 9))
    a, b, c = (rows[:, 3 * k : 3 * k + 3].T for k in range(3))
    p, q = b - a, c - a
    return np.logical_or.reduce([(p[i] * q[j] != p[j] * q[i]).astype(bool) for i, j in ((0, 1), (1, 2), (2, 0))])


def assert_enclosed(asset):
    """The hull is a closed oriented surface of faces with area that no point of the mesh is outside of."""
    hull, faces = asset.hull["positions"], asset.hull["faces"]
    build_edges(np.asarray(faces))
    assert have_area(hull, faces).all()
    points = np.concatenate([asset.positions.astype(np.float64), surface_points(asset.positions, asset.faces, POINTS)])
    outside = uncovered(asset.positions, asset.faces, hull, faces, points[:: max(1, len(points) // (2 * POINTS))])
    assert not outside.any()


def assert_silhouettes(asset, eyes):
    """For each of the eyes (label -> (4,)): tree, brute force and rational arithmetic agree; the edges form closed contours."""
    facing = Facing(asset.positions, asset.faces) if len(asset.faces) <= RATIONAL_FACES else None
    for label, eye in eyes.items():
        found = asset.tree.extract(eye).edges
        edges = oracles.edge_set(found)
        assert edges == oracles.edge_set(silhouette_scalar(asset.positions, asset.faces, *asset.edges, eye)), label
        if facing is not None:
            assert edges == oracles.silhouette_of(facing.front(eye), asset.faces), label
        assert Counter(a for a, _ in edges) == Counter(b for _, b in edges), label
        assert len(link_contours(found).vertices) == len(edges), label


def alpha(gpu, asset, eye):
    """(SIDE, SIDE) f8 coverage of the picture that the service gives for an eye (4,) in the normalised frame, and its view."""
    view = seen_from(asset, eye, SIDE)
    camera = {"eye": [0.0, 0.0, 1.0], "target": [0.0, 0.0, 0.0]}
    accuracy = Accuracy(antialias="coverage", source="clipped")
    request = RenderRequest(camera=camera, width=SIDE, height=SIDE, accuracy=accuracy)
    image = render_view(gpu, asset, request, view)
    assert image.pixels.shape == (SIDE, SIDE, 4)
    return image.pixels[..., 3] / 255.0, view


def assert_picture(gpu, asset, eye):
    """The picture covers what rays meet, to what so many samples and rounding leave open."""
    found, view = alpha(gpu, asset, eye)
    expected = covered_by_rays(view, asset.positions, asset.faces, SAMPLES)
    assert np.abs(found - expected).max() <= 2.5 / SAMPLES
    assert np.abs(found - expected).mean() <= 0.02
