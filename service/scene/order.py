"""What must be drawn before what, and what cannot be told apart.

This work is based on: Silhouette Clipping, section 6 (antialiased clipping of several models needs visibility sorting), and its
reference [25], Snyder and Lengyel 1998, Visibility Sorting and Compositing without Splitting: a plane between two convex bodies
says which of them can hide the other, and what lies in a cycle is drawn together. Departures: the order is made anew for each
picture; bodies are refined (bounding box, clipping hull, the mesh's own convex hull) only where the coarser ones meet.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from itertools import combinations

import numpy as np
import numpy.typing as npt

from schemas.conventions import F8, Array, Frame
from service.assets import MeshAsset
from service.camera import View, project, to_pixels
from service.kernels.separation import separating_plane, shrunk
from service.scene.place import Placement, sphere_around

TOUCHING = 2.0**-21
"""Part of their size by which bodies may run into one another and still count as apart: positions are stored as float32, so
what only touches in the caller's model overlaps by their rounding."""

NEAR_EYE = 1e-3
"""Smallest depth over largest: below, a body's place in the image has lost the digits that a strict test needs."""

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Placed:
    """An object in the picture. index: its place in the request. view: the camera as its mesh sees it when drawn alone."""

    index: int
    asset: MeshAsset
    placement: Placement
    view: View


class Sight(Enum):
    """What two objects are to one another for an eye."""

    FREE = auto()  # no ray meets both
    BEFORE = auto()  # the first can hide the second, and never the other way round
    BEHIND = auto()  # the second can hide the first
    TANGLED = auto()  # neither can be shown


@dataclass(frozen=True)
class Group:
    """Objects drawn at one place in the order. members: places in the given sequence, ascending. tangled: the pairs of them that
    no plane separates; without such pairs, several members are a cycle.
    """

    members: tuple[int, ...]
    tangled: tuple[tuple[int, int], ...]


def sort_groups(objects: Sequence[Placed], eye: F8, frame: Frame) -> list[Group]:
    """The objects in groups, the farthest first: nothing in a group can be hidden by what comes before it.

    eye: (4,) f8 homogeneous, in `frame`, a frame of the scene. A group of one is an object that can be drawn on its own. Groups
    are the strongly connected parts of "must be drawn before", with tangled pairs running both ways; so whatever
    must come between two members is a member itself. Pairs that end in a cycle are compared once more, as closely as can be: boxes
    may overlap in the image where meshes do not.
    """
    sights = {(i, j): sight_of(objects[i], objects[j], eye, frame) for i, j in combinations(range(len(objects)), 2)}
    groups = _grouped(sights, len(objects))
    doubtful = [pair for group in groups for pair in combinations(group.members, 2) if sights[pair] in (Sight.BEFORE, Sight.BEHIND)]
    free = [pair for pair in doubtful if _are_free(objects[pair[0]], objects[pair[1]])]
    return _grouped(sights | dict.fromkeys(free, Sight.FREE), len(objects)) if free else groups


def _grouped(sights: Mapping[tuple[int, int], Sight], count: int) -> list[Group]:
    before = np.zeros((count, count), bool)
    for (i, j), sight in sights.items():
        before[i, j] = sight in (Sight.BEHIND, Sight.TANGLED)
        before[j, i] = sight in (Sight.BEFORE, Sight.TANGLED)
    reach = _closure(before)
    groups = []
    for members in _connected(reach):
        tangled = tuple(pair for pair in combinations(members, 2) if sights[pair] is Sight.TANGLED)
        groups.append(Group(members, tangled))
    # what must come before is in strictly more of these counts: sorting by them is a topological order
    return sorted(groups, key=lambda group: (int(reach[:, group.members[0]].sum()), group.members))


def sight_of(a: Placed, b: Placed, eye: F8, frame: Frame) -> Sight:
    """Which of two objects can hide the other from an eye (4,) f8 in `frame`.

    Exact up to TOUCHING, and TANGLED when unsure: bodies are the convex hulls of what is drawn, first coarse, then fine.
    """
    pair = sphere_around((a.placement, b.placement))
    seen = _eye_in(eye, frame, pair)
    plane = np.empty(4)
    for body_a, body_b in zip(_bodies(a), _bodies(b), strict=True):
        if _disjoint_on_screen(a.view, body_a, b.view, body_b):
            return Sight.FREE
        points_a, points_b = (shrunk(o.placement.points(body, pair), TOUCHING) for o, body in ((a, body_a), (b, body_b)))
        if separating_plane(points_a, points_b, plane):
            side = float(plane[:3] @ seen[:3] - plane[3] * seen[3])
            return Sight.BEFORE if side < 0.0 else Sight.BEHIND
    return Sight.TANGLED


def _bodies(placed: Placed) -> Iterator[Array]:
    """Points whose convex hull holds the mesh, normalised: fewer and looser first."""
    asset = placed.asset
    yield asset.corners
    yield asset.extreme_points if asset.hull is None else asset.hull["positions"]
    yield asset.extreme_points


def _are_free(a: Placed, b: Placed) -> bool:
    return _disjoint_on_screen(a.view, a.asset.extreme_points, b.view, b.asset.extreme_points)


def _disjoint_on_screen(view_a: View, a: Array, view_b: View, b: Array) -> bool:
    """Whether a line of the image separates the two; unknown, and so False, when one of them reaches to the eye plane."""
    clip_a, clip_b = project(view_a, a), project(view_b, b)
    if any(clip[:, 3].min() <= NEAR_EYE * clip[:, 3].max() for clip in (clip_a, clip_b)):
        return False
    flat_a, flat_b = (np.column_stack([to_pixels(view, clip), np.zeros(len(clip))]) for view, clip in ((view_a, clip_a), (view_b, clip_b)))
    both = np.concatenate([flat_a, flat_b])
    size = float(np.ptp(both, axis=0).max()) or 1.0
    middle = both.mean(axis=0)
    flat_a, flat_b = (flat_a - middle) / size, (flat_b - middle) / size
    return bool(separating_plane(flat_a, flat_b, np.empty(4)))


def _eye_in(eye: F8, source: Frame, target: Frame) -> F8:
    """A homogeneous eye of one frame of the scene in another."""
    if eye[3] == 0.0:
        return eye
    ratio = source.scale / target.scale
    shift = (np.asarray(source.centre) - np.asarray(target.centre)) / target.scale
    return np.append(eye[:3] * ratio + shift, 1.0)


def _closure(before: Bools) -> Bools:
    """What is before what by any number of steps, none included (Warshall)."""
    reach = before | np.eye(len(before), dtype=bool)
    for k in range(len(reach)):
        reach |= reach[:, k, None] & reach[None, k]
    return reach


def _connected(reach: Bools) -> Iterator[tuple[int, ...]]:
    """The classes of objects that must each come before the other, ascending."""
    mutual = reach & reach.T
    for i in range(len(reach)):
        members = np.flatnonzero(mutual[i])
        if members[0] == i:
            yield tuple(int(m) for m in members)
