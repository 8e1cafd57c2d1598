"""What loading changes about a mesh, in order, and what it says about the result."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from geometry.topology import EdgeTable, NotManifoldError, build_edges, signed_volume
from schemas.mesh import Capability
from worker.kernels.load_union import fans
from worker.loading.faults import rejected
from worker.loading.holes import close_holes
from worker.loading.manifold import drop_fins, split_manifold
from worker.loading.needles import remove_needles
from worker.loading.orient import make_consistent, orient_outward
from worker.loading.surface import Surface
from worker.loading.weld import drop_collapsed, drop_duplicates


def drop_no_faces(surface: Surface, repairs: dict[str, Any]) -> Surface:
    """Without faces that name a vertex twice; MeshRejectedError when none is left."""
    surface, repairs["dropped_collapsed_faces"] = drop_collapsed(surface)
    if not len(surface.faces):
        raise rejected("no-faces", "No face of the mesh has three different corners.")
    return surface


def repair(surface: Surface, repairs: dict[str, Any], progress: Callable[[float], None]) -> Surface:
    """Duplicates, directions, holes, edges of more than two faces, outside, faces without area: in this order.

    Holes come before cutting, because a vertex where holes touch would be cut into the loops. Edges are cut only where that
    closes the mesh. `repairs` takes the counts.
    """
    surface, repairs["dropped_duplicate_faces"] = drop_duplicates(surface)
    surface, directions = make_consistent(surface)
    repairs["turned_faces"] = directions.turned
    repairs["one_sided_patches"] = directions.one_sided
    progress(0.3)
    surface, holes = close_holes(surface)
    repairs |= {"closed_holes": holes.holes, "closed_hole_edges": holes.edges, "added_faces": holes.faces}
    progress(0.5)
    closed = not surface.edges.balances.any()
    if closed:
        before = len(surface.positions)
        surface, split = split_manifold(surface)
        repairs |= {"split_edges": split.edges, "added_vertices": len(surface.positions) - before}
        surface, fins = drop_fins(surface)
        repairs |= {"halved_faces": split.halved_faces, "removed_fin_faces": split.removed_fins + fins}
    progress(0.7)
    surface, repairs["flipped_components"] = orient_outward(surface, directions.agreed, closed)
    surface, needles = remove_needles(surface)
    repairs["flipped_zero_area_faces"] = needles.flipped
    repairs["dropped_zero_area_faces"] = needles.dropped
    repairs["kept_zero_area_faces"] = needles.kept
    progress(0.9)
    return surface


def edges_and_clip(surface: Surface) -> tuple[EdgeTable | None, Capability]:
    """The edge table and whether silhouette clipping can use the mesh, or None and what is in the way."""
    faces = np.ascontiguousarray(surface.faces, np.int32)
    try:
        edges = build_edges(faces)
    except NotManifoldError:
        return None, Capability(available=False, reason=_why_open(surface))
    if signed_volume(surface.positions, faces) <= 0.0:
        return edges, Capability(available=False, reason="The surface is closed, but it bounds no volume or is inside out.")
    if _fans(surface) != len(surface.positions):
        return edges, Capability(available=False, reason="The surface is closed, but touches itself at a vertex that is not cut apart.")
    return edges, Capability(available=True)


def _fans(surface: Surface) -> int:
    edges = surface.edges
    first, second = edges.order[0::2], edges.order[1::2]
    mates = np.empty(len(edges.order), np.int64)
    mates[first], mates[second] = second, first
    fan = fans(mates)
    return int((fan == np.arange(len(fan))).sum())


def _why_open(surface: Surface) -> str:
    edges = surface.edges
    counts, balances = edges.counts, edges.balances
    boundary = int((counts == 1).sum())
    many = int(((counts > 2) & (balances != 0)).sum())
    crossing = int(((counts > 2) & (balances == 0)).sum())
    clash = int(((counts == 2) & (balances != 0)).sum())
    faults = [
        (boundary, "boundary edge", "that belong to one face only"),
        (many, "edge", "with more faces on one side than on the other"),
        (crossing, "edge", "shared by more than two faces"),
        (clash, "edge", "whose two faces have opposite directions"),
    ]
    parts = [f"{n} {what}{'s' if n > 1 else ''} {how if n > 1 else _single(how)}" for n, what, how in faults if n]
    return f"The surface is not closed: it has {', '.join(parts)}."


def _single(how: str) -> str:
    return how.replace("that belong", "that belongs")
