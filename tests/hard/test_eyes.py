"""Wherever the eye is: exact silhouettes, closed contours, and the right picture or a clear refusal."""

from __future__ import annotations

from collections import Counter
from functools import cache
from itertools import pairwise, permutations, product

import numpy as np
import pytest
from scipy.ndimage import binary_erosion
from scipy.spatial import Delaunay

from geometry.silhouettes import face_planes, silhouette_edgewise, silhouette_scalar, silhouette_simd
from geometry.topology import build_edges
from schemas.errors import SilhouetteError
from schemas.render import Accuracy, Camera, RenderRequest
from service.camera import resolve_camera
from service.render.frame import render_frame
from service.silhouette.contours import link_contours
from service.silhouette.extract import SilhouetteTree
from service.silhouette.project import project_edges
from tests import oracles
from tests.hard.standing import UNIT, framed, standpoints, unframed
from tests.service.oracles import covered_by_rays
from tests.service.render.made import clippable, grown

SHAPES = ("cube", "torus", "knot", "joined")
SIDE, SAMPLES = 20, 6
CLIPPED = ("none", "line", "coverage")
RUNGS = list(product(("auto", "original", "clipped"), ("none", "line", "coverage", "msaa", "ssaa")))


@cache
def stood(name):
    """(asset in its normalised frame, label -> eye)."""
    asset = unframed(clippable(name))
    return asset, standpoints(asset.positions, asset.faces, (asset.hull["positions"], asset.hull["faces"]))


def brute(positions, faces, eye):
    edges = build_edges(faces)
    return oracles.edge_set(silhouette_scalar(positions, faces, edges.vertices, edges.faces, eye))


@pytest.mark.parametrize("name", SHAPES)
def test_every_way_to_a_silhouette_gives_the_rational_one(name):
    asset, eyes = stood(name)
    table = (asset.positions, asset.faces, *asset.edges)
    planes = face_planes(asset.positions, asset.faces)
    for label, eye in eyes.items():
        expected = oracles.silhouette(asset.positions, asset.faces, eye)
        assert oracles.edge_set(asset.tree.extract(eye).edges) == expected, label
        assert oracles.edge_set(silhouette_scalar(*table, eye)) == expected, label
        assert oracles.edge_set(silhouette_simd(planes, *table, eye)) == expected, label
        assert oracles.edge_set(silhouette_edgewise(planes, *table, eye)) == expected, label


@pytest.mark.parametrize("name", SHAPES)
def test_contours_close_and_use_every_edge_once(name):
    asset, eyes = stood(name)
    for label, eye in eyes.items():
        edges = asset.tree.extract(eye).edges
        assert Counter(edges[:, 0].tolist()) == Counter(edges[:, 1].tolist()), label
        loops = link_contours(edges)
        around = []
        for begin, end in pairwise(loops.offsets):
            loop = loops.vertices[begin:end].tolist()
            assert len(set(loop)) == len(loop) >= 2, label
            around += zip(loop, loop[1:] + loop[:1], strict=True)
        assert len(around) == len(edges), label
        assert set(around) == oracles.edge_set(edges), label


