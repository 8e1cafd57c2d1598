"""Queries read by our own route against the same read by FastAPI's."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Annotated, Any

import pytest
from fastapi import APIRouter, FastAPI, Query, Request
from fastapi.routing import APIRoute
from httpx import ASGITransport, AsyncClient, Response
from starlette.responses import JSONResponse

from service import errors
from service.routes.query_route import QueryRoute
from service.state import Parts
from service.view_query import RenderQuery, SilhouetteQuery, ThumbnailQuery

MODELS = {"render": RenderQuery, "silhouette": SilhouetteQuery, "thumbnail": ThumbnailQuery}
QUERIES = (
    "",
    "width=300&azimuth=12.5&source=clipped",
    "width=300&width=400",
    "width=&height=7",
    "width=ten&height=1e400&azimuth=x",
    "nothing=1&size=64",
    "size=5000",
    "smooth=yes&contours=0&eye=1%2C2%2C3",
    "shading=plaid&antialias=none&source=none",
    "width=9999999999999999999999999",
    "a[]=1&%00=%ff",
)


def _app(route_class: type[APIRoute]) -> FastAPI:
    app = FastAPI()
    errors.install(app)
    app.state.services = SimpleNamespace(name="the parts")
    router = APIRouter(prefix="/{mesh_id}", route_class=route_class)
    for name, model in MODELS.items():

        async def told(mesh_id: str, suffix: str, view: Annotated[model, Query()], request: Request, parts: Parts) -> Any:  # type: ignore[valid-type]
            given = {"mesh": mesh_id, "suffix": suffix, "path": request.url.path, "parts": parts.name}
            return JSONResponse(given | {"view": view.model_dump()})

        told.__annotations__["view"] = Annotated[model, Query()]
        router.get(f"/{name}.{{suffix}}", name=name)(told)
    app.include_router(router)
    return app


def get(app: FastAPI, path: str) -> Response:
    """The answer of an application to a GET."""

    async def ask() -> Response:
        async with AsyncClient(transport=ASGITransport(app), base_url="http://127.0.0.1") as client:
            return await client.get(path)

    return asyncio.run(ask())


@pytest.fixture(scope="module")
def both():
    return _app(QueryRoute), _app(APIRoute)


@pytest.mark.parametrize("query", QUERIES)
@pytest.mark.parametrize("name", MODELS)
def test_a_query_is_read_and_refused_as_fastapi_does(both, name, query):
    ours, usual = (get(app, f"/m1/{name}.png?{query}") for app in both)
    assert ours.status_code == usual.status_code
    assert ours.json() == usual.json()
    assert ours.headers["content-type"] == usual.headers["content-type"]


def test_the_document_is_the_same(both):
    ours, usual = (get(app, "/openapi.json").json() for app in both)
    assert ours == usual
    assert len(ours["paths"]["/{mesh_id}/render.{suffix}"]["get"]["parameters"]) == 2 + len(RenderQuery.model_fields)
