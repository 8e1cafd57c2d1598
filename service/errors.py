"""From the error tree to HTTP: one table, one shape (`application/problem+json`, RFC 9457), no text that was not meant for callers."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping
from typing import Any

import orjson
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import Match

from backend.problems import PRIVATE, STATUS
from schemas import errors as tree
from schemas.mesh import Problem
from schemas.render import CAMERA_FORMS
from schemas.scene import TRANSFORM_FORMS
from service.request_record import REQUEST_ID, current_request

log = logging.getLogger("silhouette.service")

PROBLEM_JSON = "application/problem+json"
METHODS = ("DELETE", "GET", "PATCH", "POST", "PUT")

HTTP_TITLES = {
    400: ("bad-request", "The request cannot be read", "The request is not well-formed HTTP or its body breaks its own format."),
    404: ("not-found", "Not found", "There is nothing at this address; /docs lists what there is."),
    405: ("method-not-allowed", "Method not allowed", "This address does not take that method; /docs lists what it takes."),
    406: ("not-acceptable", "Not acceptable", "None of the media types in Accept can be produced here."),
    413: ("too-large", "Too large", "The body is larger than this address takes."),
    416: ("range-not-satisfiable", "No such range", "The file ends before the range that was asked for begins."),
}

MESSAGES = {
    "extra_forbidden": "there is no such field",
    "missing": "is required",
    "model_attributes_type": "should be a JSON object",
}
"""By pydantic's type of fault, where its own words are about Python."""

FORMS = frozenset({*CAMERA_FORMS, *TRANSFORM_FORMS})
"""What pydantic puts into the place of a fault for the form of a field that was meant."""

NOT_READY_RETRY_S = 1
"""Seconds after which asking again for a mesh in processing makes sense; stages take seconds."""


class FailedMeshError(tree.MeshRejectedError):
    """The preprocessing of the mesh failed for good; `problem` is how the mesh itself says why."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.detail)
        self.problem = problem


class InvalidFieldsError(tree.InvalidRequestError):
    """Several fields may be wrong; each is `{field, message}`, under the names the caller used."""

    def __init__(self, fields: list[dict[str, str]]) -> None:
        super().__init__("; ".join(f"{item['field']}: {item['message']}" for item in fields), field=fields[0]["field"])
        self.fields = fields


def status_of(error: tree.SilhouetteError) -> tuple[int, str]:
    """(HTTP status, title) of an error: that of the nearest class of the tree."""
    return next(STATUS[kind] for kind in type(error).__mro__ if kind in STATUS)


def problem_of(error: tree.SilhouetteError) -> Problem:
    """The problem details a caller sees for an error of the tree."""
    if isinstance(error, FailedMeshError):
        at = {"field": error.where["field"]} if "field" in error.where else {}
        return error.problem.model_copy(update={"status": 422, "detail": error.message, **at})
    if isinstance(error, InvalidFieldsError):
        return validation_problem(error.fields)
    status, title = status_of(error)
    extra = {name: value for name, value in error.where.items() if name not in PRIVATE and _is_json(value)}
    if isinstance(error, tree.InvalidRequestError) and "field" in error.where:
        extra["errors"] = [{"field": error.where["field"], "message": error.message}]
    return Problem(type=tree.PROBLEM_TYPE + error.code, title=title, status=status, detail=error.message, code=error.code, **extra)


def located(error: tree.SilhouetteError, field: str) -> tree.SilhouetteError:
    """The error, saying which field of the request it came from."""
    error.message, error.where["field"] = f"{field}: {error.message}", field
    return error


def problem_response(problem: Problem, headers: Mapping[str, str] | None = None) -> Response:
    """A problem as an HTTP answer, with the id of the request."""
    if (record := current_request()) is not None:
        record.code = (problem.model_extra or {}).get("code")
        problem = problem.model_copy(update={"request_id": record.id})
    body = orjson.dumps(problem.model_dump(mode="json", exclude_none=True))
    return Response(body, status_code=problem.status, media_type=PROBLEM_JSON, headers={"Cache-Control": "no-store", **(headers or {})})


def invalid_fields(faults: Iterable[Mapping[str, Any]], names: Mapping[str, str] | None = None) -> list[dict[str, str]]:
    """Pydantic's faults as `{field, message}`, each field once; `names` renames dotted fields (`camera.fov_y_deg` -> `fov`)."""
    found: dict[str, str] = {}
    for fault in faults:
        field = _field(fault)
        if names is not None:  # a number of a vector is the whole parameter
            field = names.get(field) or names.get(field.partition("[")[0], field)
        if fault["type"] == "json_invalid":
            found.setdefault("body", "the body is not valid JSON")
        else:
            message = _message(fault, field)
            found[field] = f"{found[field]}; or {message}" if field in found else message
    return [{"field": field, "message": message} for field, message in found.items()]


