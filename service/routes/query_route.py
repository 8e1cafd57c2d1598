"""Routes whose query is one model, read without FastAPI's solver, which takes longer over sixty parameters than a small picture over its
outline: it asks for each by itself. Documents, models and errors are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from pydantic import BaseModel, ValidationError

from service.state import services_of

PARTS = "parts"
"""Parameter of a route that needs the parts."""


class QueryRoute(APIRoute):
    """A route of which an endpoint `(its path's texts, request, parts, one model of the query)` is called at once; others as usual.

    What OpenAPI says of dependencies has to be the middleware's work: none is called here.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """What answers a request. Raises RequestValidationError then."""
        asked = self.dependant
        if len(asked.query_params) != 1 or asked.body_params or asked.request_param_name is None:
            return super().get_route_handler()
        (field,) = asked.query_params
        model, endpoint, itself = field.field_info.annotation, self.endpoint, asked.request_param_name
        if not (isinstance(model, type) and issubclass(model, BaseModel)):
            return super().get_route_handler()

        async def answer(request: Request) -> Response:
            query = read_query(model, request)
            return await endpoint(**request.path_params, **{itself: request, PARTS: services_of(request), field.name: query})

        return answer


def read_query(model: type[BaseModel], request: Request) -> BaseModel:
    """The query of a request, of a name that comes twice the last. Raises RequestValidationError."""
    try:
        return model.model_validate(dict(request.query_params))
    except ValidationError as error:
        faults = error.errors(include_url=False, include_input=False)
        raise RequestValidationError([{**fault, "loc": ("query", *fault["loc"])} for fault in faults]) from error
