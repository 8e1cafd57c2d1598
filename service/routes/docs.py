"""The API's reference as a page of our own, made in the browser from /openapi.json: nothing is fetched from elsewhere."""

from __future__ import annotations

from fastapi import APIRouter, Response

from service.routes.page import page_response

router = APIRouter(include_in_schema=False)


@router.get("/docs")
def docs() -> Response:
    """The reference."""
    return page_response("docs.html")
