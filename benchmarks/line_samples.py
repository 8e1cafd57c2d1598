"""Points along the visible and hidden pieces of vector lines, for what is compared with them."""

from __future__ import annotations

import numpy as np

from schemas.conventions import F8, Array
from service.silhouette.lines import Pieces


def points_along(pieces: Pieces, chosen: Array, apart_px: float) -> tuple[Array, F8]:
    """(piece (n,) int, part (n,) f8): places apart_px apart on the chosen (p,) bool pieces, in the middle of equal shares of each.

    part: of the piece's clipped line in the image, 0 to 1.
    """
    rows = np.flatnonzero(chosen)
    ends, spans = pieces.image[pieces.line[rows]], pieces.spans[rows]
    length = np.hypot(ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1]) * (spans[:, 1] - spans[:, 0])
    count = np.ceil(length / apart_px).astype(int)
    of = np.repeat(np.arange(len(rows)), count)
    share = (np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[of]
    return rows[of], spans[of, 0] + share * (spans[of, 1] - spans[of, 0])


def pixels_at(pieces: Pieces, piece: Array, part: F8) -> F8:
    """(n, 2) f8 pixels, y down, of such places."""
    ends = pieces.image[pieces.line[piece]]
    return np.asarray(ends[:, :2] + part[:, None] * (ends[:, 2:4] - ends[:, :2]))
