"""Scenes over real HTTP."""

from __future__ import annotations

import io
import json
import re

import numpy as np
import pytest
from PIL import Image

from client.errors import NotFoundError, RequestError
from client.shapes import write_ply
from schemas.scene import SceneRequest
from tests import meshes, plain_http

URL = "/v1/scenes/render"


@pytest.fixture(scope="module")
def http(service):
    with plain_http.Client(base_url=service.url, timeout=120.0) as connection:
        yield connection


@pytest.fixture
def two(knot):
    """Two knots, one behind the other, the nearer one red and mirrored."""
    near = {"mesh": knot.id, "transform": {"translate": [1, 0, 5], "scale": [-1, 1, 1]}, "shading": {"color": "#ff0000"}}
    return {"width": 96, "height": 80, "camera": {"eye": [2, 3, 18]}, "objects": [{"mesh": knot.id}, near]}


def pixels(answer):
    assert answer.status_code == 200, answer.text
    return np.asarray(Image.open(io.BytesIO(answer.content)).convert("RGBA"))


def test_a_scene_is_a_picture_that_says_what_it_is_made_of(http, two):
    answer = http.post(URL, json=two)
    image = pixels(answer)
    assert image.shape == (80, 96, 4)
    red = (image[..., 0].astype(int) > 2 * image[..., 2].astype(int) + 20) & (image[..., 3] > 0)
    assert 0.02 < red.mean() < (image[..., 3] > 0).mean()
    timing = re.findall(r"(\w+);dur=[\d.]+", answer.headers["server-timing"])
    assert (timing[0], timing[-1]) == ("plan", "encode")
    assert {"edges", "surface", "coverage", "over", "settle"} <= set(timing)
    layers = answer.headers["x-plan"].split(", ")
    assert [re.match(r"layer\[\d\]: object \d clipped/coverage", layer) is not None for layer in layers] == [True, True]
    assert "object 0" in layers[0]
    assert answer.headers["x-accuracy"].startswith("rung=clipped/coverage; error_px=")
    assert answer.headers["x-image-size"] == "96x80"


def test_one_object_is_the_picture_of_its_mesh(http, knot):
    fields = {"camera": {"eye": [3, 4, 12]}, "width": 96, "height": 80, "background": "#ffffff"}
    alone = http.post(f"/v1/meshes/{knot.id}/render", json=fields)
    assert np.array_equal(pixels(http.post(URL, json={**fields, "objects": [{"mesh": knot.id}]})), pixels(alone))


def test_known_scene_is_304_and_others_have_other_tags(http, two):
    first = http.post(URL, json=two)
    tag = first.headers["etag"]
    again = http.post(URL, json=two, headers={"If-None-Match": tag})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert first.headers["cache-control"] == "no-cache"
    moved = json.loads(json.dumps(two))
    moved["objects"][1]["transform"]["translate"][0] = 1.001
    assert http.post(URL, json=moved, headers={"If-None-Match": tag}).status_code == 200
    assert http.post(URL, json=two, headers={"Accept": "image/webp"}).headers["etag"] != tag


@pytest.mark.parametrize(("accept", "media"), [("image/webp", "image/webp"), ("image/jpeg", "image/jpeg"), ("*/*", "image/png")])
def test_accept_header_decides_the_encoding(http, two, accept, media):
    answer = http.post(URL, json=two, headers={"Accept": accept})
    assert (answer.status_code, answer.headers["content-type"], answer.headers["vary"]) == (200, media, "Accept")


def test_nothing_acceptable_is_406_and_format_overrides(http, two):
    assert http.post(URL, json=two, headers={"Accept": "text/html"}).status_code == 406
    raw = http.post(URL, json={**two, "format": "raw"}, headers={"Accept": "text/html"})
    assert (raw.headers["content-type"], len(raw.content)) == ("application/octet-stream", 96 * 80 * 4)


def test_unknown_mesh_is_404_with_its_place(http, two):
    two["objects"].append({"mesh": "f" * 32})
    answer = http.post(URL, json=two)
    problem = answer.json()
    assert (answer.status_code, problem["code"], problem["field"]) == (404, "not-found", "objects[2].mesh")
    assert problem["detail"].startswith("objects[2].mesh: ")


@pytest.mark.parametrize("name", ["nothing like an id", "../../etc", "0"])
def test_what_is_no_mesh_id_is_404_too(http, name):
    answer = http.post(URL, json={"objects": [{"mesh": name}]})
    assert (answer.status_code, answer.json()["field"]) == (404, "objects[0].mesh")


def test_mesh_in_processing_is_409_with_its_place(http, client, two, tmp_path):
    path = tmp_path / "slow.ply"
    write_ply(str(path), *meshes.knot(700, 24))
    slow = client.upload(path)
    two["objects"].insert(1, {"mesh": slow.id})
    two["accuracy"] = {"source": "clipped"}  # its original can be drawn as soon as it is loaded
    answer = http.post(URL, json=two)
    client.delete(slow.id)
    assert (answer.status_code, answer.json()["code"], answer.json()["field"]) == (409, "not-ready", "objects[1].mesh")
    assert int(answer.headers["retry-after"]) >= 1


