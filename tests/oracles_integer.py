"""Signs in rational arithmetic as whole numbers: every double is a mantissa times a power of two, so a row of them is a row of integers.

As `tests.oracles`, and independent of the product too, but several hundred times as fast. Arrays of Python integers, any length.
"""

from __future__ import annotations

import numpy as np


def integers(rows):
    """(n, k) finite floats -> ((n, k) Python integers, (n,) exponents e): row i is its integers times 2^e[i]."""
    values = np.asarray(rows, np.float64)
    fraction, exponent = np.frexp(values)
    mantissa, exponent = np.ldexp(fraction, 53).astype(np.int64), exponent.astype(np.int64) - 53
    lowest = np.where(mantissa == 0, 1, mantissa & -mantissa)
    zeros = np.frexp(lowest.astype(np.float64))[1] - 1
    mantissa, exponent = mantissa >> zeros, np.where(mantissa == 0, 1 << 20, exponent + zeros)
    unit = exponent.min(axis=1)
    shift = np.where(mantissa == 0, 0, exponent - unit[:, None])
    return mantissa.astype(object) << shift.astype(object), np.where(unit == 1 << 20, 0, unit)


def _signs(values):
    return (values > 0).astype(np.int8) - (values < 0).astype(np.int8)


def orientations(corners, eyes):
    """(n,) i1: sign of det[b - a, c - a, eye - w a] for corners (n, 3, 3) and homogeneous eyes (n, 4), w 0 or 1."""
    rows, _ = integers(np.concatenate([np.asarray(corners, np.float64).reshape(-1, 9), np.asarray(eyes, np.float64)[:, :3]], axis=1))
    w = np.asarray(eyes)[:, 3].astype(np.int64).astype(object)
    a, b, c, eye = ([rows[:, 3 * i + k] for k in range(3)] for i in range(4))
    u, v = [q - p for p, q in zip(a, b, strict=True)], [q - p for p, q in zip(a, c, strict=True)]
    total = 0
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        total = total + (u[i] * v[j] - u[j] * v[i]) * (eye[k] - w * a[k])
    return _signs(total)


def orientations_2d(points):
    """(n,) i1: sign of det[b - a, p - a] for points (n, 3, 2): a, b, p."""
    ax, ay, bx, by, px, py = integers(np.asarray(points, np.float64).reshape(-1, 6))[0].T
    return _signs((bx - ax) * (py - ay) - (by - ay) * (px - ax))


class Facing:
    """The facing rule for all faces of a mesh, their planes made once. positions (v, 3) f4 finite, faces (f, 3)."""

    def __init__(self, positions, faces):
        rows, (self.unit,) = integers(np.asarray(positions).reshape(1, -1))
        a, b, c = (rows.reshape(-1, 3)[faces[:, k]].T for k in range(3))
        u, v = b - a, c - a
        self.normal = [u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3] for k in range(3)]
        self.offset = sum(n * x for n, x in zip(self.normal, a, strict=True))

    def front(self, eye):
        """(f,) bool: on or outside the plane, for a homogeneous eye (4,)."""
        ((x, y, z),), (unit,) = integers(np.asarray(eye)[None, :3])
        along = self.normal[0] * x + self.normal[1] * y + self.normal[2] * z
        if eye[3]:
            here, there = int(max(unit - self.unit, 0)), int(max(self.unit - unit, 0))
            along = (along << here) - (self.offset << there)
        return (along >= 0).astype(bool)
