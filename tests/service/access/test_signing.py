"""Signed addresses: good exactly as they were signed, until they expire."""

import hmac
import time
from datetime import UTC, datetime, timedelta
from urllib.parse import parse_qsl, quote, urlencode, urlsplit

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.access import NewKey, Scope, SignRequest
from schemas.errors import ForbiddenError, InvalidRequestError
from service.access import signing
from service.access.tokens import make_key

MESH = "3f2a917c5be04d1f8a6c0d9e2b7f4a11"
RECORD = make_key(NewKey(name="page"))[0]
OTHER = make_key(NewKey(name="other"))[0]

names = st.sampled_from(["azimuth", "size", "background", "eye", "x y", "ä"])
queries = st.dictionaries(names, st.text(st.characters(codec="utf-8"), max_size=12), max_size=5)


def signed(address=f"/v1/meshes/{MESH}/render.png?azimuth=40", expires_in_s=60, record=RECORD):
    return signing.sign(record, SignRequest(url=address, expires_in_s=expires_in_s))


def verified(url, record=RECORD):
    """What the guard does with an address: when it expires. Raises ForbiddenError."""
    parts = urlsplit(url)
    pairs, given = signing.parse(parts.query)
    return signing.check(record, parts.path, pairs, given)


def with_query(url, change):
    parts = urlsplit(url)
    pairs = parse_qsl(parts.query, keep_blank_values=True)
    return f"{parts.path}?{urlencode(change(pairs))}"


@given(queries)
def test_a_signed_address_is_good_and_leads_to_what_was_signed(query):
    answer = signed(f"/v1/meshes/{MESH}/render.webp?{urlencode(query)}")
    assert verified(answer.url) == int(answer.expires.timestamp())
    pairs, _ = signing.parse(urlsplit(answer.url).query)
    assert dict(parse_qsl(signing.without_signature(pairs).decode(), keep_blank_values=True)) == query


@given(queries, st.data())
def test_an_address_with_anything_changed_is_refused(query, data):
    url = signed(f"/v1/meshes/{MESH}/render.png?{urlencode(query)}").url

    def change(pairs):
        how = data.draw(st.sampled_from(["drop", "add", "alter"]))
        place = data.draw(st.integers(0, len(pairs) - 1))
        name, value = pairs[place]
        if how == "drop" and name != "sig":
            return [*pairs[:place], *pairs[place + 1 :]]
        if how == "alter":
            other = data.draw(st.text(st.characters(codec="utf-8"), max_size=8).filter(lambda text: text != value))
            return [*pairs[:place], (name, other), *pairs[place + 1 :]]
        return [*pairs, ("width", "8192")]

    with pytest.raises(ForbiddenError):
        verified(with_query(url, change))


def test_the_order_of_parameters_and_their_escapes_do_not_matter():
    url = signed(f"/v1/meshes/{MESH}/render.png?azimuth=40&background=%23ff00aa&eye=0,0,3").url
    assert verified(with_query(url, lambda pairs: pairs[::-1])) == verified(url)
    assert verified(url.replace("0%2C0%2C3", "0,0,3")) == verified(url)


def test_a_parameter_that_comes_twice_is_refused_signed_or_not():
    with pytest.raises(InvalidRequestError, match="size comes twice"):
        signed(f"/v1/meshes/{MESH}/thumbnail.png?size=64&size=1024")
    url = signed(f"/v1/meshes/{MESH}/thumbnail.png?size=64").url
    for twice in ("&size=64", "&sig=x", "&exp=99999999999"):
        with pytest.raises(ForbiddenError, match="twice"):
            verified(url + twice)


@pytest.mark.parametrize(
    "path", [f"/v1/meshes/{MESH}/render.webp", f"/v1/meshes/{'0' * 32}/render.png", "/v1/meshes", f"/v1/meshes/{MESH}", "/v1/keys", "/docs"]
)
def test_a_signature_is_for_its_own_path(path):
    query = urlsplit(signed().url).query
    with pytest.raises(ForbiddenError):
        verified(f"{path}?{query}")


def test_an_address_ends_when_it_expires(monkeypatch):
    answer = signed(expires_in_s=30)
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now + 28)
    verified(answer.url)
    monkeypatch.setattr(time, "time", lambda: now + 31)
    with pytest.raises(ForbiddenError, match="expired") as error:
        verified(answer.url)
    assert error.value.code == "signature-expired"


def test_an_address_ends_with_its_key():
    ending = RECORD.model_copy(update={"expires": datetime.now(UTC) + timedelta(seconds=20)})
    assert signed(expires_in_s=3600, record=ending).expires <= ending.expires
    with pytest.raises(ForbiddenError, match="revoked"):
        verified(signed().url, record=None)


def test_another_keys_signature_does_not_fit():
    with pytest.raises(ForbiddenError, match="does not fit"):
        verified(signed(record=OTHER).url, record=RECORD)


def test_a_key_that_may_not_read_cannot_sign_for_itself():
    uploader = make_key(NewKey(name="uploader", scopes=[Scope.WRITE]))[0]
    with pytest.raises(ForbiddenError, match="may not read"):
        verified(signed(record=uploader).url, record=uploader)


def test_the_signature_is_compared_in_constant_time(monkeypatch):
    compared = []
    url = signed().url
    monkeypatch.setattr(hmac, "compare_digest", lambda a, b: compared.append((a, b)) or False)
    with pytest.raises(ForbiddenError):
        verified(url)
    assert len(compared) == 1 and compared[0][0] == compared[0][1]


def test_the_signature_does_not_give_the_stored_hash_away():
    assert RECORD.secret_sha256 not in signed().url
    assert signing.signature(RECORD, "/a", [("b", "c")]) != signing.signature(OTHER, "/a", [("b", "c")])


@pytest.mark.parametrize(
    "address",
    [
        "/v1/meshes",
        f"/v1/meshes/{MESH}",
        f"/v1/meshes/{MESH}/events",
        f"/v1/meshes/{MESH}/accuracy",
        f"/v1/meshes/{MESH}/silhouette.json",
        f"/v1/meshes/{MESH}/artifacts/hull.bin",
        f"/v1/meshes/{MESH}/artifacts/../../../keys",
        f"/v1/meshes/{MESH}/render.png/",
        f"/v1/meshes/{MESH[:-1]}/render.png",
        f"https://elsewhere.example/v1/meshes/{MESH}/render.png",
        f"//elsewhere.example/v1/meshes/{MESH}/render.png",
        f"v1/meshes/{MESH}/render.png",
        f"/v1/meshes/{MESH}/render.png#part",
        f"/v1/meshes/{MESH}/render.png?sig=a",
        f"/v1/meshes/{MESH}/render.png?exp=99999999999",
        "",
        "http://[",
    ],
)
def test_what_is_no_picture_of_a_mesh_cannot_be_signed(address):
    with pytest.raises(InvalidRequestError) as error:
        signed(address)
    assert error.value.where["field"] == "url"


@pytest.mark.parametrize(
    "name",
    [
        "thumbnail.png",
        "thumbnail.jpg",
        "render.webp",
        "turntable.webp",
        "silhouette.svg",
        "accuracy.svg",
        "artifacts/hull.glb",
        "artifacts/normal.png",
    ],
)
def test_pictures_drawings_and_downloads_can_be_signed(name):
    verified(signed(f"/v1/meshes/{MESH}/{name}").url)
    verified(signed(quote(f"/v1/meshes/{MESH}/{name}")).url)