def validation_problem(fields: list[dict[str, str]]) -> Problem:
    """422 that names every wrong field, the first of them in the detail."""
    first = fields[0] if fields else {"field": "body", "message": "not valid"}
    more = f" (and {len(fields) - 1} more)" if len(fields) > 1 else ""
    status, title = STATUS[tree.InvalidRequestError]
    code = tree.InvalidRequestError.code
    return Problem(
        type=tree.PROBLEM_TYPE + code,
        title=title,
        status=status,
        detail=f"{first['field']}: {first['message']}{more}",
        code=code,
        errors=fields,
    )


def _field(fault: Mapping[str, Any]) -> str:
    """Name of the field a fault is about, as `objects[2].mesh`, without where it came in and pydantic's names of union members."""
    between = (fault.get("ctx") or {}).get("field")
    parts = [f"[{part}]" if isinstance(part, int) else str(part) for part in fault["loc"] if part not in FORMS]
    if (len(parts) > 1 or (parts and between)) and parts[0] in ("body", "query", "path", "header"):
        parts = parts[1:]
    parts = [part for part in parts if part.startswith("[") or all(c.isalnum() or c in "_." for c in part)]
    return ".".join([*parts, between] if between else parts).replace(".[", "[") or "body"


def _message(fault: Mapping[str, Any], field: str) -> str:
    """What is wrong with `field`. Bytes that came as no JSON at all, as curl sends them unless told, are said to be so."""
    message = MESSAGES.get(fault["type"]) or str(fault["msg"]).removeprefix("Input ")
    return f"{message}, sent with Content-Type: application/json" if field == "body" else message


def _is_json(value: object) -> bool:
    return value is None or isinstance(value, (str, int, float, bool)) or (isinstance(value, (list, tuple)) and all(map(_is_json, value)))


def error_response(error: tree.SilhouetteError) -> Response:
    """An error of the tree as an HTTP answer; one of ours goes into the log."""
    headers = {}
    if isinstance(error, (tree.BusyError, tree.QuotaError)):
        headers["Retry-After"] = str(max(1, math.ceil(error.retry_after_s)))
    elif isinstance(error, tree.NotReadyError):
        headers["Retry-After"] = str(NOT_READY_RETRY_S)
    problem = problem_of(error)
    if problem.status == 500:
        log.error("%s: %s", error.code, error.message, exc_info=error)
    return problem_response(problem, headers)


async def _on_known(_: Request, error: Exception) -> Response:
    assert isinstance(error, tree.SilhouetteError)
    return error_response(error)


async def _on_invalid(_: Request, error: Exception) -> Response:
    assert isinstance(error, (RequestValidationError, ValidationError))
    return problem_response(validation_problem(invalid_fields(error.errors())))


async def _on_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    headers = {"Allow": ", ".join(allowed_methods(request))} if error.status_code == 405 else error.headers
    code, title, detail = HTTP_TITLES.get(error.status_code, ("http-error", "The request was refused", "The request was refused."))
    problem = Problem(type=tree.PROBLEM_TYPE + code, title=title, status=error.status_code, detail=detail, code=code)
    return problem_response(problem, headers)


def allowed_methods(request: Request) -> list[str]:
    """Methods that the address of a request takes; the router itself knows those of one of its routes."""
    routes = request.app.routes
    return [method for method in METHODS if any(route.matches({**request.scope, "method": method})[0] is Match.FULL for route in routes)]


async def _on_gone(_: Request, __: Exception) -> Response:
    return Response(status_code=499)  # nobody is left to read it; the number is for the access log


async def _on_unexpected(_: Request, __: Exception) -> Response:
    """Outside of all middleware, so that the id of the request is set here."""
    status, title = STATUS[tree.SilhouetteError]
    detail = "Something went wrong inside the service. The fault is in its log."
    problem = Problem(type=tree.PROBLEM_TYPE + "internal", title=title, status=status, detail=detail, code="internal")
    record = current_request()
    return problem_response(problem, {} if record is None else {REQUEST_ID: record.id})


def install(app: FastAPI) -> None:
    """Make every error of the app a problem."""
    app.add_exception_handler(tree.SilhouetteError, _on_known)
    app.add_exception_handler(RequestValidationError, _on_invalid)
    app.add_exception_handler(HTTPException, _on_http)
    app.add_exception_handler(ClientDisconnect, _on_gone)
    app.add_exception_handler(Exception, _on_unexpected)
