"""What the texels of a normal map say, counted."""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.tile_layout import texel_at


@njit(cache=True, nogil=True)
def texel_faults(normal, face_normals, side, columns, tolerance):
    """(texels whose normal's length is not 1 within tolerance, texels facing away from their face, the first of the former's face).

    normal (h, w, 3) u1; face_normals (hf, 3) f8 unit outward. Padding apart.
    """
    bad, away, where = 0, 0, -1
    for f in range(face_normals.shape[0]):
        for j in range(side + 1):
            for i in range(side + 1 - j):
                row, column = texel_at(f, i, j, side, columns)
                square = facing = 0.0
                for k in range(3):
                    x = np.float64(normal[row, column, k]) / 127.5 - 1.0
                    square += x * x
                    facing += x * face_normals[f, k]
                if abs(np.sqrt(square) - 1.0) > tolerance:
                    bad += 1
                    if where < 0:
                        where = f
                elif facing < 0.0:
                    away += 1
    return bad, away, where
