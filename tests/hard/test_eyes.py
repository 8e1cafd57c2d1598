"""Wherever the eye is: exact silhouettes, closed contours, and the right picture or a clear refusal."""

from __future__ import annotations

from collections import Counter
from functools import cache
from itertools import pairwise, permutations, product

import numpy as np
import pytest
from scipy.ndimage import binary_erosion
from scipy.spatial import ConvexHull

from geometry.silhouettes import face_planes, silhouette_edgewise, silhouette_scalar, silhouette_simd
from geometry.topology import build_edges
from schemas.errors import InvalidRequestError, SilhouetteError
from schemas.render import Accuracy, Camera, ProjectTo, RenderRequest, Shading, SilhouetteRequest
from service.camera import resolve_camera
from service.render.choice import CERTAIN
from service.render.frame import render_frame
from service.silhouette.contours import link_contours
from service.silhouette.coverage import coverage_mask
from service.silhouette.describe import describe_silhouette
from service.silhouette.extract import SilhouetteTree
from service.silhouette.project import project_edges
from tests import oracles
from tests.hard.standing import UNIT, framed, standpoints, unframed
from tests.oracles_integer import Facing
from tests.rays import covered, layers
from tests.service.render.made import clippable, grown

SHAPES = ("cube", "torus", "knot", "joined")
SIDE, SAMPLES = 20, 6
RESOLUTION = 1e-7
"""Normalised units, a little more than float32 positions are off by."""
FOLDED = 16
"""So many inner pixels may be half clear on the rung `line`: folds of the contour narrower than a pixel look like outlines to it."""
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
    planes, facing = face_planes(asset.positions, asset.faces), Facing(asset.positions, asset.faces)
    for label, eye in eyes.items():
        expected = oracles.silhouette_of(facing.front(eye), asset.faces)
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
    wrong = []
    for label, eye in eyes.items():
        camera = Camera(**framed(asset, eye, SIDE, SIDE, aside=aside))
        truths = seen_from_here(asset, eye, camera)
        depth = depth_in_convex_hull(asset, eye)
        for source, antialias in RUNGS:
            fault = fault_of(gpu, asset, camera, source, antialias, truths, depth)
            wrong += [] if fault is None else [f"{label}: {source}/{antialias}: {fault}"]
    assert not wrong, "\n".join(wrong)


def fault_of(gpu, asset, camera, source, antialias, truths, depth):
    """What is wrong with one picture, None where it is right."""
    must_refuse = source == "clipped" and (depth > 0.0 or antialias not in CLIPPED)
    may_refuse = source == "clipped" and depth > -CERTAIN
    accuracy, white = Accuracy(source=source, antialias=antialias), Shading(color="#ffffff", ambient=1.0)
    request = RenderRequest(camera=camera, width=SIDE, height=SIDE, accuracy=accuracy, shading=white)
    try:
        image = render_frame(gpu, asset, request)
    except SilhouetteError as error:
        if not (must_refuse or may_refuse):
            return f"refused: {error}"
        return None if error.code and error.where.get("field", "").startswith("accuracy.") else "refused without a field"
    if must_refuse:
        return "not refused"
    if not (image.pixels[image.pixels[:, :, 3] > 0][:, :3] == 255).all():
        return "white is not white everywhere"
    return picture_fault(image.pixels[:, :, 3] / 255.0, truths, image.rung.split("/")[1])


def depth_in_convex_hull(asset, eye):
    """How far an eye is inside the convex hull of the drawn hull, negative outside."""
    if eye[3] == 0.0:
        return -np.inf
    planes = ConvexHull(asset.hull["positions"].astype(np.float64)).equations
    return float(-(planes[:, :3] @ eye[:3] + planes[:, 3]).max())


