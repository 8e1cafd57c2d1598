"""Disjoint sets in an array of parents."""

from __future__ import annotations

from numba import njit


@njit(cache=True, inline="always")
def find_root(parent, i):
    """The root of i's set; paths are halved. parent (n,) integer, a root is its own parent."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i
