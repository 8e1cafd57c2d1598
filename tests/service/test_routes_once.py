"""Pictures and silhouettes of meshes that come with the request and are not kept."""

import io
import json

import numpy as np
import pytest
from PIL import Image

from backend import once
from backend.local_store import LocalStore
from client.shapes import write_ply
from tests import meshes, oracles, plain_http
from tests.conftest import MAX_UPLOAD_MIB


@pytest.fixture(scope="module")
def http(service):
    with plain_http.Client(base_url=service.url, timeout=120.0) as connection:
        yield connection


@pytest.fixture(scope="module")
def knot_bytes(knot_file):
    return knot_file.read_bytes()


@pytest.fixture
def left(service):
    """How many files of meshes that are not kept there are."""
    store = once.store_of(LocalStore(service.data_dir / "store"))
    return lambda: len(list(store.list()))


def image_of(answer):
    assert answer.status_code == 200, answer.text
    return np.asarray(Image.open(io.BytesIO(answer.content)))


def test_a_picture_is_that_of_the_kept_mesh_drawn_from_the_original(http, knot, knot_bytes, left):
    view = {"azimuth": 40, "width": 200, "height": 160, "source": "original", "antialias": "msaa"}
    kept = image_of(http.get(f"/v1/meshes/{knot.id}/render.png", params=view))
    answer = http.post("/v1/render", params=view | {"name": "knot.ply"}, content=knot_bytes)
    drawn = image_of(answer)
    assert np.array_equal(drawn, kept)
    assert "load;dur=" in answer.headers["Server-Timing"] and answer.headers["Cache-Control"] == "no-store"
    assert left() == 0


def test_a_form_carries_the_request_as_json(http, knot_bytes, left):
    wanted = {"width": 64, "height": 48, "background": "#102030", "format": "webp"}
    form = {"file": ("knot.ply", knot_bytes), "request": (None, json.dumps(wanted))}
    answer = http.post("/v1/render", files=form)
    assert answer.headers["content-type"] == "image/webp"
    assert image_of(answer).shape == (48, 64, 3)
    assert left() == 0


def test_a_silhouette_is_the_kept_meshs_by_brute_force(http, knot, knot_bytes, left):
    wanted = {"camera": {"orbit": {"azimuth_deg": 70.0, "elevation_deg": -10.0}}, "project": {"width": 300, "height": 300}}
    kept = http.post(f"/v1/meshes/{knot.id}/silhouette", json=wanted).json()
    form = {"file": ("knot.ply", knot_bytes), "request": (None, json.dumps(wanted))}
    found = http.post("/v1/silhouette", files=form).json()
    assert found["edge_count"] == kept["edge_count"] > 0
    assert oracles.edge_set(found["edges"]) == oracles.edge_set(kept["edges"])
    drawing = http.post("/v1/silhouette?name=knot.ply", content=knot_bytes, headers={"Accept": "image/svg+xml"})
    assert drawing.text.startswith("<svg") and "<path" in drawing.text
    assert left() == 0


def test_an_open_mesh_is_drawn_and_has_no_silhouette(http, tmp_path, left):
    vertices, faces = meshes.cube(2)
    write_ply(str(tmp_path / "open.ply"), vertices, faces[:-6])
    data = (tmp_path / "open.ply").read_bytes()
    params = {"name": "open.ply", "repair": "never"}
    assert image_of(http.post("/v1/render", params=params, content=data))[:, :, 3].max() == 255
    refused = http.post("/v1/silhouette", params=params, content=data)
    assert refused.status_code == 422 and refused.json()["detail"]
    assert left() == 0


@pytest.mark.parametrize(
    ("params", "content", "status", "says"),
    [
        ({"name": "a.ply"}, b"ply\nnonsense", 422, ""),
        ({"name": "a.xyz"}, b"1 2 3", 415, "xyz"),
        ({}, b"1 2 3", 415, "name"),
        ({"name": "a.ply"}, b"", 422, "empty"),
        ({"name": "a.ply", "azimuth": "north"}, b"ply", 422, "azimuth"),
        ({"name": "a.ply", "elevation": 91}, b"ply", 422, "elevation"),
        ({"name": "a.ply", "colour": "red"}, b"ply", 422, "colour"),
        ({"name": "a.ply", "repair": "maybe"}, b"ply", 422, "repair"),
        ({"name": "a.ply"}, bytes((MAX_UPLOAD_MIB << 20) + 8192), 413, ""),
    ],
)
def test_what_cannot_be_drawn_is_refused_and_says_why(http, left, params, content, status, says):
    answer = http.post("/v1/render", params=params, content=content)
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert says in answer.text
    assert left() == 0


@pytest.mark.parametrize(
    ("form", "params", "field"),
    [
        ({"request": '{"width": 0}'}, {}, "width"),
        ({"request": '{"size": 10}'}, {}, "size"),
        ({"request": "no json"}, {}, ""),
        ({"request": "{}"}, {"azimuth": 3}, "request"),
        ({"azimuth": "3"}, {}, "azimuth"),
        ({"request": '{"accuracy": {"source": "clipped"}}'}, {}, "not kept"),
    ],
)
def test_a_request_that_is_wrong_names_its_field(http, knot_bytes, left, form, params, field):
    files = {"file": ("knot.ply", knot_bytes), **{name: (None, text) for name, text in form.items()}}
    answer = http.post("/v1/render", params=params, files=files)
    assert answer.status_code == 422, answer.text
    assert field in answer.text
    assert left() == 0


def test_no_mesh_is_kept_or_listed(http, knot_bytes):
    before = http.get("/v1/meshes").json()
    assert image_of(http.post("/v1/render?name=knot.ply&width=32&height=32", content=knot_bytes)).shape == (32, 32, 4)
    assert http.get("/v1/meshes").json() == before


def test_what_a_service_that_died_left_is_swept_by_its_age(tmp_path):
    store = once.store_of(LocalStore(tmp_path))
    (tmp_path / "upload").write_bytes(b"mesh")
    token = once.put(store, tmp_path / "upload")
    once.sweep(store, 3600.0)
    assert once.is_wanted(store, token)
    once.sweep(store, -1.0)
    assert not once.is_wanted(store, token) and not list(store.list())