def seen_from_here(asset, eye, camera):
    """(k, h, w) f8 covered parts of pixels: what is right from here, and from where rounding positions to float32 may move the eye."""
    places = [eye[:3]]
    if eye[3] == 1.0 and np.linalg.norm(eye[:3]) < 2.0:
        places += list(eye[:3] + RESOLUTION * np.concatenate([np.eye(3), -np.eye(3)]))
    turn = np.subtract(camera.target, camera.eye)
    cameras = [camera.model_copy(update={"eye": list(place), "target": list(place + turn)}) for place in places]
    views = [resolve_camera(one, UNIT, SIDE, SIDE, asset.radius) for one in cameras]
    return np.array([covered(view, asset.positions, asset.faces, SAMPLES) for view in views])


def picture_fault(alpha, truths, antialias):
    """How an alpha differs from every truth of a pixel by more than its antialiasing does."""
    error = np.abs(alpha - truths).min(axis=0)
    if antialias == "coverage" and error.max() > 2.0 / SAMPLES:
        return f"coverage is off by {error.max():.3f}"
    if antialias == "none" and not np.isin(alpha, (0.0, 1.0)).all():
        return "neither covered nor not"
    for value in (0.0, 1.0):
        certain = np.all([binary_erosion(truth == value, np.ones((3, 3), bool), border_value=1) for truth in truths], axis=0)
        # samples miss slivers, which an area does not
        off = int((np.abs(alpha[certain] - value) > (1.0 / SAMPLES**2 if antialias == "coverage" else 0.0)).sum())
        if antialias == "line" and value == 1.0 and off <= FOLDED and alpha[certain].min(initial=1.0) >= 0.5:
            continue
        if off:
            return f"{off} of {int(certain.sum())} pixels that are certainly {value:.0f} are not"
    return None


@pytest.mark.parametrize(("source", "distance"), [("original", 2e-7), ("clipped", 2e-6)])
@pytest.mark.parametrize("side", [(2.0, -0.3, -0.4), (-0.5, 2.0, -0.2), (-0.2, -0.6, 2.0)])
def test_outline_of_a_corner_hardly_before_the_eye_is_where_it_is(gpu, source, distance, side):
    asset, _ = stood("cube")
    corner = np.asarray(asset.positions[np.argmax(asset.positions.sum(axis=1))], np.float64)
    eye = corner + distance * np.array(side)
    camera = Camera(eye=eye.tolist(), target=(eye - np.array(side)).tolist(), up=[0.2, 0.9, 0.5], fov_y_deg=80.0)
    view = resolve_camera(camera, UNIT, 256, 256, asset.radius)
    truth = covered(view, asset.positions, asset.faces, 2)
    assert 0.05 < truth.mean() < 0.95
    accuracy = Accuracy(source=source, antialias="none")
    alpha = render_frame(gpu, asset, RenderRequest(camera=camera, width=256, height=256, accuracy=accuracy)).pixels[:, :, 3] / 255.0
    assert picture_fault(alpha, truth[None], "none") is None


@pytest.mark.parametrize("name", SHAPES)
def test_drawing_from_on_the_surface_is_refused_and_from_beside_it_is_right(name):
    asset, eyes = stood(name)
    on_it = []
    for label, eye in eyes.items():
        camera = Camera(**framed(asset, eye, SIDE, SIDE))
        request = SilhouetteRequest(camera=camera, project=ProjectTo(width=SIDE, height=SIDE))
        try:
            outline = describe_silhouette(asset, request).outline
        except InvalidRequestError as error:
            assert error.where["field"] == "camera"
            on_it.append(label)
            continue
        view = resolve_camera(camera, UNIT, SIDE, SIDE)
        segments = np.concatenate([np.empty((0, 4)), *(np.column_stack([p, np.roll(p, -1, axis=0)]) for p in outline.polygons())])
        front, _ = layers(view, asset.positions, asset.faces, SAMPLES)
        truth = (front > 0).reshape(SIDE, SAMPLES, SIDE, SAMPLES).mean(axis=(1, 3))
        assert np.abs(coverage_mask(segments, SIDE, SIDE).mask / 255.0 - truth).max() <= 2.0 / SAMPLES, label
    assert {"in a face", "on an edge", "at a vertex"} <= set(on_it)
    assert len(on_it) <= 7
