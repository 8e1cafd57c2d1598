"""Pictures over real HTTP: what they show, what they say of themselves, and how wrong requests are refused."""

import io
import re

import httpx
import numpy as np
import pytest
from PIL import Image

from client.shapes import write_ply
from tests import meshes, plain_http

ORBIT = {"orbit": {"azimuth_deg": 30.0, "elevation_deg": 20.0}}


@pytest.fixture(scope="module")
def http(service):
    with plain_http.Client(base_url=service.url, timeout=120.0) as connection:
        yield connection


def pixels(answer: httpx.Response) -> np.ndarray:
    """(h, w, 4) u1 of an image answer."""
    assert answer.status_code == 200, answer.text
    return np.asarray(Image.open(io.BytesIO(answer.content)).convert("RGBA"))


def picture(http, knot, **fields) -> np.ndarray:
    return pixels(http.post(f"/v1/meshes/{knot.id}/render", json={"camera": ORBIT, "width": 192, "height": 160, "format": "png", **fields}))


def test_clipped_hull_has_the_outline_of_the_original(http, knot):
    clipped = picture(http, knot, accuracy={"source": "clipped", "antialias": "coverage"})[..., 3]
    original = picture(http, knot, accuracy={"source": "original", "antialias": "ssaa"})[..., 3]
    assert clipped.shape == (160, 192)
    assert 0.1 < (clipped > 0).mean() < 0.6
    assert (clipped[0] == 0).all() and (clipped[-1] == 0).all() and (clipped[:, 0] == 0).all() and (clipped[:, -1] == 0).all()
    inner, outer = (clipped == 255) & (original == 255), (clipped == 0) & (original == 0)
    rim = ~inner & ~outer
    assert rim.mean() < 0.1
    assert np.abs(clipped[rim].astype(float) - original[rim]).mean() / 255.0 < 0.06  # the reference has 16 samples a pixel
    assert (np.abs(clipped.astype(float) - original) > 128).mean() < 1e-4


def test_clipped_hull_is_shaded_like_the_original(http, knot):
    clipped = picture(http, knot, accuracy={"source": "clipped"}).astype(float)
    original = picture(http, knot, accuracy={"source": "original", "antialias": "ssaa"}).astype(float)
    inside = (clipped[..., 3] == 255) & (original[..., 3] == 255)
    difference = np.abs(clipped[inside, :3] - original[inside, :3]).mean(axis=1)
    assert np.median(difference) < 12.0
    assert original[inside, :3].std() > 10.0, "the reference is shaded"


def test_background_lies_behind_the_mesh_and_colour_is_the_surface(http, knot):
    image = picture(http, knot, background="#2040ff", shading={"mode": "mask", "color": "#ff8000"})
    assert (image[..., 3] == 255).all()
    assert tuple(image[0, 0]) == (0x20, 0x40, 0xFF, 255)
    assert tuple(image[80, 40]) in {(0x20, 0x40, 0xFF, 255), (0xFF, 0x80, 0x00, 255)}
    assert (image == (0xFF, 0x80, 0x00, 255)).all(axis=-1).mean() > 0.05


@pytest.mark.parametrize(
    ("accept", "media", "kind"), [("image/webp", "image/webp", "WEBP"), ("image/jpeg", "image/jpeg", "JPEG"), ("*/*", "image/png", "PNG")]
)
def test_accept_header_decides_the_encoding(http, knot, accept, media, kind):
    answer = http.post(f"/v1/meshes/{knot.id}/render", json={"width": 64, "height": 48}, headers={"Accept": accept})
    assert (answer.status_code, answer.headers["content-type"]) == (200, media)
    image = Image.open(io.BytesIO(answer.content))
    assert (image.format, image.size) == (kind, (64, 48))


def test_format_field_overrides_the_accept_header(http, knot):
    answer = http.post(f"/v1/meshes/{knot.id}/render", json={"width": 8, "height": 4, "format": "raw"}, headers={"Accept": "image/webp"})
    assert answer.headers["content-type"] == "application/octet-stream"
    assert len(answer.content) == 8 * 4 * 4
    assert answer.headers["x-image-size"] == "8x4"


def test_nothing_acceptable_is_406(http, knot):
    answer = http.post(f"/v1/meshes/{knot.id}/render", json={}, headers={"Accept": "text/html"})
    assert (answer.status_code, answer.headers["content-type"]) == (406, "application/problem+json")


