"""Gaps inside a mask."""

from __future__ import annotations

import numpy as np
from numba import njit

FULL = 255
OPEN, GAP = 1, 2


@njit(cache=True, nogil=True)
def fill_enclosed(mask, before, steps):
    """Fill gaps of mask (h, w) u1: it may be less full than `before` (h, w) u1 along its outline, but not inside.

    A pixel that was full stays less than full when it is at most `steps` steps, over such pixels, from one that was not full
    before either. Returns how many pixels were filled.
    """
    height, width = mask.shape
    state = np.zeros(mask.shape, np.uint8)
    gaps = 0
    for y in range(height):
        for x in range(width):
            if mask[y, x] != FULL:
                state[y, x] = GAP if before[y, x] == FULL else OPEN
                gaps += before[y, x] == FULL
    if gaps == 0:
        return 0
    queue = np.empty(gaps, np.int64)
    behind = 0
    for y in range(height if steps > 0 else 0):
        for x in range(width):
            if state[y, x] == GAP and _beside_open(state, y, x):
                queue[behind] = y * width + x
                behind += 1
    for i in range(behind):
        state[queue[i] // width, queue[i] % width] = OPEN
    start = 0
    for _ in range(1, steps):
        end = behind
        for i in range(start, end):
            y, x = queue[i] // width, queue[i] % width
            for ny in range(max(y - 1, 0), min(y + 2, height)):
                for nx in range(max(x - 1, 0), min(x + 2, width)):
                    if state[ny, nx] == GAP:
                        state[ny, nx] = OPEN
                        queue[behind] = ny * width + nx
                        behind += 1
        start = end
    for y in range(height):
        for x in range(width):
            if state[y, x] == GAP:
                mask[y, x] = FULL
    return gaps - behind


@njit(cache=True, nogil=True)
def _beside_open(state, y, x):
    for ny in range(max(y - 1, 0), min(y + 2, state.shape[0])):
        for nx in range(max(x - 1, 0), min(x + 2, state.shape[1])):
            if state[ny, nx] == OPEN:
                return True
    return False
