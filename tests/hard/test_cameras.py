"""Cameras at the ends of what numbers can be: the right picture and finite documents, or a refusal that names the field."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache

import httpx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from schemas.conventions import Frame
from schemas.errors import InvalidRequestError
from schemas.render import RenderRequest, SilhouetteRequest
from service.camera import resolve_camera
from service.errors import invalid_fields
from service.render.frame import render_frame
from service.silhouette.coverage import coverage_mask
from service.silhouette.describe import describe_silhouette
from service.silhouette.document import silhouette_binary, silhouette_json, silhouette_svg
from service.silhouette.project import TOUCHING, project_edges
from tests.hard.examples import examples
from tests.hard.standing import unframed
from tests.hard.test_eyes import picture_fault
from tests.oracles_hull import distance
from tests.rays import covered
from tests.service.render.made import clippable

SAMPLES = 6
FINEST = 1e8
"""Pixels a normalised unit: float32 positions are six pixels apart, and of what the GL draws no more is asked than that it is finite."""
SIDE = 20
AXIS = {"eye": [0.2, 0.1, 3.0]}
EDGE = {"eye": [0.2, 0.1, 3.0], "target": [0.9, 0.0, 0.2]}
HIGH = {"eye": [0.2, 0.1, 3.0], "projection": "orthographic"}

GOOD = {
    "needle": (EDGE | {"fov_y_deg": 0.001}, (SIDE, SIDE)),
    "needle, fitted": ({"orbit": {"azimuth_deg": 20, "fov_y_deg": 0.001}}, (SIDE, SIDE)),
    "half space": (AXIS | {"fov_y_deg": 179.9}, (SIDE, SIDE)),
    "half space, near": ({"eye": [0.2, 0.1, 1.02], "fov_y_deg": 179.9}, (SIDE, SIDE)),
    "half space, fitted": ({"orbit": {"azimuth_deg": 20, "fov_y_deg": 179.9}}, (SIDE, SIDE)),
    "eye plane through the mesh": ({"eye": [1.2, 0.0, 0.1], "target": [1.2, 1.0, 0.0], "fov_y_deg": 100}, (SIDE, SIDE)),
    "near plane through the mesh": ({"eye": [0.0, 0.0, 0.4], "target": [0.0, 0.1, -1.0], "fov_y_deg": 90}, (SIDE, SIDE)),
    "all behind": ({"eye": [0.0, 0.0, 3.0], "target": [0.0, 0.0, 9.0]}, (SIDE, SIDE)),
    "all far behind": ({"eye": [0.0, 0.0, 1e18], "target": [0.0, 0.0, 1e25]}, (SIDE, SIDE)),
    "vertices at the eye plane": ({"eye": [0.0, -2.9, 0.0], "target": [0.0, 0.0, 1e300]}, (SIDE, SIDE)),
    "beside": ({"eye": [0.0, 0.0, 3.0], "target": [30.0, 0.0, 3.1]}, (SIDE, SIDE)),
    "one pixel": (AXIS, (1, 1)),
    "one row": (AXIS, (300, 1)),
    "one column": (AXIS, (1, 300)),
    "widest": (AXIS | {"fov_y_deg": 20}, (8192, 2)),
    "highest": (AXIS, (2, 8192)),
    "a hair's breadth from parallel": (AXIS | {"up": [0.2, 0.1, 3.0000001]}, (SIDE, SIDE)),
    "up of any length": (AXIS | {"up": [0.0, 1e-300, 0.0]}, (SIDE, SIDE)),
    "up as long as numbers are": (AXIS | {"up": [1e308, 1e308, 0.0]}, (SIDE, SIDE)),
    "target next to the eye": ({"eye": [0.0, 0.0, 3.0], "target": [0.0, 0.0, float(np.nextafter(3.0, 0.0))]}, (SIDE, SIDE)),
    "target beyond everything": ({"eye": [0.0, 0.0, 3.0], "target": [0.0, 0.0, -1e300]}, (SIDE, SIDE)),
    "a trillion radii away": ({"orbit": {"distance": 1e12, "fov_y_deg": 1.2e-10}}, (SIDE, SIDE)),
    "a trillion radii away, a point": ({"orbit": {"distance": 1e12}}, (SIDE, SIDE)),
    "inside, from an orbit": ({"orbit": {"distance": 1e-6, "fov_y_deg": 90}}, (SIDE, SIDE)),
    "orthographic, a point": (HIGH | {"height": 1e29}, (SIDE, SIDE)),
    "orthographic, from afar": ({"eye": [1e300, 0.0, 0.0], "projection": "orthographic", "height": 2.5}, (SIDE, SIDE)),
    "orthographic, from inside": ({"eye": [1e-300, 0.0, 0.0], "projection": "orthographic", "height": 2.5}, (SIDE, SIDE)),
    "orthographic, small": (HIGH | {"target": [0.9, 0.0, 0.2], "height": 1e-3}, (SIDE, SIDE)),
}
BAD = {
    "eye is target": ({"eye": [1.0, 2.0, 3.0], "target": [1.0, 2.0, 3.0]}, "camera.eye"),
    "up is nothing": (AXIS | {"up": [0.0, 0.0, 0.0]}, "camera.up"),
    "up is along the view": (AXIS | {"up": [0.4, 0.2, 6.0]}, "camera.up"),
    "up is against the view": (AXIS | {"up": [-0.2, -0.1, -3.0]}, "camera.up"),
    "not a number": ({"eye": [0.0, 0.0, float("nan")]}, "camera.eye[2]"),
    "infinite": ({"eye": [0.0, 0.0, 3.0], "target": [float("inf"), 0.0, 0.0]}, "camera.target[0]"),
    "infinite up": (AXIS | {"up": [0.0, float("-inf"), 0.0]}, "camera.up[1]"),
    "too far apart": ({"eye": [-1e308, 0.0, 0.0], "target": [1e308, 1.0, 0.0]}, "camera.eye"),
    "farther than numbers go": ({"eye": [1e300, 0.0, 0.0]}, "camera.eye"),
    "no field of view": (AXIS | {"fov_y_deg": 0.0}, "camera.fov_y_deg"),
    "a whole half space": (AXIS | {"fov_y_deg": 180.0}, "camera.fov_y_deg"),
    "hardly any field of view": (AXIS | {"fov_y_deg": 1e-300}, "camera.fov_y_deg"),
    "all but a half space": (AXIS | {"fov_y_deg": float(np.nextafter(180.0, 0.0))}, "camera.fov_y_deg"),
    "no number of degrees": (AXIS | {"fov_y_deg": float("nan")}, "camera.fov_y_deg"),
    "no height": (HIGH | {"height": 0.0}, "camera.height"),
    "height below nothing": (HIGH | {"height": -1.0}, "camera.height"),
    "hardly any height": (HIGH | {"height": 1e-300}, "camera.height"),
    "a height without end": (HIGH | {"height": 1e300}, "camera.height"),
    "nowhere on the axis": (
        {"eye": [1e300, 0.0, 0.0], "target": [1e299, 0.0, 0.0]} | {"projection": "orthographic", "height": 1},
        "camera.eye",
    ),
    "orbit without radius": ({"orbit": {"distance": 0.0}}, "camera.orbit.distance"),
    "orbit with hardly any radius": ({"orbit": {"distance": 1e-300}}, "camera.orbit.distance"),
    "orbit farther than numbers go": ({"orbit": {"distance": 1e300}}, "camera.orbit.distance"),
    "orbit of no number": ({"orbit": {"distance": float("nan")}}, "camera.orbit.distance"),
    "orbit over the pole": ({"orbit": {"elevation_deg": 90.5}}, "camera.orbit.elevation_deg"),
    "orbit turned without end": ({"orbit": {"azimuth_deg": float("inf")}}, "camera.orbit.azimuth_deg"),
    "orbit fitted by a needle": ({"orbit": {"fov_y_deg": 1e-300}}, "camera.orbit.fov_y_deg"),
}


@cache
def shape(name="torus"):
    return unframed(clippable(name))


def refused(camera, size=(8, 8)):
    """(the field that a refusal names, None where the camera is good): of a picture; of a silhouette."""
    return tuple(_refused(make, camera, *size) for make in (_picture, describe))


def _picture(camera, width, height):
    request = RenderRequest.model_validate({"camera": camera, "width": width, "height": height})
    return resolve_camera(request.camera, shape().frame, width, height, shape().radius)


def _refused(make, camera, width, height):
    try:
        make(camera, width, height)
    except ValidationError as error:
        (fault,) = invalid_fields(error.errors())
        return fault["field"]
    except InvalidRequestError as error:
        return error.where["field"]
    return None


@pytest.mark.parametrize("label", BAD)
def test_camera_that_cannot_be_used_is_refused_by_its_field(label):
    camera, field = BAD[label]
    assert refused(camera) == (field, field)


def view_of(camera, size):
    return resolve_camera(RenderRequest.model_validate({"camera": camera}).camera, shape().frame, *size, shape().radius)


def truths_of(view):
    """(1, h, w) f8: part of each pixel that is covered."""
    samples = 30 if view.width * view.height < 100 else 12 if view.width * view.height < 1000 else 8
    return covered(view, shape().positions, shape().faces, samples)[None]


@pytest.mark.parametrize("label", GOOD)
def test_camera_at_the_end_of_what_can_be_has_the_right_picture(gpu, label):
    camera, (width, height) = GOOD[label]
    assert refused(camera) == (None, None)
    truths = truths_of(view_of(camera, (width, height)))
    for source, antialias in (("auto", "coverage"), ("auto", "none"), ("auto", "line"), ("original", "none"), ("original", "ssaa")):
        fields = {"camera": camera, "width": width, "height": height, "accuracy": {"source": source, "antialias": antialias}}
        image = render_frame(gpu, shape(), RenderRequest.model_validate(fields))
        assert image.pixels.shape == (height, width, 4)
        assert picture_fault(image.pixels[:, :, 3] / 255.0, truths, image.rung.split("/")[1]) is None, (source, antialias)


@pytest.mark.parametrize("label", GOOD)
def test_camera_at_the_end_of_what_can_be_has_finite_documents(label):
    camera, (width, height) = GOOD[label]
    described, truth = describe(camera, width, height), truths_of(view_of(camera, (width, height)))[0]
    answer = json.loads(silhouette_json(described))
    assert np.isfinite(answer["eye"]).all()
    assert np.isfinite(np.array(answer["vertices"].get("position", [0.0]), float)).all()
    assert silhouette_binary(described)
    mask = drawn(silhouette_svg(described).decode(), width, height)
    # coordinates are written with two digits
    inside = np.abs(mask - truth) <= 2.0 / SAMPLES + 0.02
    assert inside.all() or camera_is_inside(camera)


def describe(camera, width, height):
    return describe_silhouette(shape(), SilhouetteRequest.model_validate({"camera": camera, "project": {"width": width, "height": height}}))


def camera_is_inside(camera):
    """Whether backs of faces are in view, which no silhouette tells of."""
    view = view_of(camera, (4, 4))
    return bool(view.eye[3] == 1.0 and np.linalg.norm(view.eye[:3]) < 1.0)


def drawn(svg, width, height):
    """Covered part of each pixel of a drawing; fails on a number that is not finite."""
    (path,) = re.findall(r'id="silhouette" d="([^"]*)"', svg)
    segments = [np.empty((0, 4))]
    for loop in re.findall(r"M([^MZ]*)Z", path):
        points = np.array([point.split(",") for point in loop.split(" ")], float)
        assert np.isfinite(points).all()
        segments.append(np.column_stack([points, np.roll(points, -1, axis=0)]))
    return coverage_mask(np.concatenate(segments), width, height).mask / 255.0


LENGTHS = [0.0, 5e-324, 1e-300, 1e-30, 1e-9, 0.3, 1.0, 2.9, 1e9, 1e18, 1e29, 1e300, 1.7e308]
_number = st.sampled_from(LENGTHS + [-x for x in LENGTHS])
_vector = st.lists(_number, min_size=3, max_size=3)
_positive = st.sampled_from(LENGTHS[1:])
_degrees = st.sampled_from([5e-324, 1e-30, 1e-9, 1e-3, 1.0, 45.0, 179.0, 179.99999, float(np.nextafter(180.0, 0.0))])
_places = st.fixed_dictionaries({"eye": _vector, "target": _vector, "up": _vector, "fov_y_deg": _degrees})
_flat = st.fixed_dictionaries(
    {"eye": _vector, "target": _vector, "up": _vector, "projection": st.just("orthographic"), "height": _positive}
)
_orbits = st.fixed_dictionaries({"azimuth_deg": _number, "elevation_deg": st.sampled_from([-90.0, -1e-300, 0.0, 89.9, 90.0])})
_orbits = st.tuples(_orbits, st.one_of(st.just("fit"), _positive), _degrees).map(
    lambda o: {"orbit": o[0] | {"distance": o[1], "fov_y_deg": o[2]}}
)


@examples(150)
@given(st.one_of(_places, _flat, _orbits), st.sampled_from([(1, 1), (8, 8), (40, 1), (3, 30)]))
def test_any_camera_is_refused_by_a_field_or_has_a_finite_picture_and_documents(gpu, camera, size):
    picture, silhouette = refused(camera, size)
    if silhouette is not None:
        assert silhouette == "camera" or silhouette.startswith("camera.")
        assert picture == silhouette or is_on_the_surface(view_of(camera, size).eye)
        return
    assert picture is None
    view = view_of(camera, size)
    assert np.isfinite(view.matrix).all() and np.isfinite(view.view).all() and 0.0 < view.near <= view.far
    segments = project_edges(view, shape().positions, shape().tree.extract(view.eye).edges)
    assert np.isfinite(segments).all()
    described = describe(camera, *size)
    assert np.isfinite(json.loads(silhouette_json(described))["eye"]).all()
    drawn(silhouette_svg(described).decode(), *size)
    image = render_frame(gpu, shape(), RenderRequest.model_validate({"camera": camera, "width": size[0], "height": size[1]}))
    fault = picture_fault(image.pixels[:, :, 3] / 255.0, truths_of(view), image.rung.split("/")[1])
    assert fault is None or (view.pixel_scale > FINEST and not image.rung.endswith("coverage"))


def is_on_the_surface(eye):
    return eye[3] == 1.0 and distance(shape().positions.astype(np.float64), shape().faces, *eye[:3]) <= TOUCHING


@pytest.mark.parametrize("fov", [1.0, 1e-3, 1e-4])
def test_needle_on_the_outline_has_the_right_picture(gpu, fov):
    asset, eye = shape(), np.array([0.3, 0.5, 2.6])
    edges = asset.tree.extract(np.append(eye, 1.0)).edges
    ends = asset.positions[edges].astype(np.float64)
    target = ends[np.argmax(ends[:, 0, 0])].mean(axis=0)
    camera = {"eye": eye.tolist(), "target": target.tolist(), "fov_y_deg": fov}
    truths = truths_of(view_of(camera, (SIDE, SIDE)))
    assert 0.1 < truths.mean() < 0.9
    for source, antialias in (
        ("clipped", "coverage"),
        ("clipped", "none"),
        ("clipped", "line"),
        ("original", "none"),
        ("original", "ssaa"),
    ):
        fields = {"camera": camera, "width": SIDE, "height": SIDE, "accuracy": {"source": source, "antialias": antialias}}
        image = render_frame(gpu, asset, RenderRequest.model_validate(fields))
        assert picture_fault(image.pixels[:, :, 3] / 255.0, truths, antialias) is None, (source, antialias)


@pytest.mark.parametrize("scale", [1e-300, 1e-12, 1e12, 1e300])
@pytest.mark.parametrize(
    "orbit", [{}, {"azimuth_deg": 1e300}, {"fov_y_deg": 1e-12}, {"fov_y_deg": 1e-27}, {"distance": 1e-290}, {"distance": 3e300}]
)
def test_meshes_of_any_size_have_finite_eyes_or_a_refusal(scale, orbit):
    asset = replace(shape(), frame=Frame((0.1 * scale, -0.2 * scale, 0.3 * scale), scale))
    request = SilhouetteRequest.model_validate({"camera": {"orbit": orbit}, "project": {"width": 8, "height": 8}})
    try:
        described = describe_silhouette(asset, request)
    except InvalidRequestError as error:
        assert error.where["field"].startswith("camera")
        return
    answer = json.loads(silhouette_json(described))
    assert None not in answer["eye"]
    assert np.isfinite(np.array(answer["vertices"]["position"], float)).all()


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (16, 16), (16, 1), (17, 5)])
def test_small_picture_of_many_samples_is_their_mean(gpu, size):
    """So small that the samples and their means would fit into a target of the same size."""
    camera = {"orbit": {"azimuth_deg": 30, "elevation_deg": 20}}
    fields = {"camera": camera, "width": size[0], "height": size[1], "accuracy": {"source": "original", "antialias": "ssaa"}}
    image = render_frame(gpu, shape(), RenderRequest.model_validate(fields))
    assert np.abs(image.pixels[:, :, 3] / 255.0 - covered(view_of(camera, size), shape().positions, shape().faces, 4)).max() <= 1.01 / 16


@pytest.fixture(scope="module")
def http(service):
    with httpx.Client(base_url=service.url, timeout=120.0) as connection:
        yield connection


@pytest.mark.parametrize(
    "label", ["eye is target", "up is along the view", "farther than numbers go", "hardly any height", "orbit fitted by a needle"]
)
def test_over_http_a_camera_that_cannot_be_used_is_422_and_names_its_field(http, knot, label):
    camera, field = BAD[label]
    for call in ("render", "silhouette"):
        answer = http.post(f"/v1/meshes/{knot.id}/{call}", json={"camera": camera})
        assert (answer.status_code, answer.headers["content-type"]) == (422, "application/problem+json"), call
        assert [fault["field"] for fault in answer.json()["errors"]] == [field], call


@pytest.mark.parametrize("label", ["half space", "needle, fitted", "a trillion radii away", "all behind", "one row", "widest"])
def test_over_http_a_camera_at_the_end_of_what_can_be_has_a_picture_and_finite_numbers(http, knot, label):
    camera, (width, height) = GOOD[label]
    picture = http.post(f"/v1/meshes/{knot.id}/render", json={"camera": camera, "width": width, "height": height, "format": "raw"})
    assert (picture.status_code, len(picture.content)) == (200, 4 * width * height)
    body = {"camera": camera, "project": {"width": width, "height": height}}
    answer = http.post(f"/v1/meshes/{knot.id}/silhouette", json=body).json()
    assert np.isfinite(np.array(answer["vertices"]["position"], float)).all() and np.isfinite(answer["eye"]).all()
    drawing = http.post(f"/v1/meshes/{knot.id}/silhouette", json=body, headers={"Accept": "image/svg+xml"})
    assert 0.0 <= drawn(drawing.text, width, height).mean() <= 1.0
