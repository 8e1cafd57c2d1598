"""Silhouettes over real HTTP, against brute force on the mesh that was uploaded."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from client.shapes import write_ply
from geometry.silhouettes import silhouette_scalar
from geometry.topology import build_edges
from schemas.conventions import Frame
from tests import meshes, plain_http
from tests.service.test_lines import grid

EYE = {"eye": [1.0, 2.0, 14.0], "target": [0.0, 0.0, 0.0]}


@pytest.fixture(scope="module")
def http(service):
    with plain_http.Client(base_url=service.url, timeout=120.0) as connection:
        yield connection


@pytest.fixture(scope="module")
def answer(http, knot):
    return http.post(f"/v1/meshes/{knot.id}/silhouette", json={"camera": EYE, "project": {"width": 200, "height": 100}})


def test_edges_are_those_of_brute_force(answer, knot):
    vertices, faces = meshes.knot()
    vertices = vertices.astype(np.float32)
    frame = Frame.around(vertices)
    positions, edges = frame.to_normalised(vertices).astype(np.float32), build_edges(faces)
    eye = np.append(frame.to_normalised(EYE["eye"]), 1.0)
    expected = positions[silhouette_scalar(positions, faces, edges.vertices, edges.faces, eye)]
    found = answer.json()
    index = {vertex: row for row, vertex in enumerate(found["vertices"]["index"])}
    used = frame.to_normalised(found["vertices"]["position"])
    segments = np.array([[used[index[a]], used[index[b]]] for a, b in found["edges"]])
    assert found["edge_count"] == len(found["edges"]) == len(expected)
    order = lambda lines: np.array(sorted(np.round(lines.reshape(len(lines), 6), 4).tolist()))  # noqa: E731
    assert np.allclose(order(segments), order(expected.astype(float)), atol=2e-4)


def test_contours_are_closed_and_use_every_edge_once(answer):
    found = answer.json()
    around = [(a, b) for loop in found["contours"] for a, b in zip(loop, [*loop[1:], loop[0]], strict=True)]
    assert sorted(around) == sorted(tuple(edge) for edge in found["edges"])


def test_pixels_lie_where_the_picture_shows_the_outline(answer):
    pixel = np.array(answer.json()["vertices"]["pixel"])
    assert pixel.min(axis=0)[0] > 20 and pixel.max(axis=0)[0] < 180
    assert pixel.min(axis=0)[1] > 0 and pixel.max(axis=0)[1] < 100


def test_answer_says_how_long_it_took(answer):
    assert "extract;dur=" in answer.headers["server-timing"]


def test_drawing_is_svg_of_the_size_asked_for(http, knot):
    drawing = http.get(f"/v1/meshes/{knot.id}/silhouette.svg", params={"width": 300, "height": 200})
    assert drawing.headers["content-type"] == "image/svg+xml"
    root = ElementTree.fromstring(drawing.content)
    assert root.tag.endswith("svg")
    assert root.attrib["viewBox"].split() == ["0", "0", "300", "200"]
    assert len(drawing.content) > 1000


def test_smooth_contours_come_by_query_and_by_body(http, knot):
    query = http.get(f"/v1/meshes/{knot.id}/silhouette.json", params={"width": 300, "height": 200, "smooth": True}).json()
    body = {"project": {"width": 300, "height": 200}, "smooth": True}
    assert http.post(f"/v1/meshes/{knot.id}/silhouette", json=body).json()["curves"] == query["curves"]
    assert all(len(curve) % 3 == 0 for curve in query["curves"])
    drawing = http.get(f"/v1/meshes/{knot.id}/silhouette.svg", params={"smooth": True}).text
    assert "C" in drawing.split(' d="')[1].split('"')[0]


def test_accept_header_decides_the_document(http, knot):
    path = f"/v1/meshes/{knot.id}/silhouette"
    kinds = ("application/json", "image/svg+xml", "application/octet-stream")
    answers = {kind: http.post(path, json={"camera": EYE}, headers={"Accept": kind}) for kind in kinds}
    assert [a.headers["content-type"] for a in answers.values()] == list(kinds)
    assert len({a.headers["etag"] for a in answers.values()}) == 3
    assert http.post(path, json={}, headers={"Accept": "image/png"}).status_code == 406


def test_lines_come_by_query_and_by_body_with_the_time_of_their_passes(http, knot):
    body = {"project": {"width": 300, "height": 200}, "kinds": ["silhouette", "ridge"], "ridge_deg": 20.0, "simplify_px": 0.5}
    posted = http.post(f"/v1/meshes/{knot.id}/silhouette", json=body)
    query = {"width": 300, "height": 200, "kinds": "silhouette,ridge", "ridge_deg": 20.0, "simplify_px": 0.5}
    assert http.get(f"/v1/meshes/{knot.id}/silhouette.json", params=query).json()["lines"] == posted.json()["lines"]
    assert {line["visible"] for line in posted.json()["lines"]} == {True, False}
    for name in ("crossings", "kinds", "cuts", "sight", "chains"):
        assert f"{name};dur=" in posted.headers["server-timing"]
    assert accuracy(posted)["line_error_px"] == "0.5"


def test_a_dxf_drawing_comes_by_accept_and_by_address(http, knot):
    by_address = http.get(f"/v1/meshes/{knot.id}/silhouette.dxf", params={"visible_only": True})
    body = {"project": {"width": 512, "height": 512}, "visible_only": True}
    by_accept = http.post(f"/v1/meshes/{knot.id}/silhouette", json=body, headers={"Accept": "image/vnd.dxf"})
    assert by_address.headers["content-type"] == by_accept.headers["content-type"] == "image/vnd.dxf"
    assert by_address.content == by_accept.content and by_address.content.endswith(b"EOF\n")
    assert b"SILHOUETTE_HIDDEN" in http.get(f"/v1/meshes/{knot.id}/silhouette.dxf").content


def test_a_drawing_of_lines_is_grouped_by_kind(http, knot):
    drawing = http.get(f"/v1/meshes/{knot.id}/silhouette.svg", params={"kinds": "silhouette", "line_width": 2.5})
    groups = [g for g in ElementTree.fromstring(drawing.content).iter() if g.attrib.get("class") == "silhouette"]
    assert [g.attrib["stroke-width"] for g in groups] == ["2.5"]


def test_strokes_come_by_query_and_by_body_in_every_document(http, knot):
    stroke = {"width_by": "depth", "opacity_by": "curvature", "wobble_px": 2.0, "seed": 4}
    body = {"project": {"width": 300, "height": 200}, "visible_only": True, "stroke": stroke}
    posted = http.post(f"/v1/meshes/{knot.id}/silhouette", json=body)
    query = {"width": 300, "height": 200, "visible_only": True} | {f"stroke_{name}": value for name, value in stroke.items()}
    by_query = {suffix: http.get(f"/v1/meshes/{knot.id}/silhouette.{suffix}", params=query) for suffix in ("json", "svg", "dxf", "bin")}
    assert by_query["json"].json()["lines"] == posted.json()["lines"]
    assert all(answer.status_code == 200 for answer in by_query.values())
    line = posted.json()["lines"][0]
    assert len(line["widths"]) == len(line["opacities"]) == len(line["points"]) and "vertices" not in line
    assert "stroke;dur=" in posted.headers["server-timing"] and accuracy(posted)["line_error_px"] == "2.1"
    other = http.get(f"/v1/meshes/{knot.id}/silhouette.json", params=query | {"stroke_seed": 5})
    assert other.headers["etag"] != by_query["json"].headers["etag"] and other.content != by_query["json"].content
    assert http.get(f"/v1/meshes/{knot.id}/silhouette.json", params=query).content == by_query["json"].content


def test_a_stroke_without_lines_is_refused(http, knot):
    refused = http.post(f"/v1/meshes/{knot.id}/silhouette", json={"stroke": {"wobble_px": 1.0}})
    assert (refused.status_code, refused.json()["errors"][0]["field"]) == (422, "stroke")
    refused = http.get(f"/v1/meshes/{knot.id}/silhouette.svg", params={"stroke_wobble_px": 1.0})
    assert (refused.status_code, refused.json()["errors"][0]["field"]) == (422, "kinds")


def test_an_open_mesh_has_lines_but_no_silhouette(http, client, tmp_path):
    write_ply(str(tmp_path / "sheet.ply"), *grid())
    sheet = client.wait(client.upload(tmp_path / "sheet.ply", repair="never").id, timeout_s=280.0)
    lines = http.get(f"/v1/meshes/{sheet.id}/silhouette.json", params={"kinds": "boundary", "visible_only": True}).json()["lines"]
    assert [(line["kind"], line["closed"], len(line["points"])) for line in lines] == [("boundary", True, 24)]
    refused = http.get(f"/v1/meshes/{sheet.id}/silhouette.json")
    assert (refused.status_code, refused.json()["code"]) == (422, "capability-unavailable")


def test_what_is_not_asked_for_is_left_out(http, knot):
    bare = http.post(f"/v1/meshes/{knot.id}/silhouette", json={"camera": EYE, "contours": False, "positions": False}).json()
    assert bare.get("contours") is None
    assert "position" not in bare["vertices"]
    assert "pixel" not in bare["vertices"]
    assert bare["edge_count"] > 10


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"camera": {"eye": [0, 0, 0]}}, "camera.eye"),
        ({"project": {"width": 0}}, "project.width"),
        ({"contour": True}, "contour"),
        ({"smooth": True}, "smooth"),
        ({"kinds": ["ridges"], "project": {}}, "kinds[0]"),
        ({"kinds": [], "project": {}}, "kinds"),
        ({"visible_only": True}, "visible_only"),
        ({"kinds": ["ridge"], "ridge_deg": 181, "project": {}}, "ridge_deg"),
        ({"kinds": ["ridge"], "stroke": {"dash": [3, 2, 1]}, "project": {}}, "stroke.dash"),
        ({"kinds": ["ridge"], "stroke": {"width_by": "age"}, "project": {}}, "stroke.width_by"),
        ({"kinds": ["ridge"], "line_width": {"ridge": 0}, "project": {}}, "line_width.ridge"),
    ],
)
def test_wrong_request_is_422_and_names_the_field(http, knot, body, field):
    answer = http.post(f"/v1/meshes/{knot.id}/silhouette", json=body)
    assert answer.status_code == 422
    assert [item["field"] for item in answer.json()["errors"]] == [field]


def accuracy(answer):
    return dict(item.split("=") for item in answer.headers["x-accuracy"].split("; "))


def test_an_error_in_pixels_lets_a_coarser_surface_stand_for_the_mesh(http, knot):
    path = f"/v1/meshes/{knot.id}/silhouette"
    body = {"camera": EYE, "project": {"width": 200, "height": 100}}
    exact = http.post(path, json=body)
    coarse = http.post(path, json={**body, "max_error_px": 20.0})
    assert exact.json()["surface"] == {"level": False, "faces": 5120, "error_px": 0.0}
    surface = coarse.json()["surface"]
    assert surface["level"] and 0.0 < surface["error_px"] <= 20.0
    assert surface["faces"] in {level.faces for level in knot.hull.levels if level.side == "outer"}
    assert coarse.json()["edge_count"] < exact.json()["edge_count"]
    assert accuracy(exact) == {"surface_faces": "5120", "error_px": "0"}
    assert int(accuracy(coarse)["surface_faces"]) == surface["faces"]
    assert surface["error_px"] <= float(accuracy(coarse)["error_px"]) <= surface["error_px"] * 1.0001
    assert exact.headers["etag"] != coarse.headers["etag"]


def test_an_error_by_query_and_by_body_are_the_same(http, knot):
    query = http.get(f"/v1/meshes/{knot.id}/silhouette.json?width=200&height=100&max_error=20")
    body = http.post(f"/v1/meshes/{knot.id}/silhouette", json={"project": {"width": 200, "height": 100}, "max_error_px": 20.0})
    assert query.content == body.content
    assert query.json()["surface"]["level"]


@pytest.mark.parametrize("wrong", ["0", "-1", "nan", "inf", "much"])
def test_an_error_that_is_none_is_named(http, knot, wrong):
    for path in ("silhouette.json", "render.png"):
        answer = http.get(f"/v1/meshes/{knot.id}/{path}?max_error={wrong}")
        assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, "max_error")


def test_an_error_without_an_image_is_named(http, knot):
    answer = http.post(f"/v1/meshes/{knot.id}/silhouette", json={"max_error_px": 1.0})
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, "max_error_px")