def test_query_and_body_give_the_same_picture(http, knot):
    body = picture(http, knot)
    query = http.get(f"/v1/meshes/{knot.id}/render.png", params={"azimuth": 30, "elevation": 20, "width": 192, "height": 160})
    assert np.array_equal(pixels(query), body)


def test_smooth_by_query_and_by_body_gives_the_same_picture(http, knot):
    query = http.get(f"/v1/meshes/{knot.id}/render.png", params={"width": 96, "height": 96, "smooth": True})
    body = http.post(f"/v1/meshes/{knot.id}/render", json={"width": 96, "height": 96, "accuracy": {"smooth": True}})
    assert np.array_equal(pixels(query), pixels(body))
    assert query.headers["X-Accuracy"] == "rung=clipped/coverage/smooth"
    assert "smooth" in query.headers["X-Plan"].split(", ")


def test_orbit_and_the_same_place_give_the_same_outline(http, knot):
    sphere = knot.sphere
    eye = ",".join(str(c) for c in np.add(sphere.centre, [0, 0, 4.0 * sphere.radius]))
    target = ",".join(str(c) for c in sphere.centre)
    shared = {"width": 96, "height": 96, "shading": "mask"}
    orbit = pixels(
        http.get(f"/v1/meshes/{knot.id}/render.png", params={"azimuth": 0, "elevation": 0, "distance": 4.0 * sphere.radius, **shared})
    )
    place = pixels(http.get(f"/v1/meshes/{knot.id}/render.png", params={"eye": eye, "target": target, **shared}))
    assert np.abs(orbit[..., 3].astype(int) - place[..., 3]).max() <= 1


def test_orthographic_camera_by_query(http, knot):
    params = {"eye": "0,0,20", "projection": "orthographic", "height_units": 8, "width": 64, "height": 64}
    alpha = pixels(http.get(f"/v1/meshes/{knot.id}/render.png", params=params))[..., 3]
    assert 0.05 < (alpha > 0).mean() < 0.9


@pytest.mark.parametrize(
    "path",
    [
        "render.png?width=64&height=64",
        "thumbnail.png?size=64",
        "silhouette.svg?width=64",
        "silhouette.json",
        "artifacts/hull.glb",
        "artifacts/normal.png",
    ],
)
def test_known_answer_is_304(http, knot, path):
    url = f"/v1/meshes/{knot.id}/{path}"
    first = http.get(url)
    assert first.status_code == 200
    tag = first.headers["etag"]
    for known in (tag, f'"other", {tag}', "*", tag.removeprefix("W/")):
        again = http.get(url, headers={"If-None-Match": known})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert http.get(url, headers={"If-None-Match": '"other"'}).status_code == 200


def test_picture_that_was_drawn_before_is_given_again_without_drawing(http, knot):
    path = f"/v1/meshes/{knot.id}/render.png?azimuth=123.25&width=96&height=80"
    first, again, other = http.get(path), http.get(path), http.get(path.replace("123.25", "123.5"))
    assert "coverage;dur=" in first.headers["server-timing"]
    assert again.headers["server-timing"] == "cache;desc=hit"
    assert again.content == first.content
    told = ("etag", "x-plan", "x-accuracy", "x-image-size", "cache-control", "content-type")
    assert [again.headers[name] for name in told] == [first.headers[name] for name in told]
    assert "coverage;dur=" in other.headers["server-timing"]
    assert other.content != first.content


def test_different_requests_have_different_tags(http, knot):
    base = f"/v1/meshes/{knot.id}/render"
    urls = [
        f"{base}.png?width=32",
        f"{base}.png?width=33",
        f"{base}.webp?width=32",
        f"{base}.png?width=32&azimuth=31",
        f"{base}.png?width=32&source=original",
    ]
    assert len({http.get(url).headers["etag"] for url in urls}) == len(urls)


def test_picture_says_where_its_time_went_and_how_exact_it_is(http, knot):
    answer = http.get(f"/v1/meshes/{knot.id}/render.png?width=64&height=64&source=clipped")
    timing = dict(re.findall(r"(\w+);dur=([\d.]+)", answer.headers["server-timing"]))
    plan = answer.headers["x-plan"].split(", ")
    assert [*plan, "encode"] == list(timing)
    assert {"edges", "coverage", "surface"} <= set(plan)
    assert all(float(ms) >= 0.0 for ms in timing.values())
    assert "clipped/coverage" in answer.headers["x-accuracy"]
    original = http.get(f"/v1/meshes/{knot.id}/render.png?width=64&height=64&source=original&antialias=none")
    assert "edges" not in original.headers["x-plan"]
    assert "original/none" in original.headers["x-accuracy"]