def test_failed_mesh_is_422_with_its_place(http, client, two, tmp_path):
    path = tmp_path / "broken.ply"
    path.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n")
    broken = client.upload(path)
    with pytest.raises(RequestError):
        client.wait(broken.id, timeout_s=120.0)
    two["objects"].insert(0, {"mesh": broken.id})
    problem = http.post(URL, json=two).json()
    assert (problem["status"], problem["field"]) == (422, "objects[0].mesh")
    client.delete(broken.id)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"objects": []}, "objects"),
        ({"objects": None}, "objects"),
        ({"width": 0}, "width"),
        ({"camera": {"orbit": {"distance": 1e-40}}}, "camera.orbit.distance"),
        ({"accuracy": {"antialias": "msaa", "source": "clipped"}}, "accuracy.antialias"),
    ],
)
def test_wrong_scene_is_422_and_names_the_field(http, two, change, field):
    answer = http.post(URL, json={**two, **change})
    assert (answer.status_code, answer.headers["content-type"]) == (422, "application/problem+json")
    assert [item["field"] for item in answer.json()["errors"]] == [field]


@pytest.mark.parametrize(
    ("transform", "field"),
    [
        ({"scale": [1, 0, 1]}, "objects[1].transform"),
        ({"scale": 1e-320}, "objects[1].transform"),
        ({"rotate": {"axis": [0, 0, 0], "angle_deg": 3}}, "objects[1].transform.rotate.axis"),
        ([[1, 0, 0, 0]] * 4, "objects[1].transform"),
    ],
)
def test_wrong_transform_is_422_and_names_the_object(http, two, transform, field):
    two["objects"][1]["transform"] = transform
    answer = http.post(URL, json=two)
    assert answer.status_code == 422
    assert [item["field"] for item in answer.json()["errors"]] == [field]


def test_interlocked_meshes_that_insist_on_clipping_are_refused(http, knot):
    body = {"objects": [{"mesh": knot.id}, {"mesh": knot.id}], "accuracy": {"source": "clipped"}}
    problem = http.post(URL, json=body).json()
    assert (problem["code"], problem["errors"][0]["field"]) == ("capability-unavailable", "accuracy.source")
    assert "objects 0, 1" in problem["detail"]


def test_lines_are_drawn_of_all_objects_against_a_common_depth(http, two):
    plain = pixels(http.post(URL, json={**two, "accuracy": {"source": "original", "antialias": "msaa"}}))
    two["objects"][1]["lines"] = {"silhouette": {"color": "#0000ff"}}
    answer = http.post(URL, json={**two, "lines": {"method": "fattened", "silhouette": {"width": 3}}})
    lined = pixels(answer)
    blue = (lined[..., 2] > 200) & (lined[..., 0] < 60) & (lined[..., 3] > 0)
    black = (lined[..., :3].max(axis=2) < 40) & (lined[..., 3] > 0)
    assert 0.01 < blue.mean() < 0.5
    assert 0.004 < black.mean() < 0.5
    assert (lined[..., 3] > 0).sum() > (plain[..., 3] > 0).sum()
    timing = re.findall(r"(\w+);dur=[\d.]+", answer.headers["server-timing"])
    assert {"line_faces", "line_strokes", "surface", "lines_back"} <= set(timing)
    assert answer.headers["x-plan"].startswith("layer[0]: objects 0+1 original/msaa (")
    assert answer.headers["x-plan"].endswith("together: lines need a common depth)")
    assert answer.headers["x-accuracy"] == "rung=original/msaa"


def test_an_object_without_lines_is_another_answer_than_one_that_has_the_scenes(http, two):
    two["lines"] = {"silhouette": {"width": 3}}
    first = http.post(URL, json=two)
    two["objects"][1]["lines"] = None
    second = http.post(URL, json=two, headers={"If-None-Match": first.headers["etag"]})
    assert second.status_code == 200
    assert second.content != first.content


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"lines": {}, "accuracy": {"source": "clipped"}}, "accuracy.source"),
        ({"lines": {"charcoal": True}}, "lines.charcoal"),
        ({"lines": {"silhouette": {"width": 0}}}, "lines.silhouette.width"),
        ({"shading": {"fill": "white"}}, "shading.fill"),
    ],
)
def test_wrong_lines_are_422_and_name_the_field(http, two, change, field):
    answer = http.post(URL, json={**two, **change})
    assert answer.status_code == 422
    assert [item["field"] for item in answer.json()["errors"]] == [field]


def test_wrong_lines_of_an_object_name_it(http, two):
    two["objects"][1]["lines"] = {"method": "translated", "declutter": True}
    problem = http.post(URL, json=two).json()
    assert [item["field"] for item in problem["errors"]] == ["objects[1].lines.declutter"]
    assert problem["detail"].startswith("objects[1]: ")


def test_the_reference_has_a_scene_to_try(http):
    document = http.get("/openapi.json").json()
    schema = document["components"]["schemas"]["SceneRequest"]
    SceneRequest.model_validate(schema["example"])
    assert set(document["paths"][URL]["post"]["responses"]) >= {"200", "304", "404", "406", "409", "422", "503"}


def test_the_client_draws_scenes(client, knot, two):
    objects = two.pop("objects")
    picture = client.scene_picture(objects, **two)
    assert picture.media_type == "image/png"
    assert picture.plan.startswith("layer[0]: object 0")
    assert client.render_scene(objects, **two) == picture.body
    assert "edge_mesh" in client.scene_picture(objects, lines={"ridge": {}}, **two).plan
    with pytest.raises(NotFoundError, match=r"objects\[0\]\.mesh"):
        client.render_scene([{"mesh": "f" * 32}])
