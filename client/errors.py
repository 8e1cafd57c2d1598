"""What can go wrong when talking to a service, as exceptions made from its `application/problem+json` answers.

ServiceError
├── UnreachableError      nobody answers at the address
├── RequestError          the request is wrong; `fields` says where            422
│   └── MeshFailedError   the mesh itself cannot be used or processed          422
├── UnauthorizedError     no key, or one that is not good there             401
├── ForbiddenError        the key has not the scope                         403
├── QuotaError            the key's own quota is used up                    429
├── NotFoundError         no such mesh or artifact                             404
├── NotReadyError         still being processed                                409
├── TooLargeError         over the service's size limit                        413
├── UnknownFormatError    no loader for this file                              415
└── BusyError             come back after `retry_after_s`                      503
"""

from __future__ import annotations

from typing import Any

import httpx

from schemas.mesh import Problem

REQUEST_CODES = frozenset({"invalid-request", "capability-unavailable"})
"""Codes of 422 that are about the request; all others say what is wrong with the mesh."""


class ServiceError(Exception):
    """A service's answer that is an error; `problem` is the whole of it, `str()` a sentence for people."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.detail)
        self.problem = problem

    @property
    def status(self) -> int:
        """HTTP status; 0 when there was no answer."""
        return self.problem.status

    @property
    def code(self) -> str:
        """Stable slug for programs."""
        return str((self.problem.model_extra or {}).get("code", "unknown"))

    @property
    def request_id(self) -> str | None:
        """By which whoever runs the service finds the request in its log; None when there was no answer."""
        return (self.problem.model_extra or {}).get("request_id")


class UnreachableError(ServiceError):
    """Nobody answers at the address, or the connection broke."""

    def __init__(self, address: str, reason: str) -> None:
        detail = f"No silhouette service answers at {address} ({reason}). Start one with: silhouette serve"
        super().__init__(Problem(title="Unreachable", status=0, detail=detail))


class RequestError(ServiceError):
    """The request is wrong."""

    @property
    def fields(self) -> list[dict[str, str]]:
        """`{field, message}` of each wrong field."""
        return list((self.problem.model_extra or {}).get("errors", []))


class MeshFailedError(RequestError):
    """The mesh cannot be used or processed."""


class UnauthorizedError(ServiceError):
    """The service needs a key, and there was none or it is not good."""


class ForbiddenError(ServiceError):
    """The key may not do this."""


class NotFoundError(ServiceError):
    """There is no such mesh or artifact."""


class NotReadyError(ServiceError):
    """The mesh is still being processed."""


class TooLargeError(ServiceError):
    """Over the service's size limit."""


class UnknownFormatError(ServiceError):
    """No loader knows the file's format."""


class BusyError(ServiceError):
    """The service is at its limit."""

    retry_after_s = 1.0


class QuotaError(ServiceError):
    """The key, or the address of a service without keys, is over its own quota."""

    retry_after_s = 1.0


BY_STATUS: dict[int, type[ServiceError]] = {
    401: UnauthorizedError,
    403: ForbiddenError,
    404: NotFoundError,
    409: NotReadyError,
    413: TooLargeError,
    415: UnknownFormatError,
    422: RequestError,
    429: QuotaError,
    503: BusyError,
}


def error_of(answer: httpx.Response) -> ServiceError:
    """The exception for an answer whose status says error; its body must have been read."""
    problem = _problem(answer)
    if problem.status == 422 and (problem.model_extra or {}).get("code") not in REQUEST_CODES:
        return MeshFailedError(problem)
    error = BY_STATUS.get(answer.status_code, ServiceError)(problem)
    if isinstance(error, (BusyError, QuotaError)):
        error.retry_after_s = float(answer.headers.get("Retry-After", "1"))
    return error


def _problem(answer: httpx.Response) -> Problem:
    try:
        body: Any = answer.json()
        return Problem.model_validate(body)
    except ValueError:
        return Problem(title="Error", status=answer.status_code, detail=f"The service answered {answer.status_code}.")
