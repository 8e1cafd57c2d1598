"""What a user could take instead: other makers of enclosing hulls, other extractors of silhouettes.

All are optional (`make setup-bench` installs them). A rival that is absent raises AbsentRivalError with a word on it.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from benchmarks.models import AbsentError
from schemas.conventions import F4, F8, I4


class AbsentRivalError(AbsentError):
    """The package or program is not on this machine."""


class RivalHull(NamedTuple):
    """positions (v, 3) f8, faces (f, 3) i4, and the seconds of making it."""

    positions: F8
    faces: I4
    seconds: float


def package(name: str, wheel: str) -> Any:
    """A module of an optional package. Raises AbsentRivalError."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise AbsentRivalError(f"{wheel} is not installed") from error


def igl_hull(positions: F4, faces: I4, max_faces: int) -> RivalHull:
    """libigl's progressive hulls: section 3 of the paper as it stands."""
    igl = package("igl.copyleft", "libigl")
    vertices, triangles = np.asfortranarray(positions, np.float64), np.asfortranarray(faces, np.int32)
    start = time.perf_counter()
    made, triangles, _ = igl.progressive_hulls(vertices, triangles, max_faces)
    return RivalHull(np.ascontiguousarray(made), np.ascontiguousarray(triangles, np.int32), time.perf_counter() - start)


def nested_cage(positions: F4, faces: I4, max_faces: int, energy: str = "Volume") -> RivalHull:
    """Nested Cages (Sacht, Vouga, Jacobson 2015), quadrature order 1; energy: what re-inflating minimises, "None" is fast."""
    cages = package("nested_cages", "nested-cages")
    vertices, triangles = np.asfortranarray(positions, np.float64), np.asfortranarray(faces, np.int32)
    start = time.perf_counter()
    ((made, triangles),) = cages.nested_cages(vertices, triangles, [max_faces], 1, energy, "None")
    return RivalHull(np.ascontiguousarray(made), np.ascontiguousarray(triangles, np.int32), time.perf_counter() - start)


def simplified(positions: F4, faces: I4, max_faces: int) -> tuple[F4, I4]:
    """Quadric simplification with no regard to enclosure."""
    simplification = package("fast_simplification", "fast-simplification")
    made, triangles = simplification.simplify(positions, faces, target_count=max_faces)
    return np.ascontiguousarray(made, np.float32), np.ascontiguousarray(triangles, np.int32)


def numpy_extractor(positions: F4, faces: I4, edge_vertices: I4, edge_faces: I4) -> Callable[[F8], I4]:
    """Silhouettes in a few lines of numpy, on planes made once; float64, ties not exact."""
    a, b, c = (positions[faces[:, k]].astype(np.float64) for k in range(3))
    normals = np.cross(b - a, c - a)
    planes = np.column_stack([normals, -np.einsum("ij,ij->i", normals, a)])
    left, right = edge_faces.T

    def extract(eye: F8) -> I4:
        front = planes @ eye >= 0.0
        change = front[left] != front[right]
        edges, forward = edge_vertices[change], front[left[change]]
        return np.where(forward[:, None], edges, edges[:, ::-1])

    return extract


def vtk_extractor(positions: F4, faces: I4) -> Callable[[F8], int]:
    """VTK's vtkPolyDataSilhouette for a perspective eye; the call returns how many edges it found."""
    hybrid = package("vtkmodules.vtkFiltersHybrid", "vtk")
    model = package("vtkmodules.vtkCommonDataModel", "vtk")
    core = package("vtkmodules.vtkCommonCore", "vtk")
    support = package("vtkmodules.util.numpy_support", "vtk")
    points, cells, mesh = core.vtkPoints(), model.vtkCellArray(), model.vtkPolyData()
    points.SetData(support.numpy_to_vtk(positions, deep=True))
    cells.SetData(3, support.numpy_to_vtk(np.ascontiguousarray(faces, np.int64).ravel(), deep=True, array_type=core.VTK_ID_TYPE))
    mesh.SetPoints(points)
    mesh.SetPolys(cells)
    silhouette = hybrid.vtkPolyDataSilhouette()
    silhouette.SetInputData(mesh)
    silhouette.SetDirectionToSpecifiedOrigin()
    silhouette.SetEnableFeatureAngle(0)

    def extract(eye: F8) -> int:
        silhouette.SetOrigin(*eye[:3].tolist())
        silhouette.Update()
        return int(silhouette.GetOutput().GetNumberOfLines())

    return extract
