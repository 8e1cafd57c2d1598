"""A service with keys over real HTTP: who comes in, how far, and what is said to the others."""

import json
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from client.local import LocalKeys
from client.shapes import write_ply
from service.access.keys import REMEMBERED_S
from service.access.scopes import OPEN, scope_of
from service.access.tokens import parse_token
from tests import meshes
from tests.conftest import GUARDED_KEYS, ORIGIN

PAGES = ("/", "/docs", "/openapi.json", "/page/style.css", "/no/such/page")


@pytest.fixture(scope="module")
def calls(routes) -> list[tuple[str, str]]:
    """(method, address) of every route."""
    names = {"mesh_id": "0" * 32, "key_id": "0" * 16, "suffix": "png", "name": "hull.glb"}
    return [(method, path.format(**names)) for method, path in routes]


def ply_of(folder, mesh) -> bytes:
    write_ply(str(folder / "mesh.ply"), *mesh)
    return (folder / "mesh.ply").read_bytes()


@pytest.fixture(scope="module")
def knot_ply(tmp_path_factory):
    return ply_of(tmp_path_factory.mktemp("knot"), meshes.knot())


@pytest.fixture(scope="module")
def cube_ply(tmp_path_factory):
    return ply_of(tmp_path_factory.mktemp("cube"), meshes.cube(4))


@pytest.fixture
def fresh(guarded):
    """Makes a key that only one test uses; what came of it."""
    with guarded.http("admin") as http:
        yield lambda **fields: http.post("/v1/keys", json={"name": "fresh", **fields}).json()


# ---- who comes in ----


def test_without_a_key_every_address_but_health_is_401(anyone, calls):
    for method, address in [*calls, *(("GET", page) for page in PAGES)]:
        answer = anyone.request(method, address)
        assert answer.status_code == (200 if address in OPEN else 401), address
        if address not in OPEN:
            assert answer.headers["content-type"] == "application/problem+json"
            assert answer.headers["www-authenticate"].startswith("Bearer")
            assert answer.json()["code"] == "unauthorized"


@pytest.mark.parametrize("key", ["reader", "writer", "admin"])
def test_a_key_comes_as_far_as_its_scope_and_hears_which_one_is_missing(guarded, calls, key):
    with guarded.http(key) as http:
        for method, address in calls:
            if address in OPEN:
                continue
            needed = scope_of(method, address).value
            answer = http.request(method, address)
            if needed in GUARDED_KEYS[key]["scopes"]:
                assert answer.status_code not in (401, 403), address
            else:
                assert (answer.status_code, answer.json()["code"], answer.json()["scope"]) == (403, "missing-scope", needed), address
                assert needed in answer.json()["detail"]


def test_a_token_is_taken_as_bearer_as_a_header_and_as_a_password(guarded, anyone):
    token = guarded.tokens["reader"]
    for headers in ({"Authorization": f"bearer {token}"}, {"X-API-Key": token}):
        assert anyone.get("/v1/meshes", headers=headers).status_code == 200
    for name_and_password in (("anyone", token), (token, "")):
        assert anyone.get("/v1/meshes", auth=name_and_password).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Authorization": "Bearer"},
        {"Authorization": "Bearer nonsense"},
        {"Authorization": "Basic !!!"},
        {"Authorization": "Negotiate abc"},
        {"X-API-Key": ""},
        {"X-API-Key": "sil_" + "0" * 16 + "_" + "a" * 43},
    ],
)
def test_what_is_no_key_is_401(anyone, headers):
    assert anyone.get("/v1/meshes", headers=headers).status_code == 401


def test_another_keys_secret_or_a_changed_one_is_401(guarded, anyone):
    (reader, secret), (_, foreign) = (parse_token(guarded.tokens[name]) for name in ("reader", "admin"))
    for wrong in (foreign, secret[::-1], "A" * 43):
        answer = anyone.get("/v1/meshes", headers={"X-API-Key": f"sil_{reader}_{wrong}"})
        assert answer.status_code == 401
        assert wrong not in answer.text and "not known" in answer.json()["detail"]


