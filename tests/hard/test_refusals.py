"""What cannot be clipped is drawn from what it is, or refused, and says why; nothing in between."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.render import Accuracy, RenderRequest
from service.render.frame import render_view
from tests.hard.answers import SAMPLES, SIDE, assert_enclosed
from tests.hard.pipeline import double_ply, float_stl, through, uploaded
from tests.hard.shapes import cut_at_middles, klein_bottle, moved, octahedra_touching, voxels, with_faces_without_area
from tests.meshes import bumpy_sphere, cube, eyes, joined, sphere
from tests.service.oracles import covered_by_rays
from tests.service.render.made import seen_from


def half(mesh):
    """Without the faces below the middle."""
    vertices, faces = mesh
    return vertices, faces[vertices[faces].mean(axis=1)[:, 2] > 0.0]


def with_a_fin(mesh):
    """A lone triangle more, at an edge of the mesh."""
    vertices, faces = mesh
    return np.vstack([vertices, [[3.0, 0.1, 0.2]]]), np.vstack([faces, [[faces[0, 0], faces[0, 1], len(vertices)]]]).astype(np.int32)


def flat_and_closed():
    """Both sides of a square: closed, with nothing inside."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    top = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return square, np.vstack([top, top[:, ::-1]])


OPEN = {
    "a Klein bottle": (klein_bottle, "auto", "edge whose two faces have opposite directions|edges whose two faces have opposite"),
    "half a body": (lambda: half(bumpy_sphere(3)), "auto", "boundary edge"),
    "a lone fin": (lambda: with_a_fin(sphere(1)), "auto", "boundary edge"),
    "both sides of a square": (flat_and_closed, "auto", "bounds no volume|boundary edge"),
    "T-junctions that are not repaired": (lambda: cut_at_middles(cube(3), 0.1), "never", "boundary edge"),
    "bodies that touch along an edge and are not repaired": (lambda: octahedra_touching("edge"), "never", "more than two faces"),
    "bodies that touch at a vertex and are not repaired": (lambda: octahedra_touching("vertex"), "never", "touches itself at a vertex"),
    "a body inside out that is not repaired": (lambda: (sphere(1)[0], sphere(1)[1][:, ::-1]), "never", "inside out"),
}


@pytest.mark.parametrize("name", OPEN)
def test_what_is_no_closed_body_is_drawn_as_it_is_and_says_why(gpu, name):
    build, repair, reason = OPEN[name]
    outcome = through(build(), repair=repair)
    assert outcome.asset is not None and not outcome.clips
    assert any(words in outcome.reason for words in reason.split("|")), outcome.reason
    assert outcome.asset.hull is None and outcome.asset.tree is None
    eye = eyes(1, seed=8)[0]
    view = seen_from(outcome.asset, eye, SIDE)
    request = RenderRequest(
        camera={"eye": [0.0, 0.0, 1.0], "target": [0.0, 0.0, 0.0]}, width=SIDE, height=SIDE, accuracy=Accuracy(antialias="ssaa")
    )
    found = render_view(gpu, outcome.asset, request, view).pixels[..., 3] / 255.0
    both = np.concatenate([outcome.asset.faces, outcome.asset.faces[:, ::-1]])
    expected = covered_by_rays(view, outcome.asset.positions, both, SAMPLES)
    assert np.abs(found - expected).max() <= 0.4 and np.abs(found - expected).mean() <= 0.02


def collinear(count: int = 30):
    """Faces of points of a line."""
    t = np.linspace(0.0, 1.0, count + 2)
    return np.column_stack([t, 2 * t, -t]), np.column_stack([np.arange(count), np.arange(count) + 1, np.arange(count) + 2]).astype(np.int32)


def one_point():
    return np.full((3, 3), 0.3), np.array([[0, 1, 2]], np.int32)


def not_finite(value: float):
    vertices, faces = sphere(1)
    vertices[7, 1] = value
    return vertices, faces


REFUSED = {
    "no face has area": (collinear, "no-faces"),
    "all at one point": (one_point, "no-extent"),
    "a coordinate that is no number": (lambda: not_finite(np.nan), "non-finite-vertices"),
    "an infinite coordinate": (lambda: not_finite(-np.inf), "non-finite-vertices"),
    "a size beyond doubles": (lambda: moved(moved(cube(1), (-0.5,) * 3), scale=(3.4e308,) * 3), "non-finite-vertices"),
    "an index that is not there": (lambda: (sphere(1)[0], sphere(1)[1] + 5), "index-out-of-range"),
    "no faces": (lambda: (sphere(1)[0], np.empty((0, 3), np.int32)), "no-faces"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_mesh_is_refused_with_its_fault(name):
    build, code = REFUSED[name]
    outcome = through(build())
    assert outcome.problem is not None, outcome.reason
    assert (outcome.problem.status, outcome.problem.code) == (422, code), outcome.reason
    assert len(outcome.problem.detail) > 20


def test_what_float32_leaves_of_a_far_mesh_is_what_the_file_says():
    """An STL file has no room for a unit body ten million away: its corners lie on a grid of one unit, and that is what is drawn."""
    far = moved(bumpy_sphere(2), (1e7, 1e7, 1e7))
    outcome = uploaded(float_stl(far), "far.stl", hull_faces=100, texels=64)
    corners = np.unique(np.asarray(far[0], np.float32), axis=0)
    assert outcome.problem is not None or len(outcome.asset.positions) <= len(corners)


def test_a_file_of_denormal_float32_is_the_body_that_it_describes():
    outcome = uploaded(float_stl(moved(cube(2), scale=(1e-38, 1e-38, 1e-38))), "tiny.stl", hull_faces=100, texels=64)
    assert outcome.clips and outcome.manifest.stats.faces == 48


def test_the_two_sides_of_a_wall_between_bodies_are_no_fault():
    solid = np.zeros((3, 2, 2), bool)
    solid[0], solid[2] = True, True
    outcome = uploaded(double_ply(joined(voxels(solid), moved(voxels(np.ones((1, 2, 2), bool)), (1, 0, 0)))), "wall.ply", hull_faces=100)
    assert outcome.clips, outcome.reason


@pytest.mark.parametrize("repair", ["auto", "never"])
def test_a_hull_has_no_faces_without_area_though_it_may_keep_all_faces_of_a_body_that_has_some(repair):
    outcome = through(with_faces_without_area(sphere(1), 15), hull_faces=200, repair=repair)
    assert outcome.clips, outcome.reason
    assert_enclosed(outcome.asset)
