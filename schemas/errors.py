"""The error tree. Every error a caller can cause is one of these; `service/errors.py` maps them to HTTP.

    SilhouetteError
    ├── InvalidRequestError     the request itself is wrong                        422 (names the field)
    │   └── CapabilityError     this mesh cannot do what was asked, and why        422
    ├── MeshRejectedError       the bytes are no usable mesh                       422 (kept as the mesh's failure)
    ├── UnknownFormatError      no loader for these bytes                          415
    ├── TooLargeError           over a configured limit                            413
    ├── NotFoundError           no such mesh or artifact                           404
    ├── NotReadyError           accepted, but not processed yet                    409
    ├── BusyError               admission is full, carries retry_after_s           503
    │   └── StoreUnavailableError   the object store does not answer               503
    ├── UnauthorizedError       no key, or none that is good here                  401
    ├── ForbiddenError          the key may not do this, or the signature is wrong 403
    ├── QuotaError              a key or address is over its quota, carries retry_after_s 429
    ├── StorageFullError        no space to accept the bytes                       507
    ├── CorruptArtifactError    a stored artifact fails its own checks             500
    │   ├── DamagedArtifactError its bytes are not those that were written         409 (it is made again)
    │   └── DamagedUploadError  the same of an upload or of the record of it       kept as the mesh's failure, until it is sent again
    ├── StageFailedError        a preprocessing stage could not finish             kept as the mesh's failure
    └── CancelledError          the mesh was deleted while a stage ran             never leaves the worker

`code` is a stable slug for programs; the message is a sentence for people, without paths or Python text.
"""

from __future__ import annotations

from typing import Any

PROBLEM_TYPE = "urn:silhouette:problem:"
"""`type` of a problem (RFC 9457) is this and its code; the same for a refused request and for a failed mesh."""


TOO_LATE = "The service could not answer in time; try again in a moment."
"""Message of a BusyError for what was admitted and took too long."""


class SilhouetteError(Exception):
    """Base of all errors of the product. `where` locates the fault (field, face index, byte offset, ...)."""

    code = "internal"

    def __init__(self, message: str, *, code: str | None = None, **where: Any) -> None:
        super().__init__(message)
        self.message = message
        self.where = where
        if code is not None:
            self.code = code


class InvalidRequestError(SilhouetteError):
    """The request is wrong; `where["field"]` names the field."""

    code = "invalid-request"


class CapabilityError(InvalidRequestError):
    """The mesh cannot do what was asked; the message says why."""

    code = "capability-unavailable"


class MeshRejectedError(SilhouetteError):
    """The uploaded bytes are not a usable mesh."""

    code = "mesh-rejected"


class UnknownFormatError(SilhouetteError):
    """No loader knows this format."""

    code = "unknown-format"


class TooLargeError(SilhouetteError):
    """A configured limit is exceeded; `where["limit"]` has it."""

    code = "too-large"


class NotFoundError(SilhouetteError):
    """There is no such mesh or artifact."""

    code = "not-found"


class NotReadyError(SilhouetteError):
    """The mesh is accepted but the asked-for part is not there yet."""

    code = "not-ready"


class BusyError(SilhouetteError):
    """The service is at its admission limit."""

    code = "busy"

    def __init__(self, message: str, *, retry_after_s: float = 1.0, **where: Any) -> None:
        super().__init__(message, **where)
        self.retry_after_s = retry_after_s


class StoreUnavailableError(BusyError):
    """The object store, which is another machine, does not answer or refuses us; nothing is lost."""

    code = "store-unavailable"

    def __init__(self, message: str, *, retry_after_s: float = 5.0, **where: Any) -> None:
        super().__init__(message, retry_after_s=retry_after_s, **where)


class UnauthorizedError(SilhouetteError):
    """A key is needed, and none came or it is not good."""

    code = "unauthorized"


class ForbiddenError(SilhouetteError):
    """Who asks is known and may not; `where["scope"]` names a scope that is missing."""

    code = "forbidden"


class QuotaError(SilhouetteError):
    """A key, or without keys an address, is over its own quota; `where["quota"]` names it, `where["limit"]` says how much it is."""

    code = "quota-exceeded"

    def __init__(self, message: str, *, retry_after_s: float = 1.0, **where: Any) -> None:
        super().__init__(message, **where)
        self.retry_after_s = retry_after_s


class StorageFullError(SilhouetteError):
    """The store has no room."""

    code = "storage-full"


class CorruptArtifactError(SilhouetteError):
    """A stored artifact does not pass its own checks."""

    code = "corrupt-artifact"


class DamagedArtifactError(CorruptArtifactError):
    """The bytes of a stored artifact are not those that were written, so its stage is to run again; `where["mesh"]` is the mesh."""


class DamagedUploadError(CorruptArtifactError):
    """The stored bytes of an upload are not those that came, or its acceptance cannot be read: whoever has them must send them again."""

    code = "damaged-upload"


class StageFailedError(SilhouetteError):
    """A preprocessing stage could not finish for a reason that running again will not change."""

    code = "stage-failed"


class CancelledError(SilhouetteError):
    """The mesh was deleted while one of its stages ran."""

    code = "cancelled"
