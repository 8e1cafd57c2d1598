"""The web page, small files of our own and nothing from elsewhere."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter, Response

from schemas.errors import NotFoundError

router = APIRouter(include_in_schema=False)

FOLDER = Path(__file__).parents[1] / "page"
FILES = {
    "style.css": "text/css",
    "docs.css": "text/css",
    "docs.js": "text/javascript",
    "app.js": "text/javascript",
    "icon.svg": "image/svg+xml",
}
POLICY = "default-src 'self'; img-src 'self' blob:; object-src 'none'; base-uri 'none'; frame-ancestors 'self'"


@router.get("/")
def index() -> Response:
    """The page."""
    return page_response("index.html")


@router.get("/page/{name}")
def page_file(name: str) -> Response:
    """A file the page is made of."""
    if name not in FILES:
        raise NotFoundError("The page has no such file.")
    return Response((FOLDER / name).read_bytes(), media_type=FILES[name], headers={"Cache-Control": "no-cache"})


def page_response(name: str) -> Response:
    """An HTML file of the folder, allowed to use nothing but this service."""
    headers = {"Content-Security-Policy": POLICY, "Cache-Control": "no-cache", "X-Content-Type-Options": "nosniff"}
    return Response((FOLDER / name).read_bytes(), media_type="text/html", headers=headers)