def test_an_expired_key_is_401_and_says_so(guarded):
    with guarded.http("brief") as http:
        answer = http.get("/v1/meshes")
    assert answer.status_code == 401 and "expired" in answer.json()["detail"]


def test_a_browser_on_our_own_page_is_asked_for_a_password_and_no_other(anyone):
    own = anyone.get("/", headers={"Accept": "text/html", "Sec-Fetch-Site": "none"})
    asked = own.headers.get_list("www-authenticate")  # Chromium reads one challenge of a line, and asks for nothing when it is Bearer
    assert len(asked) == 2 and asked[1].startswith('Basic realm="silhouette"')
    foreign = anyone.get("/v1/meshes", headers={"Sec-Fetch-Site": "cross-site", "Accept": "image/*"})
    assert "Basic" not in foreign.headers["www-authenticate"]


def test_a_password_that_a_browser_keeps_is_not_used_by_another_sites_page(guarded, anyone, cube_ply):
    kept = ("", guarded.tokens["everything"])
    foreign = {"Origin": "https://evil.example", "Sec-Fetch-Site": "cross-site"}
    for headers in (foreign, {"Origin": "https://evil.example"}, {"Origin": "null"}):
        answer = anyone.post("/v1/render?name=cube.ply", content=cube_ply, auth=kept, headers=headers)
        assert answer.status_code == 403 and "Another site" in answer.json()["detail"]
    own = anyone.post("/v1/sign", json={"url": ""}, auth=kept, headers={"Origin": guarded.running.url})
    assert own.status_code == 422, "its own page may"
    allowed = anyone.post("/v1/sign", json={"url": ""}, headers=foreign | {"X-API-Key": guarded.tokens["reader"]})
    assert allowed.status_code == 422, "who sends a key itself is no browser that was talked into it"


# ---- keys ----


def test_a_new_key_works_and_a_revoked_one_stops_at_once(guarded, anyone, fresh):
    made = fresh(scopes=["read"])
    headers = {"X-API-Key": made["token"]}
    assert anyone.get("/v1/meshes", headers=headers).status_code == 200
    with guarded.http("admin") as http:
        assert http.get(f"/v1/keys/{made['id']}").json() == {name: value for name, value in made.items() if name != "token"}
        assert made["id"] in [key["id"] for key in http.get("/v1/keys").json()["keys"]]
        assert http.delete(f"/v1/keys/{made['id']}").status_code == 204
        assert http.get(f"/v1/keys/{made['id']}").status_code == 404
        assert http.delete(f"/v1/keys/{made['id']}").status_code == 404
    assert anyone.get("/v1/meshes", headers=headers).status_code == 401


def test_a_key_that_was_revoked_in_the_store_stops_within_seconds(guarded, anyone, fresh):
    made = fresh(scopes=["read"])
    headers = {"X-API-Key": made["token"]}
    assert anyone.get("/v1/meshes", headers=headers).status_code == 200
    LocalKeys(guarded.running.data_dir).revoke_key(made["id"])
    time.sleep(REMEMBERED_S + 0.2)
    assert anyone.get("/v1/meshes", headers=headers).status_code == 401


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({}, "name"),
        ({"name": "x", "scopes": []}, "scopes"),
        ({"name": "x", "scopes": ["root"]}, "scopes"),
        ({"name": "x", "limits": {"max_pixels": 0}}, "max_pixels"),
        ({"name": "x", "expires_in_days": -1}, "expires_in_days"),
        ({"name": "x", "token": "mine"}, "token"),
    ],
)
def test_a_key_that_makes_no_sense_names_the_field(guarded, body, field):
    with guarded.http("admin") as http:
        answer = http.post("/v1/keys", json=body)
    assert answer.status_code == 422 and field in answer.json()["detail"]


