"""What parsing gives: one file as pieces in place, and as arrays."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from schemas.conventions import F8, I4, Array

I8 = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Piece:
    """One geometry of a file in place: vertices (v, 3) f8 model units, faces (f, 3) i8; `raw` is what the reader gave."""

    vertices: F8
    faces: I8
    raw: dict[str, Any]


@dataclass(frozen=True)
class Parsed:
    """A file as arrays: positions (v, 3) f8 model units, faces (f, 3) i4, and what artifacts.APPEARANCE holds, or nothing."""

    positions: F8
    faces: I4
    appearance: dict[str, Array]
    notes: dict[str, Any] = field(default_factory=dict)
