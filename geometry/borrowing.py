"""How a kernel is compiled that neither makes nor returns arrays: it borrows its caller's, and counts no references to them.

Each call with named tuples of arrays, and each row of one, costs atomic counts: more than half of the time of a hull. A function
that makes an array does not compile this way; where it is called by one that borrows, it says so by `owning`, because numba hands
down how a caller is compiled. One that returns a new array must not be called at all: it would never be freed.
"""

from __future__ import annotations

from typing import Any

from numba import njit

_UNCOUNTED: dict[str, Any] = {"_nrt": False, "error_model": "numpy"}
_COUNTED: dict[str, Any] = {"_nrt": True}

borrowing = njit(cache=True, **_UNCOUNTED)
"""Decorator. A division by zero is infinite or nan, as in numpy, instead of an exception that every division is checked for."""
owning = njit(cache=True, **_COUNTED)
"""Decorator for what makes arrays for itself and is called by kernels that borrow."""
