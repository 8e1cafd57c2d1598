"""What OpenAPI says where the code alone does not: bodies that are streams, answers that are pictures or problems."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from schemas.mesh import PreprocessOptions, Problem
from service.errors import PROBLEM_JSON

PROBLEMS = {
    400: "The request is not well-formed, or its body breaks its own format",
    401: "No key, or one that is not good here",
    403: "The key has not the scope, or the signature does not fit",
    404: "There is no such mesh",
    406: "None of the types in Accept can be produced",
    409: "The mesh is accepted, but not processed yet",
    413: "Over the size limit",
    415: "No loader knows this format",
    429: "The key, or without keys the address, is over its own quota; come back after Retry-After seconds",
    422: "The request is wrong (`errors` names the fields), or the mesh cannot be used",
    503: "Busy, or the object store does not answer; come back after Retry-After seconds",
    507: "The store has no room",
}

IMAGE_HEADERS: dict[str, Any] = {
    "Server-Timing": {"schema": {"type": "string"}, "description": "milliseconds of each pass"},
    "X-Plan": {"schema": {"type": "string"}, "description": "the passes that ran, in order"},
    "X-Accuracy": {
        "schema": {"type": "string"},
        "description": "rung of the ladder, its error in pixels and what that rests on, and what was asked and could not be kept",
    },
    "ETag": {"schema": {"type": "string"}},
}

ACCURACY_EXAMPLE: dict[str, Any] = {
    "mesh": "3f2a917c5be04d1f8a6c0d9e2b7f4a11",
    "name": "bunny.ply",
    "size": 512,
    "sizes": [256, 512],
    "device": "llvmpipe (LLVM 15.0.6, 256 bits)",
    "devices": ["llvmpipe (LLVM 15.0.6, 256 bits)"],
    "views": 12,
    "samples": 16,
    "rungs": [
        {
            "source": "clipped",
            "antialias": "coverage",
            "hull_faces": 1000,
            "texels": 1012,
            "name": "clipped/coverage, 1000 faces, 1012 texels",
            "bound_px": 0.00196,
            "alpha_error": 0.0026,
            "alpha_rmse": 0.0047,
            "distance_px": 0.012,
            "wrong_pixels": 0.0,
            "psnr_db": 32.6,
            "ssim": 0.981,
            "ms": 4.58,
            "ms_p95": 5.02,
            "passes": {"edges": {"p50_ms": 0.21, "p95_ms": 0.24}, "surface": {"p50_ms": 2.47, "p95_ms": 2.8}},
        },
    ],
    "pareto": {"outline": [0], "shading": [0]},
}

POSITIONS = """places of the mesh's vertices, in the order of original.glb and in model units: 3 little-endian float32 a vertex, or numpy's
.npy of float32 or float64; of a sequence, those of a frame after those of another"""

RAW_FORMAT = "application/octet-stream"


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """OpenAPI answers for these error statuses."""
    return {status: {"description": PROBLEMS[status], "content": {PROBLEM_JSON: {"schema": _problem_schema()}}} for status in statuses}


def image_answer(*media_types: str, plan: type[BaseModel] | None = None) -> dict[int | str, dict[str, Any]]:
    """OpenAPI answer of a route that gives a picture, or how it would make it."""
    binary = {"schema": {"type": "string", "format": "binary"}}
    content: dict[str, Any] = dict.fromkeys(media_types, binary)
    content |= {} if plan is None else {"application/json": {"schema": schema_of(plan)}}
    described = {"description": "The picture", "content": content, "headers": IMAGE_HEADERS}
    return {200: described, 304: {"description": "The client has it already"}}


def sequence_answer(*media_types: str) -> dict[int | str, dict[str, Any]]:
    """OpenAPI answer of a route that gives a sequence of pictures."""
    content = {media: {"schema": {"type": "string", "format": "binary"}} for media in media_types}
    headers = {name: IMAGE_HEADERS[name] for name in ("Server-Timing", "X-Plan", "X-Accuracy")}
    headers["X-Frames"] = {"schema": {"type": "integer"}, "description": "how many there are"}
    return {200: {"description": "The frames: an animation, or PNGs in an archive", "content": content, "headers": headers}}


def silhouette_answer(model: type[BaseModel]) -> dict[int | str, dict[str, Any]]:
    """OpenAPI answer of a route that gives a silhouette."""
    binary = {"schema": {"type": "string", "format": "binary"}}
    content = {"application/json": {"schema": schema_of(model)}, "image/svg+xml": {}, "image/vnd.dxf": binary, RAW_FORMAT: binary}
    headers = {name: IMAGE_HEADERS[name] for name in ("Server-Timing", "X-Accuracy", "ETag")}
    return {
        200: {"description": "The silhouette", "content": content, "headers": headers},
        304: {"description": "The client has it already"},
    }


def schema_of(model: type[BaseModel]) -> dict[str, Any]:
    """JSON schema of a model that says what it is of in place: references into a schema of its own lead nowhere in a document of many."""
    described = model.model_json_schema()
    definitions = described.pop("$defs", {})

    def placed(part: Any) -> Any:
        if isinstance(part, list):
            return [placed(item) for item in part]
        if not isinstance(part, dict):
            return part
        named = part.get("$ref", "").removeprefix("#/$defs/")
        rest = {name: placed(value) for name, value in part.items() if name != "$ref"}
        if (each := rest.get("prefixItems")) and all(item == each[0] for item in each):  # a vector, as every tool reads it
            rest = {name: value for name, value in rest.items() if name != "prefixItems"} | {"items": each[0]}
        return placed(definitions[named]) | rest if named else rest

    found: dict[str, Any] = placed(described)
    return found


def _problem_schema() -> dict[str, Any]:
    return schema_of(Problem)


def _option_parameters() -> list[dict[str, Any]]:
    name = {"name": "name", "in": "query", "required": False, "schema": {"type": "string"}, "example": "knot.ply"}
    name["description"] = "file name; its ending says the format: stl, obj, ply, off, glb, 3mf"
    fields = schema_of(PreprocessOptions)["properties"]
    return [name, *({"name": key, "in": "query", "required": False, "schema": schema} for key, schema in fields.items())]


def _form_schema() -> dict[str, Any]:
    fields = schema_of(PreprocessOptions)["properties"]
    return {"type": "object", "required": ["file"], "properties": {"file": {"type": "string", "format": "binary"}, **fields}}


def once_body(request: type[BaseModel]) -> dict[str, Any]:
    """OpenAPI body of a route that takes a mesh and a request for one answer."""
    described = {"type": "string", "description": f"JSON of {request.__name__}", "contentMediaType": "application/json"}
    form = {
        "type": "object",
        "required": ["file"],
        "properties": {"file": {"type": "string", "format": "binary"}, "request": described, "repair": {"enum": ["auto", "never"]}},
    }
    raw = {"schema": {"type": "string", "format": "binary"}}
    return {"requestBody": {"required": True, "content": {RAW_FORMAT: raw, "multipart/form-data": {"schema": form}}}}


def form_body(request: type[BaseModel]) -> dict[str, Any]:
    """OpenAPI body of a route that takes positions of a mesh's vertices beside a request; without them the request is the body, as JSON."""
    described = {"type": "string", "description": f"JSON of {request.__name__}", "contentMediaType": "application/json"}
    positions = {"type": "string", "format": "binary", "description": POSITIONS}
    form = {"type": "object", "properties": {"request": described, "positions": positions}}
    return {"requestBody": {"content": {"multipart/form-data": {"schema": form}}}}


UPLOAD_BODY: dict[str, Any] = {
    "parameters": _option_parameters(),
    "requestBody": {
        "required": True,
        "content": {
            RAW_FORMAT: {"schema": {"type": "string", "format": "binary"}},
            "multipart/form-data": {"schema": _form_schema()},
        },
    },
}
