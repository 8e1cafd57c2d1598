"""What a request shows, and what a browser sends because another site's page told it to."""

import base64

import pytest
from starlette.datastructures import Headers

from service.access.credentials import challenges, is_foreign_write, token_of

ORIGIN = "https://shop.example"
OURS = {"host": "silhouette.example", "origin": "https://silhouette.example"}
FOREIGN = {"host": "silhouette.example", "origin": "https://evil.example"}


def basic(text: str) -> dict[str, str]:
    return {"authorization": "Basic " + base64.b64encode(text.encode()).decode()}


@pytest.mark.parametrize(
    ("headers", "token"),
    [
        ({}, None),
        ({"authorization": "Bearer a"}, "a"),
        ({"authorization": "BEARER  a "}, "a"),
        ({"x-api-key": "a"}, "a"),
        ({"authorization": "Bearer a", "x-api-key": "b"}, "a"),
        ({"authorization": "Negotiate c", "x-api-key": "b"}, "b"),
        (basic("anyone:a"), "a"),
        (basic("anyone:a:b"), "a:b"),
        (basic("a:"), "a"),
        ({"authorization": "Basic ?"}, ""),
        ({"authorization": "Basic /w=="}, ""),
    ],
)
def test_the_token_is_found_wherever_it_may_be(headers, token):
    assert token_of(Headers(headers)) == token


@pytest.mark.parametrize(
    ("headers", "method", "is_foreign"),
    [
        (FOREIGN, "POST", True),
        (FOREIGN, "DELETE", True),
        (FOREIGN, "GET", False),
        (OURS, "POST", False),
        ({"host": "silhouette.example"}, "POST", False),
        (OURS | {"origin": "null"}, "POST", True),
        (OURS | {"origin": "http://["}, "POST", True),
        (OURS | {"origin": "https://silhouette.example:8443"}, "POST", True),
        (FOREIGN | {"sec-fetch-site": "same-origin"}, "POST", False),
        (OURS | {"sec-fetch-site": "cross-site"}, "POST", True),
        (OURS | {"sec-fetch-site": "same-site"}, "POST", True),
        (FOREIGN | {"authorization": "Bearer x"}, "POST", False),
        (FOREIGN | {"x-api-key": "x"}, "POST", False),
        (FOREIGN | basic("a:b"), "POST", True),
        ({"host": "silhouette.example", "origin": ORIGIN}, "POST", False),
        ({"host": "silhouette.example", "origin": ORIGIN} | basic("a:b"), "POST", True),
    ],
)
def test_a_write_for_another_sites_page_is_known(headers, method, is_foreign):
    assert is_foreign_write(method, Headers(headers), (ORIGIN,)) is is_foreign


def test_with_every_origin_allowed_a_kept_password_still_is_not():
    assert not is_foreign_write("POST", Headers(FOREIGN), ("*",))
    assert is_foreign_write("POST", Headers(FOREIGN | basic("a:b")), ("*",))


def test_only_a_browser_on_our_own_page_is_asked_for_a_password():
    for own in ({"sec-fetch-site": "same-origin"}, {"accept": "text/html,*/*"}):
        assert [challenge.partition(" ")[0] for challenge in challenges(Headers(own))] == ["Bearer", "Basic"]
    for other in ({}, {"sec-fetch-site": "cross-site"}):
        assert [challenge.partition(" ")[0] for challenge in challenges(Headers(other))] == ["Bearer"]
