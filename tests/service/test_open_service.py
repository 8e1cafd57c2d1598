"""A service of this machine without keys: open as it always was, but not to other sites' pages."""

import httpx
import pytest


@pytest.fixture(scope="module")
def http(service):
    with httpx.Client(base_url=service.url, timeout=60.0) as connection:
        yield connection


def test_an_open_service_has_nothing_to_sign(http):
    answer = http.post("/v1/sign", json={"url": f"/v1/meshes/{'0' * 32}/render.png"})
    assert answer.status_code == 422 and "works as it is" in answer.json()["detail"]


def test_an_open_service_lends_pictures_to_every_page_and_nothing_else(http, knot):
    picture, described = http.get(f"/v1/meshes/{knot.id}/thumbnail.png?size=32"), http.get(f"/v1/meshes/{knot.id}")
    assert picture.headers["cross-origin-resource-policy"] == "cross-origin"
    assert described.headers["cross-origin-resource-policy"] == "same-origin"
    assert "strict-transport-security" not in picture.headers, "nobody said that there is TLS"
    assert "public" in picture.headers["cache-control"]


def test_a_key_that_nobody_asked_for_does_no_harm(http):
    assert http.get("/v1/meshes", headers={"Authorization": "Bearer of some other service"}).status_code == 200


def test_another_sites_page_cannot_make_a_browser_upload_or_delete(http, knot):
    foreign = {"Origin": "https://evil.example", "Sec-Fetch-Site": "cross-site"}
    assert http.post("/v1/meshes?name=a.ply", content=b"ply", headers=foreign).status_code == 403
    assert http.delete(f"/v1/meshes/{knot.id}", headers=foreign).status_code == 403
    assert http.get(f"/v1/meshes/{knot.id}", headers=foreign).status_code == 200
    own = {"Origin": str(http.base_url).rstrip("/")}
    assert http.post("/v1/meshes?name=a.blend", content=b"x", headers=own).status_code == 415
    behind_a_proxy = {"Origin": "https://shop.example", "Sec-Fetch-Site": "same-origin"}
    assert http.post("/v1/meshes?name=a.blend", content=b"x", headers=behind_a_proxy).status_code == 415


def test_a_signature_that_does_not_fit_is_refused_here_too(http, knot):
    answer = http.get(f"/v1/meshes/{knot.id}/thumbnail.png?size=32&exp=99999999999&kid={'0' * 16}&sig=x")
    assert answer.status_code == 403