@pytest.mark.parametrize("suffix", ["png", "webp", "jpg"])
def test_thumbnail_is_square_and_kept_for_ever(http, knot, suffix):
    answer = http.get(f"/v1/meshes/{knot.id}/thumbnail.{suffix}", params={"size": 96})
    assert pixels(answer).shape == (96, 96, 4)
    assert "immutable" in answer.headers["cache-control"]


def test_thumbnail_is_fitted_on_a_transparent_ground(http, knot):
    alpha = pixels(http.get(f"/v1/meshes/{knot.id}/thumbnail.png"))[..., 3]
    assert alpha.shape == (256, 256)
    rows, columns = np.nonzero(alpha)
    assert min(rows.min(), columns.min()) > 0
    assert max(rows.max(), columns.max()) < 255
    assert max(np.ptp(rows), np.ptp(columns)) > 128


BAD_CAMERAS = [
    ({"camera": {"eye": [1, 2, 3], "target": [1, 2, 3]}}, "camera.eye"),
    ({"camera": {"eye": [0, 0, 3], "up": [0, 0, 0]}}, "camera.up"),
    ({"camera": {"eye": [0, 0, 3], "up": [0, 0, 2]}}, "camera.up"),
    ({"camera": {"eye": [0, 0, 3], "fov_y_deg": 0}}, "camera.fov_y_deg"),
    ({"camera": {"eye": [0, 0, 3], "fov_y_deg": 180}}, "camera.fov_y_deg"),
    ({"camera": {"orbit": {"fov_y_deg": 0}}}, "camera.orbit.fov_y_deg"),
    ({"camera": {"orbit": {"fov_y_deg": 180}}}, "camera.orbit.fov_y_deg"),
    ({"camera": {"orbit": {"distance": 0}}}, "camera.orbit.distance"),
    ({"camera": {"orbit": {"distance": 1e-40}}}, "camera.orbit.distance"),
    ({"camera": {"eye": [0, 0, 3], "projection": "orthographic"}}, "camera.height"),
    ({"camera": {"eye": [0, 0]}}, "camera.eye"),
    ({"camera": {"eye": "here"}}, "camera.eye"),
    ({"camera": 3}, "camera"),
    ({"width": 0}, "width"),
    ({"width": 100_000}, "width"),
    ({"height": 0}, "height"),
    ({"height": 100_000}, "height"),
    ({"widht": 100}, "widht"),
    ({"background": "red"}, "background"),
    ({"accuracy": {"antialias": "msaa", "source": "clipped"}}, "accuracy.antialias"),
]


@pytest.mark.parametrize(("body", "field"), BAD_CAMERAS)
def test_wrong_request_is_422_and_names_the_field(http, knot, body, field):
    answer = http.post(f"/v1/meshes/{knot.id}/render", json=body)
    assert (answer.status_code, answer.headers["content-type"]) == (422, "application/problem+json")
    problem = answer.json()
    assert [item["field"] for item in problem["errors"]] == [field]
    assert problem["detail"]


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"{", 422),
        (b"", 422),
        (b"[]", 422),
        (b'{"width": NaN}', 422),
        (b'{"width": 1e999}', 422),
        (b"\xff\xfe", 422),
        (bytes(2 << 20), 413),
    ],
)
def test_body_that_is_no_request_is_a_problem(http, knot, body, status):
    answer = http.post(f"/v1/meshes/{knot.id}/render", content=body, headers={"Content-Type": "application/json"})
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ("fov=0", "fov"),
        ("fov=180", "fov"),
        ("width=0", "width"),
        ("height=100000", "height"),
        ("eye=0,0,0", "eye"),
        ("width=x", "width"),
        ("wdith=3", "wdith"),
        ("source=mine", "source"),
        ("distance=1e-40", "distance"),
        ("source=clipped&antialias=msaa", "antialias"),
        ("smooth=1&antialias=line", "smooth"),
    ],
)
def test_wrong_query_is_422_and_names_the_parameter(http, knot, query, field):
    answer = http.get(f"/v1/meshes/{knot.id}/render.png?{query}")
    assert answer.status_code == 422
    assert [item["field"] for item in answer.json()["errors"]] == [field]