def test_secrets_are_in_no_file_and_no_log(guarded, anyone, fresh):
    made = fresh(scopes=["read"])
    secrets = [parse_token(token)[1].encode() for token in (*guarded.tokens.values(), made["token"])]
    anyone.get("/v1/meshes", headers={"X-API-Key": made["token"]})
    anyone.get(f"/v1/meshes?key={made['token']}")
    files = [path for path in guarded.running.data_dir.rglob("*") if path.is_file()]
    assert any(path.name == "service.log" for path in files)
    assert [path for path in files if any(secret in path.read_bytes() for secret in secrets)] == []


# ---- limits ----


def test_a_picture_over_the_keys_pixels_is_refused_wherever_it_is_asked_for(guarded, guarded_cube, cube_ply):
    base, wide = f"/v1/meshes/{guarded_cube.id}", {"width": 101, "height": 100}
    with guarded.http("small") as http:
        assert http.get(f"{base}/render.png?width=100&height=100").status_code == 200
        for answer in (
            http.get(f"{base}/render.png?width=101&height=100"),
            http.get(f"{base}/thumbnail.png?size=101"),
            http.post(f"{base}/render", json=wide),
            http.get(f"{base}/turntable.webp?frames=2&width=101&height=100"),
            http.post(f"{base}/frames", json={"turn": {"frames": 2}, **wide}),
            http.post(f"{base}/render", files={"request": (None, json.dumps(wide)), "positions": ("p.bin", b"")}),
            http.post("/v1/scenes/render", json={"objects": [{"mesh": guarded_cube.id}], **wide}),
            http.post("/v1/render?name=cube.ply&width=101&height=100", content=cube_ply),
        ):
            assert answer.status_code == 422, answer.url
            assert "10000" in answer.json()["detail"] and "max_pixels" in answer.json()["detail"]


def test_an_upload_over_the_keys_size_is_413_and_names_the_limit(guarded, guarded_cube):
    with guarded.http("small") as http:
        answer = http.post("/v1/meshes?name=big.ply", content=bytes((1 << 20) + 1))
        moved = http.post(f"/v1/meshes/{guarded_cube.id}/render", files={"positions": ("p.bin", bytes((1 << 20) + 1))})
    for refused in (answer, moved):
        assert refused.status_code == 413
        assert "1 MiB" in refused.json()["detail"] and "max_upload_mib" in refused.json()["detail"]


def test_a_mesh_of_too_many_faces_fails_for_that_key_and_not_for_another(guarded, knot_ply):
    with guarded.http("small") as small, guarded.http("everything") as other:
        one = small.post("/v1/meshes?name=knot.ply", content=knot_ply)
        two = other.post("/v1/meshes?name=knot.ply&texels=64&hull_faces=100", content=knot_ply)
        assert (one.status_code, two.status_code) == (202, 202)
        assert one.json()["id"] != two.json()["id"]
        failed = settled(small, one.json()["id"])
        assert failed["status"] == "failed"
        assert (failed["error"]["code"], failed["error"]["limit"]) == ("too-large", 1000)
        assert settled(other, two.json()["id"])["status"] != "failed"
        once = small.post("/v1/render?name=knot.ply&width=50&height=50", content=knot_ply)
        assert once.status_code == 422 and once.json()["code"] == "too-large"
        for answer in (one, two):
            other.delete(f"/v1/meshes/{answer.json()['id']}")


