"""Other ways to get thumbnails on a server: libraries that draw off screen. Each is given the mesh once and then asked for views.

All are optional. A rival that is absent raises AbsentRivalError. Pictures are encoded by the service's own encoder, faster than what
any of them brings.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rivals import AbsentRivalError, package
from schemas.mesh import PreprocessOptions
from schemas.render import ImageFormat
from service.measure.views import spread_view
from service.render.encode import encode
from worker.load import LoadedMesh, load_mesh

VIEWS = 40
WARM_UP = 5
FIELD_DEG = 45.0
DISTANCE = 2.7
"""Radii of the mesh's sphere: about where an orbit fits it."""

Draw = Callable[[np.ndarray], np.ndarray]
"""Pixels (h, w, 4) u1 of the mesh from an eye (3,)."""


def eyes(views: int) -> list[np.ndarray]:
    """Where views are from, spread over a sphere."""
    found = []
    for number in range(views):
        orbit = spread_view(number, views).orbit
        turn, rise = np.radians([orbit.azimuth_deg, orbit.elevation_deg])
        found.append(DISTANCE * np.array([np.cos(rise) * np.sin(turn), np.sin(rise), np.cos(rise) * np.cos(turn)]))
    return found


def vtk_drawer(mesh: LoadedMesh, side: int, samples: int) -> Draw:
    """VTK, off screen: vtkRenderWindow with so many samples a pixel, read back as RGBA."""
    package("vtkmodules.vtkRenderingOpenGL2", "vtk")
    package("vtkmodules.vtkRenderingUI", "vtk")
    rendering, core = package("vtkmodules.vtkRenderingCore", "vtk"), package("vtkmodules.vtkCommonCore", "vtk")
    model, support = package("vtkmodules.vtkCommonDataModel", "vtk"), package("vtkmodules.util.numpy_support", "vtk")
    shape, points, cells = model.vtkPolyData(), core.vtkPoints(), model.vtkCellArray()
    points.SetData(support.numpy_to_vtk(mesh.positions, deep=True))
    cells.SetData(3, support.numpy_to_vtk(np.ascontiguousarray(mesh.faces, np.int64).ravel(), deep=True, array_type=core.VTK_ID_TYPE))
    shape.SetPoints(points)
    shape.SetPolys(cells)
    mapper, actor, scene, window = (
        rendering.vtkPolyDataMapper(),
        rendering.vtkActor(),
        rendering.vtkRenderer(),
        rendering.vtkRenderWindow(),
    )
    mapper.SetInputData(shape)
    actor.SetMapper(mapper)
    scene.AddActor(actor)
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(samples)
    window.SetAlphaBitPlanes(1)
    window.SetSize(side, side)
    window.AddRenderer(scene)
    scene.SetBackgroundAlpha(0.0)
    scene.GetActiveCamera().SetViewAngle(FIELD_DEG)

    def draw(eye: np.ndarray) -> np.ndarray:
        camera = scene.GetActiveCamera()
        camera.SetPosition(*eye)
        camera.SetFocalPoint(0.0, 0.0, 0.0)
        camera.SetViewUp(0.0, 1.0, 0.0)
        scene.ResetCameraClippingRange()
        window.Render()
        pixels = core.vtkUnsignedCharArray()
        window.GetRGBACharPixelData(0, 0, side - 1, side - 1, 1, pixels)
        return np.ascontiguousarray(support.vtk_to_numpy(pixels).reshape(side, side, 4)[::-1])

    return draw


def pyrender_drawer(mesh: LoadedMesh, side: int, samples: int) -> Draw:
    """pyrender's OffscreenRenderer, which always takes 4 samples."""
    if samples != 4:
        raise AbsentRivalError("pyrender draws with 4 samples only")
    pyrender, trimesh = package("pyrender", "pyrender"), package("trimesh", "trimesh")
    scene = pyrender.Scene(bg_color=[0.0, 0.0, 0.0, 0.0], ambient_light=[0.3, 0.3, 0.3])
    scene.add(pyrender.Mesh.from_trimesh(trimesh.Trimesh(mesh.positions, mesh.faces, process=False)))
    camera = scene.add(pyrender.PerspectiveCamera(yfov=np.radians(FIELD_DEG)), pose=np.eye(4))
    light = scene.add(pyrender.DirectionalLight(intensity=3.0), pose=np.eye(4))
    renderer = pyrender.OffscreenRenderer(side, side)

    def draw(eye: np.ndarray) -> np.ndarray:
        back = eye / np.linalg.norm(eye)
        right = np.cross([0.0, 1.0, 0.0], back)
        pose = np.eye(4)
        pose[:3, 0] = right / np.linalg.norm(right)
        pose[:3, 1], pose[:3, 2], pose[:3, 3] = np.cross(back, pose[:3, 0]), back, eye
        scene.set_pose(camera, pose)
        scene.set_pose(light, pose)
        color, _ = renderer.render(scene, flags=pyrender.RenderFlags.RGBA)
        return np.ascontiguousarray(color)

    return draw


RIVALS: dict[str, tuple[Callable[[LoadedMesh, int, int], Draw], int]] = {
    "VTK, no antialiasing": (vtk_drawer, 0),
    "VTK, 4 samples": (vtk_drawer, 4),
    "pyrender, 4 samples": (pyrender_drawer, 4),
}
"""By name: what makes the drawer, and samples a pixel."""


def rival_pictures(name: str, path: Path, side: int) -> dict[str, Any]:
    """Encoded pictures a second, and a second of processor time, of one rival in this process. Raises AbsentRivalError."""
    mesh = load_mesh(path, path.suffix, PreprocessOptions())
    make, samples = RIVALS[name]
    draw = make(mesh, side, samples)
    places = eyes(VIEWS)
    for eye in places[:WARM_UP]:
        if not draw(eye)[..., 3].any():
            raise RuntimeError(f"{name} draws nothing")
    wall, processor = time.perf_counter(), time.process_time()
    for eye in places:
        encode(draw(eye), ImageFormat.PNG)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    return {"per_second": round(VIEWS / wall, 1), "per_core_second": round(VIEWS / processor, 1)}
