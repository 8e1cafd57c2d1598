"""Faces along the rays of an image, one by one: slow, for any eye, and of nothing that the product computes but its camera."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def _layers(corners, faces, xs, ys, front, back):
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        for column in range(xs.shape[0]):
            x = xs[column]
            ai, aj, ak = corners[i, 0] - x * corners[i, 2], corners[j, 0] - x * corners[j, 2], corners[k, 0] - x * corners[k, 2]
            if (ai > 0.0 and aj > 0.0 and ak > 0.0) or (ai < 0.0 and aj < 0.0 and ak < 0.0):
                continue
            for row in range(ys.shape[0]):
                y = ys[row]
                bi, bj, bk = corners[i, 1] - y * corners[i, 2], corners[j, 1] - y * corners[j, 2], corners[k, 1] - y * corners[k, 2]
                u, v, w = aj * bk - ak * bj, ak * bi - ai * bk, ai * bj - aj * bi
                depth = u * corners[i, 2] + v * corners[j, 2] + w * corners[k, 2]
                if u > 0.0 and v > 0.0 and w > 0.0 and depth > 0.0:
                    front[row, column] += 1
                if u < 0.0 and v < 0.0 and w < 0.0 and depth < 0.0:
                    back[row, column] += 1


def layers(view, positions, faces, samples=1):
    """(front, back): how many faces of either side each ray meets before the eye, (h * samples, w * samples) i8.

    Rays lie in the middles of samples^2 equal parts of each pixel.
    """
    m = view.matrix
    corners = np.ascontiguousarray((np.asarray(positions, np.float64) @ m[:, :3].T + m[:, 3])[:, [0, 1, 3]])
    xs = (np.arange(view.width * samples) + 0.5) / samples / view.width * 2.0 - 1.0
    ys = 1.0 - (np.arange(view.height * samples) + 0.5) / samples / view.height * 2.0
    front = np.zeros((len(ys), len(xs)), np.int64)
    back = np.zeros_like(front)
    _layers(corners, np.asarray(faces), xs, ys, front, back)
    return front, back


def covered(view, positions, faces, samples):
    """(h, w) f8: part of samples^2 rays of each pixel that meet a face, from either side: what there is to see from inside too."""
    front, back = layers(view, positions, faces, samples)
    return (front + back > 0).reshape(view.height, samples, view.width, samples).mean(axis=(1, 3))
