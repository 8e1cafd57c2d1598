"""The error tree as problem details (RFC 9457): status and title of every error, and how a stage that failed says why."""

from __future__ import annotations

from schemas import errors
from schemas.mesh import Problem

STATUS: dict[type[errors.SilhouetteError], tuple[int, str]] = {
    errors.InvalidRequestError: (422, "The request is not valid"),
    errors.CapabilityError: (422, "This mesh cannot do that"),
    errors.MeshRejectedError: (422, "The mesh cannot be used"),
    errors.StageFailedError: (422, "The mesh could not be processed"),
    errors.UnknownFormatError: (415, "Unknown mesh format"),
    errors.TooLargeError: (413, "Too large"),
    errors.NotFoundError: (404, "Not found"),
    errors.NotReadyError: (409, "Not ready yet"),
    errors.BusyError: (503, "The service is busy"),
    errors.StoreUnavailableError: (503, "The object store does not answer"),
    errors.UnauthorizedError: (401, "A key is needed"),
    errors.ForbiddenError: (403, "Not allowed"),
    errors.QuotaError: (429, "Over the quota"),
    errors.StorageFullError: (507, "No room for the upload"),
    errors.CorruptArtifactError: (500, "A stored artifact is damaged"),
    errors.DamagedUploadError: (422, "The stored upload is damaged"),
    errors.CancelledError: (404, "The mesh was deleted"),
    errors.SilhouetteError: (500, "Internal error"),
}
"""HTTP status and title of each error, or of the nearest above it in the tree."""
PRIVATE = frozenset({*Problem.model_fields, "key", "path"})
"""What never goes from an error's `where` into a problem: RFC 9457's own members, and where things lie in the store."""
KEPT = (
    errors.MeshRejectedError,
    errors.UnknownFormatError,
    errors.TooLargeError,
    errors.CorruptArtifactError,
    errors.DamagedUploadError,
)
"""Errors that say of a mesh what it is; any other that ends a stage only says that the mesh could not be processed."""
BROKEN = errors.StageFailedError("This stage did not end well however often it was started.")
"""What the public hears of a fault of ours; the log has the trace."""


def problem_of(error: errors.SilhouetteError) -> Problem:
    """The problem that a mesh keeps when `error` ended one of its stages; `where` becomes extension members."""
    status, title = STATUS[type(error) if type(error) in KEPT else errors.StageFailedError]
    where = {name: value for name, value in error.where.items() if name not in PRIVATE}
    return Problem.model_validate(
        {**where, "code": error.code, "type": errors.PROBLEM_TYPE + error.code, "title": title, "status": status, "detail": error.message}
    )