def turns():
    """The 48 signed permutations of the axes: 24 rotations and 24 mirrorings, all exact in any floating point."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            yield np.diag(signs)[list(order)]


@pytest.mark.parametrize("name", ["cube", "joined"])
def test_turned_and_mirrored_meshes_have_the_same_silhouettes(name):
    asset, eyes = stood(name)
    expected = {label: brute(asset.positions, asset.faces, eye) for label, eye in eyes.items()}
    for number, turn in enumerate(turns()):
        mirrored = np.linalg.det(turn) < 0.0
        positions = np.ascontiguousarray(asset.positions @ turn.T.astype(np.float32))
        faces = np.ascontiguousarray(asset.faces[:, ::-1]) if mirrored else asset.faces
        edges = build_edges(faces)
        # a tree takes longer to grow than the rest of this: every sixth pose has one
        tree = grown_tree(positions, faces) if number % 6 == 0 else None
        for label, eye in eyes.items():
            seen = np.array([*(turn @ eye[:3]), eye[3]])
            found = [silhouette_scalar(positions, faces, edges.vertices, edges.faces, seen)]
            found += [] if tree is None else [tree.extract(seen).edges]
            for one in found:
                # of a mirrored face the other side is on the left
                same = oracles.edge_set(one[:, ::-1] if mirrored else one)
                assert same == expected[label], (label, turn.tolist())


def grown_tree(positions, faces):
    edges = build_edges(faces)
    mesh = {"positions": positions, "faces": faces, "edge_vertices": edges.vertices, "edge_faces": edges.faces}
    return SilhouetteTree(mesh, grown(positions, faces, edges))


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("seed", [1, 2])
def test_reordered_meshes_have_the_same_silhouettes(name, seed):
    asset, eyes = stood(name)
    rng = np.random.default_rng(seed)
    place = rng.permutation(len(asset.positions)).astype(np.int32)
    positions = np.empty_like(asset.positions)
    positions[place] = asset.positions
    faces = place[rng.permutation(asset.faces)]
    faces = np.ascontiguousarray(np.take_along_axis(faces, (np.arange(3) + rng.integers(0, 3, (len(faces), 1))) % 3, axis=1))
    tree = grown_tree(positions, faces)
    for label, eye in eyes.items():
        expected = {(int(place[a]), int(place[b])) for a, b in brute(asset.positions, asset.faces, eye)}
        assert oracles.edge_set(tree.extract(eye).edges) == expected, label
        assert brute(positions, faces, eye) == expected, label


@pytest.mark.parametrize("aside", [False, True], ids=["at the middle", "aside"])
@pytest.mark.parametrize("name", SHAPES)
def test_signed_coverage_is_finite_whatever_lies_at_the_eye(name, aside):
    asset, eyes = stood(name)
    for label, eye in eyes.items():
        view = seen(asset, eye, aside)
        segments = project_edges(view, asset.positions, asset.tree.extract(view.eye).edges)
        assert np.isfinite(segments).all(), label
        signed = (segments[:, 3] - segments[:, 1]) * (segments[:, 0] + segments[:, 2]) / 2.0
        assert np.isfinite(signed.sum()), label


def seen(asset, eye, aside):
    return resolve_camera(Camera(**framed(asset, eye, SIDE, SIDE, aside=aside)), UNIT, SIDE, SIDE, asset.radius)


@pytest.mark.parametrize("aside", [False, True], ids=["at the middle", "aside"])
@pytest.mark.parametrize("name", SHAPES)
def test_picture_is_what_rays_meet_or_is_refused(gpu, name, aside):
    asset, eyes = stood(name)
    convex = Delaunay(asset.hull["positions"].astype(np.float64))
    wrong = []
    for label, eye in eyes.items():
        camera = Camera(**framed(asset, eye, SIDE, SIDE, aside=aside))
        view = resolve_camera(camera, UNIT, SIDE, SIDE, asset.radius)
        # from inside the backs of faces are seen: those count as well
        truth = covered_by_rays(view, asset.positions, np.concatenate([asset.faces, asset.faces[:, ::-1]]), SAMPLES)
        enclosed = eye[3] == 1.0 and convex.find_simplex(eye[None, :3])[0] >= 0
        for source, antialias in RUNGS:
            fault = fault_of(gpu, asset, camera, source, antialias, truth, refusable=enclosed)
            wrong += [] if fault is None else [f"{label}: {source}/{antialias}: {fault}"]
    assert not wrong, "\n".join(wrong)


def fault_of(gpu, asset, camera, source, antialias, truth, *, refusable):
    """What is wrong with one picture, None where it is right."""
    must_refuse = source == "clipped" and (refusable or antialias not in CLIPPED)
    request = RenderRequest(camera=camera, width=SIDE, height=SIDE, accuracy=Accuracy(source=source, antialias=antialias))
    try:
        image = render_frame(gpu, asset, request)
    except SilhouetteError as error:
        if not must_refuse:
            return f"refused: {error}"
        return None if error.code and error.where.get("field", "").startswith("accuracy.") else "refused without a field"
    if must_refuse:
        return "not refused"
    return picture_fault(image.pixels[:, :, 3] / 255.0, truth, image.rung.split("/")[1])


def picture_fault(alpha, truth, antialias):
    """How an alpha differs from the part of each pixel that is covered, by more than its antialiasing does."""
    if antialias == "coverage" and np.abs(alpha - truth).max() > 2.0 / SAMPLES:
        return f"coverage is off by {np.abs(alpha - truth).max():.3f}"
    if antialias == "none" and not np.isin(alpha, (0.0, 1.0)).all():
        return "neither covered nor not"
    for value in (0.0, 1.0):
        certain = binary_erosion(truth == value, np.ones((3, 3), bool), border_value=1)
        off = int((alpha[certain] != value).sum())
        if off:
            return f"{off} of {int(certain.sum())} pixels that are certainly {value:.0f} are not"
    return None
