"""Shading that only original meshes have, of several objects in one picture."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.errors import InvalidRequestError
from schemas.scene import matrix_of
from service.scene.place import place, sphere_around
from tests.service.scene.lined import CAMERA, asked, differing, drawn, planned, shape
from tests.service.scene.made import small
from tests.service.scene.oracles import depths, rays
from tests.service.scene.test_scene_lines import HIDING
from tests.service.scene.test_stretch import STRETCHES, in_place

MODES = ("gooch", "flat", "depth", "matcap")
TURNED = {
    "turned": {"rotate": {"axis": [1, 2, 0], "angle_deg": 70}, "scale": 0.9},
    "turned and mirrored": {"rotate": {"axis": [0, 1, 1], "angle_deg": 130}, "scale": [0.9, -0.9, 0.9]},
}
FAR_APART = [("ball", {"translate": [-0.6, 0, 3.0], "scale": 0.6}), ("ball", {"translate": [1.0, 0.4, -3.0]})]


@pytest.mark.parametrize("lines", [None, {"silhouette": None, "boundary": None}], ids=["layers", "common depth"])
@pytest.mark.parametrize("objects", [*HIDING.values(), FAR_APART], ids=[*HIDING, "far apart"])
def test_depth_is_one_grey_for_one_distance_over_the_whole_scene(gpu, objects, lines):
    """Against rays: from 0.95 at the near end of the sphere around all objects to 0.05 at its far end."""
    more = {"camera": CAMERA | {"up": [0.0, 1.0, 0.0]}, "shading": {"mode": "depth"}, "lines": lines, "size": (48, 48)}
    request, image = asked(objects, **more), drawn(gpu, objects, accuracy={"antialias": "none", "source": "original"}, **more).pixels
    assets = [shape(mesh) for mesh, _ in objects]
    columns, rows = (a.ravel() + 0.5 for a in np.meshgrid(np.arange(48), np.arange(48)))
    origins, directions = rays(request, assets, columns, rows)
    nearest = depths(request, assets, origins, directions)[:, :, 0].min(axis=1)
    met = np.isfinite(nearest)
    around = sphere_around([place(a, matrix_of(o.transform), "") for a, o in zip(assets, request.objects, strict=True)])
    backward = np.asarray(request.camera.eye) / np.linalg.norm(request.camera.eye)
    points = origins[met] + nearest[met, None] * directions[met]
    expected = 255.0 * (0.5 + 0.45 * ((points - around.centre) @ backward) / around.scale)
    seen = image[rows[met].astype(int), columns[met].astype(int)]
    sure = (seen[:, 0] == seen[:, 1]) & (seen[:, 0] < 255)
    assert sure.sum() > 200
    assert np.ptp(expected) > 60
    assert np.quantile(np.abs(seen[sure, 0] - expected[sure]), 0.97) <= 1.0


@pytest.mark.parametrize("lines", [None, {"silhouette": {"width": 2}}], ids=["layers", "common depth"])
@pytest.mark.parametrize(
    ("mode", "name"),
    [*((mode, name) for mode in ("gooch", "flat", "matcap") for name in TURNED), *(("flat", name) for name in STRETCHES)],
)
def test_a_placed_object_is_shaded_as_a_mesh_of_that_shape(gpu, mode, name, lines):
    """Where it is stretched, by its faces: between vertices normals are not mixed before as they are after."""
    transform = (TURNED | STRETCHES)[name]
    other = ("ball", {"translate": [0.8, 0.6, -2.5], "scale": 0.5})
    more = {"shading": {"mode": mode, "color": "#c08040"}, "lines": lines, "accuracy": {"antialias": "ssaa"}}
    placed = drawn(gpu, [("corner", transform), other], **more).pixels
    made = drawn(gpu, [("corner", {}), other], [in_place("corner", transform, f"shaded {transform}"), shape("ball")], **more).pixels
    assert (placed != placed[0, 0]).any(axis=2).mean() > 0.05
    assert differing(placed, made, 6) < 0.01


@pytest.mark.parametrize("mode", MODES)
def test_objects_that_need_no_common_depth_keep_their_exact_outlines(gpu, mode):
    image = drawn(gpu, FAR_APART, shading={"mode": mode}, accuracy={"source": "original"}, background="transparent")
    plain = drawn(gpu, FAR_APART, accuracy={"source": "original"}, background="transparent")
    assert len(image.plan) == 2
    assert np.array_equal(image.pixels[:, :, 3], plain.pixels[:, :, 3])
    assert image.error_px == plain.error_px


@pytest.mark.parametrize("mode", MODES)
def test_a_clipped_hull_has_none_of_it_and_the_object_is_named(mode):
    with pytest.raises(InvalidRequestError, match="clipped hull") as caught:
        objects = [("ring", {}), ("ball", {"translate": [0, 0, -5]}, {"shading": {"mode": mode}})]
        planned(objects, [small("ring"), small("ball")], accuracy={"source": "clipped"})
    assert caught.value.where["field"] == "accuracy.source"
    assert caught.value.where["object"] == 1
