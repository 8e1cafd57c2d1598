"""A service of this machine without keys: open as it always was, but not to other sites' pages."""

import time

import pytest

from client.local import LocalService
from tests import plain_http


@pytest.fixture(scope="module")
def http(service):
    with plain_http.Client(base_url=service.url, timeout=60.0) as connection:
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


A_MINUTE = 20


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    """A service without keys that limits addresses, and believes the proxy on this machine."""
    environment = {"SILHOUETTE_ADDRESS_REQUESTS_PER_MINUTE": str(A_MINUTE), "SILHOUETTE_ADDRESS_CONCURRENT_RENDERS": "1"}
    with LocalService(tmp_path_factory.mktemp("limited"), environment, ("--workers", "0")) as running:
        with plain_http.Client(base_url=running.url, timeout=60.0) as connection:
            yield connection
        assert running.stop() == 0, running.last_words()


def of(address):
    return {"X-Forwarded-For": address}


@pytest.mark.xdist_group("limited")
def test_an_address_has_its_requests_a_minute_and_takes_none_from_others(limited):
    answers = [limited.get("/v1/meshes", headers=of("192.0.2.1")) for _ in range(A_MINUTE + 1)]
    assert [answer.status_code for answer in answers] == [200] * A_MINUTE + [429]
    assert [int(answer.headers["ratelimit-remaining"]) for answer in answers] == [*range(A_MINUTE - 1, -1, -1), 0]
    assert int(answers[-1].headers["retry-after"]) >= 1
    assert {name: answers[-1].json()[name] for name in ("quota", "limit")} == {"quota": "requests_per_minute", "limit": A_MINUTE}
    assert limited.get("/v1/meshes", headers=of("192.0.2.2")).status_code == 200
    assert limited.get("/healthz", headers=of("192.0.2.1")).status_code == 200, "who watches the process is not counted"


@pytest.mark.xdist_group("limited")
def test_addresses_of_one_ipv6_network_are_one(limited):
    answers = [limited.get("/v1/meshes", headers=of(f"2001:db8::{number}")).status_code for number in range(A_MINUTE + 1)]
    assert answers == [200] * A_MINUTE + [429]
    assert limited.get("/v1/meshes", headers=of("2001:db8:0:1::1")).status_code == 200


class LeavingError(Exception):
    """The client's own."""


@pytest.mark.xdist_group("limited")
def test_an_address_has_its_pictures_in_work_at_once(limited):
    """The first picture is one of a mesh whose bytes are still on their way."""

    def slowly():
        yield b"ply"
        own = 1
        while left("192.0.2.3") >= A_MINUTE - own and own < A_MINUTE // 2:  # the service may not have seen it yet: a picture might be first
            own += 1
            time.sleep(1.0)
        assert asked("192.0.2.3").json()["quota"] == "concurrent_renders"
        assert asked("192.0.2.4").status_code == 415
        raise LeavingError

    def asked(address):
        return limited.post("/v1/render?name=a.blend", content=b"no mesh", headers=of(address))

    def left(address):
        """Requests that the address has left after this one."""
        return int(limited.get("/v1/meshes", headers=of(address)).headers["ratelimit-remaining"])

    # a connection of its own: one that has been idle for long may be closed by the service just when it is used again
    with pytest.raises(LeavingError), plain_http.Client(base_url=limited.base_url) as other:
        other.post("/v1/render?name=a.ply", content=slowly(), headers=of("192.0.2.3"))
