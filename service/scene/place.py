"""Where an object stands in a scene, and the camera as its mesh sees it.

Not the mesh is moved but the eye: it is taken into the mesh's own normalised frame, where tree, hull, maps and exact predicates
live. Facing does not change under affine maps, so nothing but signs on the screen needs care: a mirroring placement turns
what is counter-clockwise there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from schemas.conventions import F8, Array, Frame
from schemas.errors import InvalidRequestError
from schemas.render import AnyCamera
from service.assets import MeshAsset
from service.camera import View, resolve_camera


@dataclass(frozen=True)
class Placement:
    """A mesh's normalised frame in the scene: `scene = frame.centre + frame.scale * linear @ normalised`.

    frame: scene units. linear: (3, 3) f8; its longest image of a unit vector has length one.
    """

    frame: Frame
    linear: F8

    @cached_property
    def moved_only(self) -> bool:
        """Whether the mesh is turned, stretched and mirrored in no way."""
        return np.array_equal(self.linear, np.eye(3))

    @cached_property
    def mirrored(self) -> bool:
        """Whether it turns counter-clockwise into clockwise."""
        return bool(np.linalg.det(self.linear) < 0.0)

    def within(self, frame: Frame) -> tuple[F8, F8]:
        """(linear (3, 3) f8, shift (3,) f8) from the mesh's normalised frame to another frame of the scene."""
        ratio = self.frame.scale / frame.scale
        return self.linear * ratio, (np.asarray(self.frame.centre) - np.asarray(frame.centre)) / frame.scale

    def points(self, normalised: Array, frame: Frame) -> F8:
        """(n, 3) points of the mesh's normalised frame -> (n, 3) f8 in a frame of the scene."""
        linear, shift = self.within(frame)
        return np.ascontiguousarray(np.asarray(normalised, np.float64) @ linear.T + shift)


def place(asset: MeshAsset, matrix: F8, field: str) -> Placement:
    """Where a mesh comes to stand by an affine matrix (4, 4) f8, scene from model units.

    Raises InvalidRequestError, naming `field`, when numbers overflow.
    """
    linear = matrix[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        centre = linear @ np.asarray(asset.frame.centre) + matrix[:3, 3]
        longest = 1.0 if np.array_equal(linear, np.eye(3)) else float(np.linalg.norm(linear, 2))
        scale = asset.frame.scale * longest
    if not (np.isfinite(centre).all() and 0.0 < scale < np.inf and 0.0 < longest < np.inf):
        raise InvalidRequestError(f"{field} is too extreme for this mesh", field=field)
    return Placement(Frame((float(centre[0]), float(centre[1]), float(centre[2])), scale), linear / longest)


def sphere_around(placements: Sequence[Placement]) -> Frame:
    """A sphere that holds the spheres of all, about the middle of their bounding box; of one its own."""
    first = np.asarray(placements[0].frame.centre)
    centres = np.array([p.frame.centre for p in placements]) - first  # to the first, so that one alone stays where it is
    radii = np.array([p.frame.scale for p in placements])
    middle = ((centres - radii[:, None]).min(axis=0) + (centres + radii[:, None]).max(axis=0)) / 2.0
    radius = float((np.linalg.norm(centres - middle, axis=1) + radii).max())
    x, y, z = (first + middle).tolist()
    return Frame((x, y, z), radius)


def view_of(placement: Placement, base: View, frame: Frame, around: Frame) -> View:
    """The camera as the mesh sees it, from `base`, which is resolved for another frame of the scene. around: a sphere about the scene."""
    linear, shift = placement.within(frame)
    if frame == placement.frame == around and placement.moved_only:
        return base
    matrix = base.matrix.copy()
    matrix[:, 3] += matrix[:, :3] @ shift
    matrix[:, :3] = matrix[:, :3] @ linear
    eye = np.linalg.solve(linear, base.eye[:3] - base.eye[3] * shift)
    if base.orthographic:
        eye /= np.linalg.norm(eye)
    normals = np.linalg.inv(placement.linear).T
    turned, moved = placement.within(around)
    middle = (np.asarray(around.centre) - np.asarray(frame.centre)) / frame.scale
    view = replace(
        base,
        eye=np.append(eye, base.eye[3]),
        matrix=matrix,
        pixel_scale=base.pixel_scale * placement.frame.scale / frame.scale,
        mirrored=placement.mirrored,
        normal_matrix=None if placement.moved_only else normals / np.abs(normals).max(),
        depth_unit=frame.scale / placement.frame.scale,
        nearness=np.append(base.view[2, :3] @ turned, base.view[2, :3] @ moved),
        middle_depth=float(base.matrix[3, :3] @ middle + base.matrix[3, 3]),
    )
    for array in (view.eye, view.matrix):
        array.setflags(write=False)
    return view


def own_view(asset: MeshAsset, placement: Placement, camera: AnyCamera, size: tuple[int, int], around: Frame) -> View:
    """The camera as a mesh sees it that is drawn alone. An orbit turns about `around`. Raises InvalidRequestError."""
    base = resolve_camera(camera, placement.frame, size[0], size[1], asset.radius, around)
    return view_of(placement, base, placement.frame, around)