def settled(http, mesh_id):
    """The mesh when it is loaded or has failed."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        mesh = http.get(f"/v1/meshes/{mesh_id}").json()
        if mesh["stages"][0]["status"] == "done" or mesh["status"] == "failed":
            return mesh
        time.sleep(0.1)
    raise AssertionError("the mesh was not loaded in time")


def test_a_key_over_its_requests_a_minute_is_429_and_hears_when_to_come_again(guarded):
    with guarded.http("slow") as http:
        answers = [http.get("/v1/meshes") for _ in range(7)]
    assert [answer.status_code for answer in answers] == [200] * 5 + [429] * 2
    assert [answer.headers["ratelimit-remaining"] for answer in answers] == ["4", "3", "2", "1", "0", "0", "0"]
    refused = answers[-1]
    assert (refused.json()["code"], refused.json()["quota"], refused.json()["limit"]) == ("quota-exceeded", "requests_per_minute", 5)
    assert 1 <= int(refused.headers["retry-after"]) <= 60
    with guarded.http("reader") as http:
        assert http.get("/v1/meshes").status_code == 200, "another key has its own"


def test_a_key_over_its_pictures_at_once_is_429_and_not_for_long(guarded, guarded_cube):
    address = f"/v1/meshes/{guarded_cube.id}/render.png?width=1500&height=1500&antialias=ssaa&source=original"
    with guarded.http("single") as http, ThreadPoolExecutor(6) as threads:
        answers = list(threads.map(lambda number: http.get(f"{address}&azimuth={number}"), range(6)))
        assert {answer.status_code for answer in answers} == {200, 429}
        refused = next(answer for answer in answers if answer.status_code == 429)
        assert (refused.json()["quota"], refused.json()["limit"]) == ("concurrent_renders", 1)
        assert refused.headers["retry-after"] == "1"
        assert http.get(f"/v1/meshes/{guarded_cube.id}/thumbnail.png").status_code == 200
        busy = list(threads.map(lambda _: http.get(f"/v1/meshes/{guarded_cube.id}"), range(6)))
        assert {answer.status_code for answer in busy} == {200}, "only pictures are counted"


# ---- signed addresses ----


def signed(guarded, address, key="reader", **fields):
    with guarded.http(key) as http:
        return http.post("/v1/sign", json={"url": address, **fields}).json()["url"]


def test_a_signed_address_needs_no_key_for_exactly_that_picture(guarded, anyone, guarded_cube):
    url = signed(guarded, f"/v1/meshes/{guarded_cube.id}/render.png?azimuth=40&width=60&height=50")
    with guarded.http("reader") as http:
        drawn = http.get(f"/v1/meshes/{guarded_cube.id}/render.png?azimuth=40&width=60&height=50")
    answer = anyone.get(url)
    assert answer.status_code == 200 and answer.content == drawn.content
    assert anyone.head(url).status_code == 200
    for changed in (url.replace("width=60", "width=61"), url.replace("render.png", "render.webp"), f"{url}&height=9", url[:-2] + "xx"):
        refused = anyone.get(changed)
        assert (refused.status_code, refused.json()["code"]) == (403, "signature-wrong")
    for method in ("POST", "DELETE", "PUT"):
        assert anyone.request(method, url).status_code == 401
    kept = anyone.get(url, headers={"If-None-Match": answer.headers["etag"]})
    assert kept.status_code == 304 and kept.content == b""


@pytest.mark.parametrize("name", ["thumbnail.webp?size=32", "silhouette.svg?width=64", "artifacts/hull.glb", "artifacts/hull.glb?faces=50"])
def test_other_pictures_drawings_and_downloads_can_be_signed(guarded, anyone, guarded_cube, name):
    assert anyone.get(signed(guarded, f"/v1/meshes/{guarded_cube.id}/{name}")).status_code == 200


def test_no_cache_keeps_a_signed_picture_longer_than_its_address_lasts(guarded, anyone, guarded_cube):
    for seconds, most in ((100, 100), (86_400 * 300, 86_400 * 300)):
        answer = anyone.get(signed(guarded, f"/v1/meshes/{guarded_cube.id}/thumbnail.png?size=32", expires_in_s=seconds))
        parts = answer.headers["cache-control"].split(", ")
        age = int(next(part for part in parts if part.startswith("max-age=")).removeprefix("max-age="))
        assert most - 30 <= age <= most
        assert "must-revalidate" in parts and "immutable" not in parts and "stale" not in answer.headers["cache-control"]
    picture = anyone.get(signed(guarded, f"/v1/meshes/{guarded_cube.id}/render.png?width=32&height=32"))
    assert picture.headers["cache-control"] == "no-cache", "each use asks again, and is refused once it has expired"


def test_no_shared_cache_keeps_what_came_with_a_key(guarded, guarded_cube):
    with guarded.http("reader") as http:
        for address in (
            f"/v1/meshes/{guarded_cube.id}/thumbnail.png?size=32",
            f"/v1/meshes/{guarded_cube.id}",
            f"/v1/meshes/{guarded_cube.id}/artifacts/hull.glb",
        ):
            parts = http.get(address).headers["cache-control"].split(", ")
            assert "private" in parts and "public" not in parts


def test_a_signed_address_ends_when_it_expires_and_with_its_key(guarded, anyone, guarded_cube, fresh):
    made = fresh(scopes=["read"])
    sign = {"url": f"/v1/meshes/{guarded_cube.id}/thumbnail.png?size=32"}
    short, long = (
        anyone.post("/v1/sign", json=sign | {"expires_in_s": seconds}, headers={"X-API-Key": made["token"]}).json()["url"]
        for seconds in (1, 3600)
    )
    time.sleep(1.1)
    expired = anyone.get(short)
    assert (expired.status_code, expired.json()["code"]) == (403, "signature-expired")
    assert anyone.get(long).status_code == 200
    with guarded.http("admin") as http:
        http.delete(f"/v1/keys/{made['id']}")
    assert anyone.get(long).status_code == 403


def test_a_signed_picture_is_within_the_limits_of_its_key(guarded, anyone, guarded_cube):
    url = signed(guarded, f"/v1/meshes/{guarded_cube.id}/thumbnail.png?size=101", key="small")
    answer = anyone.get(url)
    assert answer.status_code == 422 and "max_pixels" in answer.json()["detail"]


def test_what_cannot_be_signed_names_the_field(guarded):
    with guarded.http("reader") as http:
        for body in ({"url": "/v1/meshes"}, {"url": "http://["}, {"url": f"/v1/meshes/{'0' * 32}/render.png", "expires_in_s": 0}, {}):
            answer = http.post("/v1/sign", json=body)
            assert answer.status_code == 422
            assert answer.json()["errors"][0]["field"] in ("url", "expires_in_s")


# ---- other origins, and what browsers are told ----


def test_pages_of_the_listed_origins_may_use_the_api_and_no_others(guarded, anyone):
    asked = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization,content-type"}
    allowed = anyone.options("/v1/meshes", headers={"Origin": ORIGIN, **asked})
    assert allowed.status_code == 200, "a browser asks this without a key"
    assert allowed.headers["access-control-allow-origin"] == ORIGIN
    assert "Authorization" in allowed.headers["access-control-allow-headers"]
    assert "access-control-allow-credentials" not in allowed.headers
    foreign = anyone.options("/v1/meshes", headers={"Origin": "https://evil.example", **asked})
    assert foreign.status_code == 400 and "access-control-allow-origin" not in foreign.headers
    refused = anyone.get("/v1/meshes", headers={"Origin": ORIGIN})
    assert (refused.status_code, refused.headers["access-control-allow-origin"]) == (401, ORIGIN), "a page sees why it was refused"
    with guarded.http("reader") as http:
        answer = http.get("/v1/meshes", headers={"Origin": ORIGIN})
    assert "X-Accuracy" in answer.headers["access-control-expose-headers"]


def test_browsers_are_told_what_they_may_do(guarded, anyone, guarded_cube):
    with guarded.http("reader") as http:
        page, picture = http.get("/"), http.get(f"/v1/meshes/{guarded_cube.id}/thumbnail.png?size=32")
    for answer in (page, picture, anyone.get("/healthz"), anyone.get("/v1/meshes")):
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["strict-transport-security"].startswith("max-age=")
        assert answer.headers["cross-origin-resource-policy"] == "cross-origin"
        assert "frame-ancestors" in answer.headers["content-security-policy"]
    assert "default-src 'self'" in page.headers["content-security-policy"], "the page still works"
    assert "sandbox" in picture.headers["content-security-policy"]
