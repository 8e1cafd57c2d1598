"""Which of a mesh's rungs a view is drawn on: one pass over all of them."""

from __future__ import annotations

import numpy as np
from numba import njit

ANY = -2
"""Of a wanted code: whatever it is."""
ORIGINAL, COVERAGE = 0, 4
"""Codes of `service.rungs.SOURCES` and `ANTIALIASES` that rules are about."""
TERMS = 6
"""Of a cost: 1, silhouette edges, pixels drawn, the root of these, pixels of the image, and that root times the pixels by which a level
is beyond the mesh, which is left to the kernels."""


@njit(cache=True, nogil=True)
def pixels_per_unit(pixels, corners, width, height):
    """(pixels, limit): points within d of each other, normalised units, are within d * pixels in the image, when d < limit.

    pixels: (4, 4) f8 of `View.pixels`, corners (8, 3) f8 of a box that one of the points is in; the other is seen in the image. limit is
    not above 0 where nothing can be said. Not rounded up.

    With pixels u / w, v / w linear in the point, a point that is seen at pixel c and moved by d is seen at a pixel that is
    (D - c D_w) d / w' away, with D and D_w the derivatives of (u, v) and w, and w' the depth where it comes to. The norm of that
    matrix is convex in c: it is largest in a corner of the image.
    """
    a, b, c, shift = pixels[3, 0], pixels[3, 1], pixels[3, 2], pixels[3, 3]
    slope = np.sqrt(a * a + b * b + c * c)
    nearest, reach = np.inf, 0.0
    for i in range(corners.shape[0]):
        x, y, z = corners[i, 0], corners[i, 1], corners[i, 2]
        nearest = min(nearest, a * x + b * y + c * z)
        reach = max(reach, abs(x), abs(y), abs(z))
    nearest += shift - 1e-9 * (reach * (abs(a) + abs(b) + abs(c)) + abs(shift))
    largest = 0.0
    for across in (0.0, width):
        for down in (0.0, height):
            uu = uv = vv = 0.0
            for j in range(3):
                u, v = pixels[0, j] - across * pixels[3, j], pixels[1, j] - down * pixels[3, j]
                uu, uv, vv = uu + u * u, uv + u * v, vv + v * v
            half = 0.5 * (uu - vv)
            largest = max(largest, 0.5 * (uu + vv) + np.sqrt(half * half + uv * uv))
    if not nearest > 0.0:
        return np.inf, 0.0
    return np.sqrt(largest) / nearest, nearest / slope if slope > 0.0 else np.inf


@njit(cache=True, nogil=True)
def predicted(costs, scale, terms, added_px, i):
    """Milliseconds of rung i: costs (n, TERMS) f8 for each of terms (TERMS - 1,) f8, times scale (n,) f8; added_px: of its level."""
    total = costs[i, TERMS - 1] * added_px * terms[3]
    for j in range(TERMS - 1):
        total += costs[i, j] * terms[j]
    return total * scale[i]


@njit(cache=True, nogil=True)
def choose_rung(table, size, costs, scale, terms, seen, wanted, hulls, free, limits):
    """(rung, error in pixels, milliseconds); rung is -1 where none is as wanted.

    table: (source, antialias, level, hull, halvings (n,) i4, beyond (n,) f8, alone_px, psnr (n, s + 1) f8) of `RungTable`; size: a column
    of the last two. costs, scale, terms: of `predicted`. seen: (pixels, limit) of `pixels_per_unit`, rounded up. wanted: (source,
    antialias, level, hull, halvings), ANY for no wish. hulls: (usable (h,) bool: the eye is where it clips, least (h,) i4 halvings that
    the pixels show); free: whether hulls and coarser maps may be chosen from that were not asked for. limits: (most pixels of error,
    most that a level adds to it, budget in ms, least decibels), infinite or 0 for none.
    A level so near to the eye that nothing can be said of its error is no choice.
    Better is what breaks the bound less, then what falls less short of the decibels, then what is less over the budget; of what is equal
    there, the most accurate where there is a budget, else the cheapest.
    """
    source, antialias, level, hull, halvings, beyond, alone_px, psnr = table
    usable, least = hulls
    most_px, most_added, budget, decibels = limits
    has_budget = budget < np.inf
    best, best_error, best_ms = -1, np.inf, np.inf
    best_key = np.full(6, np.inf)
    key = np.empty(6)
    for i in range(source.shape[0]):
        if (wanted[0] != ANY and source[i] != wanted[0]) or (wanted[1] != ANY and antialias[i] != wanted[1]):
            continue
        if source[i] == ORIGINAL:
            if (wanted[2] >= 0) or (antialias[i] == COVERAGE and not usable[0]):
                continue
        else:
            if not usable[hull[i]] or (wanted[2] != ANY and level[i] != wanted[2]):
                continue
            if (wanted[3] != ANY and hull[i] != wanted[3]) or (wanted[3] == ANY and not free and hull[i] != 0):
                continue
            if wanted[4] != ANY:
                if halvings[i] != wanted[4]:
                    continue
            elif halvings[i] < least[hull[i]] or (not free and halvings[i] > least[hull[i]]):
                continue
        error, added = alone_px[i, size], 0.0
        if beyond[i] > 0.0:
            added = beyond[i] * seen[0]
            if not beyond[i] < seen[1] or added > most_added:
                continue
            error += added
        ms = predicted(costs, scale, terms, added, i)
        key[0] = max(0.0, error - most_px)
        key[1] = max(0.0, decibels - psnr[i, size])
        key[2] = max(0.0, ms - budget)
        if has_budget:
            key[3], key[4], key[5] = error, -psnr[i, size], ms
        else:
            key[3], key[4], key[5] = ms, error, -psnr[i, size]
        for j in range(6):
            if key[j] != best_key[j]:
                break
        if best < 0 or key[j] < best_key[j]:
            best, best_error, best_ms = i, error, ms
            best_key[:] = key
    return best, best_error, best_ms