@pytest.mark.parametrize(
    "path",
    [
        "render.gif",
        "thumbnail.exe",
        "silhouette.pdf",
        "artifacts/mesh.safetensors",
        "artifacts/..%2f..%2fmanifest.json",
        "artifacts/color.png",
    ],
)
def test_what_there_is_not_is_404(http, knot, path):
    answer = http.get(f"/v1/meshes/{knot.id}/{path}")
    assert (answer.status_code, answer.headers["content-type"]) == (404, "application/problem+json")


@pytest.mark.parametrize("path", ["", "/render.png?width=32&height=32", "/thumbnail.webp", "/silhouette.json", "/artifacts/hull.glb"])
def test_head_is_get_without_the_body(http, knot, path):
    url = f"/v1/meshes/{knot.id}{path}"
    asked, got = http.head(url), http.get(url)
    assert (asked.status_code, asked.content) == (200, b"")
    assert set(asked.headers) == set(got.headers)
    assert asked.headers["content-type"] == got.headers["content-type"]


def test_head_of_what_there_is_not_is_404(http):
    assert http.head(f"/v1/meshes/{'0' * 32}/render.png").status_code == 404


@pytest.mark.parametrize(("wanted", "status", "code"), [("bytes=999999999-", 416, "range-not-satisfiable"), ("soon", 400, "bad-request")])
def test_a_range_that_cannot_be_had_is_a_problem(http, knot, wanted, status, code):
    answer = http.get(knot.links["hull.glb"], headers={"Range": wanted})
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    assert answer.json()["code"] == code
    assert http.get(knot.links["hull.glb"], headers={"Range": "bytes=0-3"}).content == b"glTF"


def test_a_body_that_is_not_said_to_be_json_is_told_how_to_be(http, knot):
    answer = http.post(f"/v1/meshes/{knot.id}/render", content=b"{}")
    assert answer.status_code == 422
    assert "application/json" in answer.json()["detail"]


@pytest.mark.parametrize("size", [0, 15, 1025, "big"])
def test_thumbnail_size_is_bounded(http, knot, size):
    answer = http.get(f"/v1/meshes/{knot.id}/thumbnail.png", params={"size": size})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "size"


