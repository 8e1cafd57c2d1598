"""How a stage that failed says why: the error tree as problem details (RFC 9457)."""

from __future__ import annotations

from schemas import errors
from schemas.mesh import Problem

UNPROCESSABLE = 422

TITLES: dict[type[errors.SilhouetteError], tuple[int, str]] = {
    errors.MeshRejectedError: (UNPROCESSABLE, "The mesh cannot be used"),
    errors.UnknownFormatError: (415, "Unknown mesh format"),
    errors.TooLargeError: (413, "Too large"),
    errors.CorruptArtifactError: (500, "A stored artifact is damaged"),
}
BROKEN = errors.StageFailedError("This stage did not end well however often it was started.")
"""What the public hears of a fault of ours; the log has the trace."""


def problem_of(error: errors.SilhouetteError) -> Problem:
    """The problem that a mesh keeps when `error` ended one of its stages; `where` becomes extension members."""
    status, title = TITLES.get(type(error), (UNPROCESSABLE, "The mesh could not be processed"))
    where = {name: value for name, value in error.where.items() if name not in Problem.model_fields}
    return Problem.model_validate(
        {**where, "code": error.code, "type": errors.PROBLEM_TYPE + error.code, "title": title, "status": status, "detail": error.message}
    )
