"""The silhouette of one view as arrays, which `service.silhouette.document` writes down."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from geometry.silhouettes import silhouette_scalar
from schemas.conventions import F4, F8, I4, Frame
from schemas.errors import CapabilityError, InvalidRequestError
from schemas.lines import LineKind
from schemas.mesh import Capability
from schemas.render import ProjectTo, SilhouetteRequest
from service.camera import View, resolve_camera
from service.kernels.clip import EYE_PLANE
from service.kernels.contours import compact
from service.silhouette.contours import Contours, link_contours
from service.silhouette.extract import SilhouetteTree
from service.silhouette.levels import LevelInView, SilhouetteLevel, choose_level
from service.silhouette.line_documents import drawn_widths
from service.silhouette.line_mesh import LineMesh
from service.silhouette.lines import VectorLines, vector_lines
from service.silhouette.outline import Outline, outline_of
from service.silhouette.project import pixel_matrix, project_edges, surrounding_layers
from service.silhouette.smooth import SmoothSurface, smooth_outline
from service.silhouette.strokes import stroked_lines

UNSEEN = ProjectTo()
"""Image of a request that names none: a fitted eye depends on its shape."""


class Source(Protocol):
    """What describing needs of a mesh; `service.assets.MeshAsset` has it."""

    @property
    def frame(self) -> Frame:
        """Its normalised frame."""

    @property
    def positions(self) -> F4:
        """(v, 3) f4 normalised."""

    @property
    def faces(self) -> I4:
        """(f, 3) i4."""

    @property
    def edges(self) -> tuple[I4, I4] | None:
        """(edge_vertices, edge_faces) of a closed mesh."""

    @property
    def tree(self) -> SilhouetteTree | None:
        """Its search tree."""

    @property
    def levels(self) -> Sequence[SilhouetteLevel]:
        """Hulls that may stand for it."""

    @property
    def corners(self) -> F8:
        """(8, 3) f8 of its bounding box."""

    @property
    def radius(self) -> float:
        """Of a sphere about the origin that holds it; 1 where it is as it was loaded, or more."""

    @property
    def smooth_surface(self) -> SmoothSurface:
        """The surface of a closed mesh's normals."""

    @property
    def line_mesh(self) -> LineMesh:
        """Its edges and faces, made ready for finding lines, whether it is closed or not."""

    @property
    def clip(self) -> Capability:
        """Says why there are no edges."""


@dataclass(frozen=True)
class Description:
    """The silhouette of one view.

    eye: (4,) f8 homogeneous, model units. edges: (s, 2) i4 directed. vertices: (k,) i4, those the edges use, each once.
    contours: closed loops of vertices, None when not asked for. positions: (k, 3) f8 of `vertices`, model units, or None.
    pixels: (k, 2) f8, y down, NaN behind the eye; outline: the contours in the image, curved when that was asked for; view: the
    camera; all None without an image, outline also where lines are asked for. faces: of the surface that all this is of; level: that
    one, None for the mesh. curves: the outline as curves, when they were asked for. lines: polylines in the image, when they were, drawn
    with line_widths, pixels. Of a mesh that is not closed, which has an answer only with lines, edges are those between two faces, and
    contours None.
    """

    eye: F8
    edges: I4
    vertices: I4
    contours: Contours | None
    positions: F8 | None
    pixels: F8 | None
    outline: Outline | None
    view: View | None
    faces: int
    level: LevelInView | None = None
    curves: list[F8] | None = None
    lines: VectorLines | None = None
    line_widths: Mapping[LineKind, float] = field(default_factory=dict)


def describe_silhouette(source: Source, request: SilhouetteRequest) -> Description:
    """The silhouette that `request` asks for, with all edges, hidden ones too.

    Raises CapabilityError when the mesh is not closed and no lines are asked for, or its faces cross too often for lines,
    InvalidRequestError for a camera whose numbers cannot be used, and for curves, lines and errors in pixels without an image to lie in.
    """
    _check(request)
    image = request.project or UNSEEN
    view = resolve_camera(request.camera, source.frame, image.width, image.height)
    level = None if request.max_error_px is None else choose_level(source.levels, view, source.corners, request.max_error_px)
    edges = _edges(source, view.eye, request.wants_lines) if level is None else level.level.tree.extract(view.eye).edges
    local, vertices = compact(edges)
    used = np.asarray(source.positions if level is None else level.level.positions)[vertices]
    loops = link_contours(local) if request.contours and _is_closed(source) else None
    homogeneous = _homogeneous(view, used) if request.project else None
    outline = None
    if request.smooth:
        outline = _smooth(source, view)
    elif homogeneous is not None and loops is not None and not request.wants_lines:
        # an eye that a level is chosen for is outside of it
        segments = project_edges(view, np.asarray(source.positions), edges) if level is None and _is_near(view, source.radius) else None
        outline = outline_of(view, homogeneous[loops.vertices], loops.offsets, _base(source, view, segments))
    return Description(
        eye=_model_eye(view.eye, source.frame),
        edges=edges,
        vertices=vertices,
        contours=None if loops is None else Contours(vertices[loops.vertices], loops.offsets),
        positions=source.frame.to_model(used) if request.positions else None,
        pixels=None if homogeneous is None else _divided(homogeneous),
        outline=outline,
        view=view if request.project else None,
        faces=len(source.faces if level is None else level.level.faces),
        level=level,
        curves=outline.curves() if request.smooth and outline is not None else None,
        lines=_lines(source, view, request) if request.wants_lines else None,
        line_widths=request.line_width,
    )