def test_open_mesh_is_drawn_from_the_original_and_says_why(http, client, tmp_path):
    vertices, faces = meshes.sphere(2)
    path = tmp_path / "bowl.ply"
    write_ply(str(path), vertices, faces[: len(faces) // 2])
    mesh = client.wait(client.upload(path, repair="never").id, timeout_s=120.0)
    assert not mesh.capabilities["clip"].available
    assert mesh.capabilities["clip"].reason
    answer = http.get(mesh.links["render"], params={"width": 64, "height": 64})
    assert (pixels(answer)[..., 3] > 0).mean() > 0.05
    assert "original" in answer.headers["x-accuracy"]
    refused = http.get(mesh.links["render"], params={"source": "clipped"})
    assert refused.status_code == 422
    assert refused.json()["code"] == "capability-unavailable"
    assert "silhouette" not in mesh.links
    silhouette = http.get(f"{mesh.links['self']}/silhouette.svg")
    assert (silhouette.status_code, silhouette.json()["code"]) == (422, "capability-unavailable")
    client.delete(mesh.id)


def test_hull_opens_as_gltf(http, knot):
    answer = http.get(knot.links["hull.glb"])
    assert answer.headers["content-type"] == "model/gltf-binary"
    assert answer.content[:4] == b"glTF"
    assert int.from_bytes(answer.content[8:12], "little") == len(answer.content)


def test_a_picture_within_an_error_says_which_surface_its_outline_is_of(http, knot):
    exact = http.get(f"/v1/meshes/{knot.id}/render.png?width=128&height=128")
    body = {"width": 128, "height": 128, "accuracy": {"level": 0}}
    coarse = http.post(f"/v1/meshes/{knot.id}/render", json=body)
    assert "level" not in exact.headers["x-accuracy"]
    told = dict(item.split("=") for item in coarse.headers["x-accuracy"].split("; "))
    assert told["rung"] == "clipped/coverage"
    assert int(told["level_faces"]) in {level.faces for level in knot.hull.levels if level.side == "outer"}
    assert 0.0 < float(told["level_error_px"]) < float(told["error_px"])
    assert told["bound"] == "certified"
    assert exact.headers["etag"] != coarse.headers["etag"]
    assert (pixels(coarse)[..., 3].astype(int) >= pixels(exact)[..., 3].astype(int) - 1).all()


def test_a_plan_can_be_had_instead_of_the_picture(http, knot):
    address = f"/v1/meshes/{knot.id}/render"
    asked = http.post(address, params={"explain": "true"}, json={"accuracy": {"max_error_px": 1.0}})
    by_accept = http.post(address, headers={"accept": "application/json"}, json={"accuracy": {"max_error_px": 1.0}})
    for answer in (asked, by_accept):
        assert answer.headers["content-type"] == "application/json"
        assert answer.headers["cache-control"] == "no-store"
        report = answer.json()
        assert report["passes"][0]["name"] == "background"
        assert all(one["why"] and one["predicted_ms"] > 0.0 for one in report["passes"])
        assert report["error_px"] <= 1.0 and report["device"]
    picture = http.post(address, headers={"accept": "application/json, */*"}, json={})
    assert picture.headers["content-type"] == "image/png"
    encoded = http.post(address, headers={"accept": "application/json"}, json={"format": "webp"})
    assert encoded.headers["content-type"] == "image/webp"


def test_a_plan_of_a_request_that_cannot_be_kept_is_refused_as_the_picture_is(http, knot):
    for params in ({}, {"explain": "true"}):
        refused = http.post(f"/v1/meshes/{knot.id}/render", params=params, json={"accuracy": {"level": 99}})
        assert refused.status_code == 422
        assert "levels" in refused.json()["detail"]


def test_a_budget_is_met_or_said_to_be_missed(http, knot):
    address = f"/v1/meshes/{knot.id}/render"
    roomy = http.post(address, json={"width": 128, "height": 128, "accuracy": {"budget_ms": 10_000}})
    assert "missed" not in roomy.headers["x-accuracy"]
    tight = http.post(address, json={"width": 128, "height": 128, "accuracy": {"budget_ms": 0.001, "max_error_px": 0.1}})
    told = dict(item.split("=") for item in tight.headers["x-accuracy"].split("; "))
    assert told["missed"] == "budget_ms" and float(told["error_px"]) <= 0.1


def test_strokes_come_by_address_and_by_body_and_say_their_passes(http, knot):
    query = {"width": 120, "height": 90, "azimuth": 30, "elevation": 20, "lines": "strokes", "line_width": 4, "fill": "white"}
    query |= {"stroke_width_by": "angle", "stroke_dash": "14,6", "stroke_wobble_px": 2.0, "stroke_seed": 3}
    by_address = http.get(f"/v1/meshes/{knot.id}/render.png", params=query)
    style = {"width": 4.0}
    lines = {"method": "strokes", "silhouette": style, "boundary": style}
    lines["stroke"] = {"width_by": "angle", "dash": [14.0, 6.0], "wobble_px": 2.0, "seed": 3}
    by_body = picture(http, knot, width=120, height=90, lines=lines, shading={"fill": "white"})
    assert np.array_equal(pixels(by_address), by_body)
    for name in ("vector_lines", "line_strokes", "strokes"):
        assert name in by_address.headers["x-plan"] and f"{name};dur=" in by_address.headers["server-timing"]
    other = http.get(f"/v1/meshes/{knot.id}/render.png", params=query | {"stroke_seed": 4})
    assert not np.array_equal(pixels(other), by_body)
    told = http.post(f"/v1/meshes/{knot.id}/render", params={"explain": True}, json={"lines": lines}).json()
    assert {"vector_lines", "line_strokes", "strokes"} <= {one["name"] for one in told["passes"]}


def test_a_stroke_of_another_method_is_refused_by_its_field(http, knot):
    refused = http.post(f"/v1/meshes/{knot.id}/render", json={"lines": {"method": "fattened", "stroke": {"wobble_px": 1.0}}})
    assert (refused.status_code, refused.json()["errors"][0]["field"]) == (422, "lines.stroke")
    refused = http.get(f"/v1/meshes/{knot.id}/render.png", params={"lines": "edge_mesh", "stroke_wobble_px": 1.0})
    assert (refused.status_code, refused.json()["errors"][0]["field"]) == (422, "lines")
