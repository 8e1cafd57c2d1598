"""After warming a request has nothing to compile: a kernel that is left costs somebody ten seconds of a first picture."""

import importlib
import json
import pkgutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from numba.core.dispatcher import Dispatcher

from client.local import LocalService
from schemas.lines import LineKind
from schemas.render import Accuracy, Antialias, ProjectTo, RenderRequest, SilhouetteRequest, Source
from schemas.scene import SceneRequest
from service import kernels
from service.assets import MeshAsset
from service.render.renderer import Renderer
from service.scene.draw import drawing_of
from service.scene.plan import plan_scene
from service.silhouette.describe import describe_silhouette
from service.silhouette.document import silhouette_dxf, silhouette_json, silhouette_svg
from service.warm import warm
from tests.service.observing.test_observed_service import lines
from tests.worker.processing import wait_for

ROOT = Path(__file__).resolve().parents[2]
CAMERAS = (
    {"orbit": {"azimuth_deg": 30.0, "elevation_deg": 20.0}},
    {"eye": [0.1, 0.2, 4.0], "projection": "orthographic", "height": 2.6},
    {"eye": [1.1, 1.1, 0.0], "target": [0.8, 0.8, 9.0], "fov_y_deg": 120.0},
)
INSIDE = {"eye": [0.0, 0.01, 0.02]}


def test_no_kernel_is_compiled_after_warming():
    run = subprocess.run([sys.executable, "-m", __name__], cwd=ROOT, capture_output=True, text=True, timeout=250, check=True)
    assert json.loads(run.stdout.splitlines()[-1]) == []


def said(running: LocalService) -> set[str]:
    """Messages in the log of a service."""
    return {line["message"] for line in lines(running)}


def test_a_service_warms_its_renderer_unless_told_not_to(service, tmp_path):
    with LocalService(tmp_path, {"SILHOUETTE_WARM_RENDERER": "true"}, ("--workers", "0")) as running:
        wait_for(lambda: "warmed" in said(running))
    assert "warmed" not in said(service)


def forms() -> Iterator[str]:
    """Every compiled form of every kernel of the service, in this process."""
    for found in pkgutil.iter_modules(kernels.__path__):
        for name, kernel in vars(importlib.import_module(f"{kernels.__name__}.{found.name}")).items():
            if isinstance(kernel, Dispatcher):
                yield from (f"{found.name}.{name}{signature}" for signature in kernel.signatures)


def ask_for_lines(renderer: Renderer, asset: MeshAsset) -> None:
    """By every method, on the closed mesh and on what is left of it without its edges."""
    kinds = {"ridge": {}, "valley": {}, "ridge_deg": 5.0, "valley_deg": 5.0}
    for method in ("wireframe", "translated", "fattened"):
        for orientation in ("trusted", "any"):
            for one in (asset, replace(asset, id="open", edges=None, hull=None, maps=None, tree=None)):
                lines = {"method": method, "orientation": orientation, "charcoal": method == "fattened", **kinds}
                for camera in CAMERAS:
                    renderer.submit(one, RenderRequest(camera=camera, lines=lines)).result()


def ask_for_strokes(renderer: Renderer, asset: MeshAsset) -> None:
    """In pictures and drawings, with all that strokes have and with nothing."""
    full = {"width_by": "depth", "opacity_by": "angle", "dash": [5.0, 3.0], "wobble_px": 3.0}
    for stroke in ({}, {"opacity_by": "curvature"}, {"width_by": "curvature", "wobble_px": 2.0}, full):
        for camera in CAMERAS:
            renderer.submit(asset, RenderRequest(camera=camera, lines={"method": "strokes", "stroke": stroke})).result()
            wanted = SilhouetteRequest(camera=camera, project=ProjectTo(), kinds=list(LineKind), stroke=stroke)
            for write in (silhouette_svg, silhouette_dxf, silhouette_json):
                write(describe_silhouette(asset, wanted))


def ask_for_everything(renderer: Renderer) -> None:
    """Pictures and silhouettes of a real asset, from far, near and within."""
    from tests.service.render.made import clippable

    asset = clippable("joined")
    for array in (asset.positions, asset.faces, asset.normals, *(asset.edges or ()), *(asset.hull or {}).values()):
        array.flags.writeable = False  # as arrays of a file are: to numba another type
    ask_for_lines(renderer, asset)
    ask_for_strokes(renderer, asset)
    for camera in CAMERAS:
        for side in (8, 256):
            for antialias in (Antialias.COVERAGE, Antialias.LINE, Antialias.NONE):
                accuracy = Accuracy(source=Source.CLIPPED, antialias=antialias)
                renderer.submit(asset, RenderRequest(camera=camera, width=side, height=side, accuracy=accuracy)).result()
            accuracy = Accuracy(source=Source.CLIPPED, smooth=True)
            renderer.submit(asset, RenderRequest(camera=camera, width=side, height=side, accuracy=accuracy)).result()
    for camera in CAMERAS:
        for size in ((8, 8), (256, 130)):
            for shift in (0.0, 1.0, 3.0):
                other = {"mesh": "joined", "transform": {"translate": [0.3, shift, -shift], "scale": [1, -2, 1]}}
                scene = SceneRequest(camera=camera, width=size[0], height=size[1], objects=[{"mesh": "joined"}, other])
                renderer.submit_drawing(drawing_of(plan_scene(scene, [asset, asset]))).result()
    for camera in (*CAMERAS, INSIDE):
        for smooth in (False, True):
            describe_silhouette(asset, SilhouetteRequest(camera=camera, project=ProjectTo(), smooth=smooth))
        for more in ({}, {"simplify_px": 1.0}, {"smooth_px": 1.0}):
            describe_silhouette(asset, SilhouetteRequest(camera=camera, project=ProjectTo(), kinds=list(LineKind), **more))


if __name__ == "__main__":
    renderer = Renderer()
    renderer.start()
    warm(renderer)
    before = set(forms())
    ask_for_everything(renderer)
    print(json.dumps(sorted(set(forms()) - before)))
    renderer.close()