def _check(request: SilhouetteRequest) -> None:
    if request.smooth and request.project is None:
        raise InvalidRequestError("smooth contours are curves of an image: project must say its size", field="smooth")
    if request.max_error_px is not None and request.project is None:
        raise InvalidRequestError("an error in pixels is one in an image: project must say its size", field="max_error_px")
    if request.max_error_px is not None and request.smooth:
        raise InvalidRequestError("a smooth outline is meant to leave the mesh's, so no error can be asked of it", field="max_error_px")
    if request.wants_lines:
        _check_lines(request)
    elif request.stroke is not None:
        raise InvalidRequestError("a stroke is how lines look: kinds must say which", field="stroke")


def _check_lines(request: SilhouetteRequest) -> None:
    field = "visible_only" if request.kinds is None else "kinds"
    if request.project is None:
        raise InvalidRequestError("lines are hidden or not in an image: project must say its size", field=field)
    if request.smooth:
        raise InvalidRequestError("lines are those of the mesh, not of a smooth surface: smooth_px rounds their corners", field="smooth")
    if request.max_error_px is not None:
        raise InvalidRequestError("lines are those of the mesh itself: no coarser surface stands for it", field="max_error_px")


def _lines(source: Source, view: View, request: SilhouetteRequest) -> VectorLines:
    stroke = request.stroke
    if stroke is None:
        return vector_lines(source.line_mesh, view, request)
    return stroked_lines(source.line_mesh, view, request, stroke, drawn_widths(request.line_width), math.ceil(stroke.wobble_px))


def _is_closed(source: Source) -> bool:
    return source.tree is not None or source.edges is not None


def _edges(source: Source, eye: F8, of_any: bool) -> I4:
    if source.tree is not None:
        return source.tree.extract(eye).edges
    if source.edges is None and of_any:
        return source.line_mesh.silhouette(eye)
    if source.edges is None:
        raise CapabilityError(source.clip.reason or "only a closed mesh has a silhouette", field="mesh")
    return np.asarray(silhouette_scalar(source.positions, source.faces, *source.edges, eye))


def _smooth(source: Source, view: View) -> Outline:
    contours = source.smooth_surface.contours(view)
    segments = contours.segments(view) if _is_near(view, source.radius) else None
    return smooth_outline(view, contours, _base(source, view, segments))


def _is_near(view: View, radius: float) -> bool:
    """Whether there may be layers over the whole image that no edge tells of: never for an eye outside the sphere about all."""
    return not (view.orthographic or float(np.linalg.norm(view.eye[:3])) > radius + 1e-6)


def _base(source: Source, view: View, segments: F8 | None) -> int:
    """How many of them there are, from the outline's segments."""
    if segments is None:
        return 0
    return surrounding_layers(view, np.asarray(source.positions), np.asarray(source.faces), segments)


def _homogeneous(view: View, positions: F4) -> F8:
    """(k, 3) f8: u, v, w with u / w and v / w in pixels."""
    m = pixel_matrix(view)
    return np.asarray(positions.astype(np.float64) @ m[:, :3].T + m[:, 3])


def _divided(homogeneous: F8) -> F8:
    # at the eye plane the quotient is no place in the image, and may be no number
    w = np.where(homogeneous[:, 2:] >= EYE_PLANE, homogeneous[:, 2:], np.nan)
    return np.asarray(homogeneous[:, :2] / w)


def _model_eye(eye: F8, frame: Frame) -> F8:
    if not eye[3]:
        return eye
    with np.errstate(over="ignore"):
        place = frame.to_model(eye[:3])
    if not np.isfinite(place).all():
        raise InvalidRequestError("the eye is farther away than numbers go", field="camera")
    return np.append(place, 1.0)
