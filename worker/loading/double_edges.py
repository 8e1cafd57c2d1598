"""The last resort for edges that still have two pairs of faces once every vertex has one fan.

There two sheets meet along an edge and are joined around both its ends, so no numbering of vertices tells them apart. One
pair keeps the edge; every other pair gets a middle vertex of its own. A pair of coincident opposite faces (a fin) is taken
out instead: it encloses nothing, and halved it would make another such edge.

            c                  c             h: a -> b in face f, g: b -> a across it
          /   \\              / | \\
        a - h > b    ->     a - m - b        f keeps (a, m, c), its second half is (m, b, c)
          \\   /              \\ | /
            d                  d
"""

from __future__ import annotations

import numpy as np

from schemas.conventions import F8
from worker.loading.surface import Index, Surface

MOST = 4096
"""Such edges in a mesh beyond which it is left as it is."""


class Patchwork:
    """Faces, corners and mates as lists that grow; a removed face has no vertices."""

    def __init__(self, surface: Surface, mates: Index) -> None:
        self.positions: list[F8] = []
        self.first_new = len(surface.positions)
        self.surface = surface
        self.faces: list[list[int]] = surface.faces.tolist()
        self.corners: list[list[int]] = surface.corners.tolist()
        self.mates: list[int] = mates.tolist()
        self.halved = 0
        self.removed: set[int] = set()

    def ends(self, h: int) -> tuple[int, int]:
        """The vertices half-edge h goes from and to."""
        face = self.faces[h // 3]
        return face[h % 3], face[(h + 1) % 3]

    def apex(self, h: int) -> int:
        """The third vertex of half-edge h's face."""
        return self.faces[h // 3][(h + 2) % 3]

    def link(self, h: int, g: int) -> None:
        """Make two half-edges each other's mates."""
        self.mates[h], self.mates[g] = g, h

    def take_out(self, h: int) -> None:
        """Remove the fin of h's face and its mate's; what lay across its other edges meets."""
        g = self.mates[h]
        for k in (1, 2):
            one = _turned(h, k)
            other = _turned(g, 3 - k)
            x, y = self.mates[one], self.mates[other]
            if x != other:
                self.link(x, y)
        self.removed |= {h // 3, g // 3}

    def halve(self, h: int) -> None:
        """Put a middle vertex on the edge of h and its mate, for these two faces alone."""
        g = self.mates[h]
        a, b = self.ends(h)
        middle = self.first_new + len(self.positions)
        self.positions.append((self._point(a) + self._point(b)) / 2.0)
        second_h, second_g = self._cut(h, middle), self._cut(g, middle)
        self.link(h, second_g)
        self.link(g, second_h)
        self.halved += 2

    def _point(self, v: int) -> F8:
        new = v - self.first_new
        return self.positions[new] if new >= 0 else self.surface.positions[v].astype(np.float64)

    def _cut(self, h: int, middle: int) -> int:
        """Shorten h to end in the middle; returns the half-edge from the middle on, in a new face."""
        f, i, j, k = h // 3, h % 3, (h + 1) % 3, (h + 2) % 3
        face, corners = self.faces[f], self.corners[f]
        first = 3 * len(self.faces)
        self.faces.append([middle, face[j], face[k]])
        self.corners.append([corners[i], corners[j], corners[k]])
        self.mates += [-1, -1, -1]
        face[j], corners[j] = middle, corners[i]
        across = self.mates[3 * f + j]
        self.link(first + 1, across)
        self.link(first + 2, 3 * f + j)
        return first

    def result(self) -> tuple[Surface, Index]:
        """The surface, and the mates of its half-edges."""
        keep = np.array([f not in self.removed for f in range(len(self.faces))])
        number = np.cumsum(keep) - 1
        mates = np.array(self.mates)[np.repeat(keep, 3)]
        mates = np.where(mates < 0, -1, 3 * number[mates // 3] + mates % 3)
        points = np.array(self.positions, np.float32).reshape(-1, 3)
        surface = Surface(np.concatenate([self.surface.positions, points]), np.array(self.faces)[keep], np.array(self.corners)[keep])
        return surface, mates


def _turned(h: int, k: int) -> int:
    """The half-edge k steps after h in its face."""
    return h - h % 3 + (h + k) % 3


def part_double_edges(surface: Surface, mates: Index) -> tuple[Surface, Index, int, int]:
    """(surface, mates, faces halved, faces of fins taken out): one round over the edges of more than two paired faces."""
    edges = surface.edges
    double = np.flatnonzero((edges.counts > 2) & (edges.balances == 0))
    if len(double) > MOST:
        return surface, mates, 0, 0
    work = Patchwork(surface, mates)
    for e in double:
        members = edges.order[edges.start[e] : edges.start[e + 1]]
        a, b = (int(v) for v in (surface.faces[members[0] // 3, members[0] % 3], surface.faces[members[0] // 3, (members[0] + 1) % 3]))
        pairs = [int(h) for h in members if edges.forward[h] and mates[h] >= 0]
        pairs.sort(key=lambda h: work.apex(h) == work.apex(work.mates[h]))
        for h in pairs[1:]:
            g = work.mates[h]
            if {h // 3, g // 3} & work.removed or set(work.ends(h)) != {a, b} or set(work.ends(g)) != {a, b}:
                continue  # an earlier edge changed these faces; the next round sees to them
            if work.apex(h) == work.apex(g):
                work.take_out(h)
            else:
                work.halve(h)
    return *work.result(), work.halved, len(work.removed)
