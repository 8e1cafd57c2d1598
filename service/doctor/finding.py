"""What one check found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from service.settings import ServiceSettings


@dataclass(frozen=True)
class Finding:
    """found: what there is, for people. fix: what to do about it; None where all is well. is_fatal: the service does not work so."""

    found: str
    fix: str | None = None
    is_fatal: bool = True

    @property
    def state(self) -> str:
        """`ok`, `warning` or `failed`."""
        if self.fix is None:
            return "ok"
        return "failed" if self.is_fatal else "warning"


Check = Callable[[ServiceSettings], Finding]
"""Looks at one thing. What it raises counts as failed."""
