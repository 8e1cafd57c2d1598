import json
import re
import xml.etree.ElementTree as ElementTree
from types import SimpleNamespace

import numpy as np
import pytest
from safetensors.numpy import load

from geometry.topology import build_edges
from schemas.errors import CapabilityError, InvalidRequestError
from schemas.mesh import Capability
from schemas.render import Camera, Orbit, OrbitCamera, ProjectTo, Silhouette, SilhouetteRequest
from service.camera import project, resolve_camera, to_pixels
from service.silhouette.coverage import coverage_mask
from service.silhouette.document import describe_silhouette, silhouette_binary, silhouette_json, silhouette_svg
from tests import meshes
from tests.service.oracles import covered_by_rays, silhouette


def source(mesh, scale=1.0, closed=True):
    positions, faces, frame = meshes.normalised((mesh[0] * scale, mesh[1]))
    table = build_edges(faces)
    reason = None if closed else "it has holes"
    return SimpleNamespace(
        frame=frame,
        positions=positions,
        faces=faces,
        edges=(table.vertices, table.faces) if closed else None,
        tree=None,
        radius=1.0,
        clip=Capability(available=closed, reason=reason),
    )


BUMPY = source(meshes.bumpy_sphere(3), scale=5.0)
ASKED = SilhouetteRequest(camera=OrbitCamera(orbit=Orbit(azimuth_deg=25.0)), project=ProjectTo(width=40, height=30))
SVG = "{http://www.w3.org/2000/svg}"


def drawn_polygons(svg):
    """The polygons of the one path, (n, 2) each."""
    root = ElementTree.fromstring(svg)
    (path,) = root.iter(SVG + "path")
    loops = re.findall(r"M([^MZ]*)Z", path.attrib["d"])
    assert sum(map(len, loops)) + 2 * len(loops) == len(path.attrib["d"])
    return [np.array([p.split(",") for p in loop.split(" ")], float) for loop in loops]


def mask_of(polygons, width, height):
    segments = [np.column_stack([p, np.roll(p, -1, axis=0)]) for p in polygons]
    return coverage_mask(np.concatenate(segments) if segments else np.empty((0, 4)), width, height).mask / 255.0


def test_json_is_the_documented_answer():
    described = describe_silhouette(BUMPY, ASKED)
    answer = json.loads(silhouette_json(described))
    model = Silhouette.model_validate(answer)
    view = resolve_camera(ASKED.camera, BUMPY.frame, 40, 30)
    expected = silhouette(BUMPY.positions, BUMPY.faces, view.eye)
    assert sorted(model.edges) == sorted(tuple(e) for e in expected.tolist())
    assert model.edge_count == len(expected)
    assert np.allclose(model.eye, np.append(BUMPY.frame.to_model(view.eye[:3]), 1.0))
    index = model.vertices["index"]
    assert len(set(index)) == len(index)
    assert set(index) == set(expected.ravel().tolist())
    assert np.allclose(model.vertices["position"], BUMPY.frame.to_model(BUMPY.positions[index]), rtol=0, atol=1e-12)
    assert np.allclose(model.vertices["pixel"], to_pixels(view, project(view, BUMPY.positions[index])), atol=1e-4)


def test_contours_of_the_json_run_along_its_edges():
    answer = json.loads(silhouette_json(describe_silhouette(BUMPY, ASKED)))
    around = [[a, b] for loop in answer["contours"] for a, b in zip(loop, loop[1:] + loop[:1], strict=True)]
    assert sorted(around) == sorted(answer["edges"])


def test_what_is_not_asked_for_is_left_out():
    bare = describe_silhouette(BUMPY, SilhouetteRequest(contours=False, positions=False))
    answer = json.loads(silhouette_json(bare))
    assert sorted(answer) == ["edge_count", "edges", "eye", "surface", "vertices"]
    assert answer["vertices"] == {}
    assert sorted(load(silhouette_binary(bare))) == ["edges", "vertices"]


def test_orthographic_eye_is_a_direction():
    camera = Camera(eye=[0, 0, 9], projection="orthographic", height=12.0)
    answer = json.loads(silhouette_json(describe_silhouette(BUMPY, SilhouetteRequest(camera=camera))))
    assert answer["eye"] == [0.0, 0.0, 1.0, 0.0]


def test_binary_holds_the_same_as_json():
    described = describe_silhouette(BUMPY, ASKED)
    answer, tensors = json.loads(silhouette_json(described)), load(silhouette_binary(described))
    assert tensors["edges"].tolist() == answer["edges"]
    assert tensors["vertices"].tolist() == answer["vertices"]["index"]
    assert tensors["positions"].tolist() == answer["vertices"]["position"]
    assert np.allclose(tensors["pixels"], answer["vertices"]["pixel"], atol=1e-4)
    loops = np.split(tensors["contours"], tensors["offsets"][1:-1])
    assert [loop.tolist() for loop in loops] == answer["contours"]
    assert {n: t.dtype for n, t in tensors.items()} == {
        **dict.fromkeys(["edges", "vertices", "contours", "offsets"], np.dtype("<i4")),
        **dict.fromkeys(["positions", "pixels"], np.dtype("<f8")),
    }


def test_pixels_behind_the_eye_are_null():
    mesh = source(meshes.torus())
    camera = Camera(eye=[1.0, 0.0, 0.6], target=[0.0, 1.0, 0.0])
    described = describe_silhouette(mesh, SilhouetteRequest(camera=camera, project=ProjectTo(width=20, height=20)))
    answer = json.loads(silhouette_json(described))
    pixels = answer["vertices"]["pixel"]
    assert [None, None] in pixels
    assert any(None not in p for p in pixels)


def test_drawing_fills_what_the_mesh_covers():
    described = describe_silhouette(BUMPY, ASKED)
    polygons = drawn_polygons(silhouette_svg(described))
    assert len(polygons) == len(described.contours)
    view = resolve_camera(ASKED.camera, BUMPY.frame, 40, 30)
    truth = covered_by_rays(view, BUMPY.positions, BUMPY.faces, 10)
    assert np.abs(mask_of(polygons, 40, 30) - truth).max() <= 0.15


@pytest.mark.parametrize(
    ("eye", "target"),
    [
        ((1.0, 0.0, 0.6), (0.0, 1.0, 0.0)),  # over the ring, most of it behind
        ((0.0, 0.0, 0.0), (1.0, 0.2, 0.1)),  # in the hole, half of it behind
        ((0.55, 0.0, 0.0), (1.0, 0.0, 0.0)),  # in the hole, before the wall: nothing but surface
        ((0.0, 0.0, 4.0), (0.0, 0.0, 9.0)),  # all of it behind
        ((0.0, 0.0, 4.0), (0.0, 1.3, 0.0)),  # partly beside the image
        ((1.36, 0.0, 0.0), (1.36, 1.0, 0.0)),  # along the outside, very close
    ],
)
def test_drawing_is_right_with_parts_behind_the_eye(eye, target):
    mesh = source(meshes.torus(20, 10))
    request = SilhouetteRequest(
        camera=Camera(eye=list(eye), target=list(target), up=[0.0, 0.1, 1.0], fov_y_deg=60.0), project=ProjectTo(width=24, height=24)
    )
    polygons = drawn_polygons(silhouette_svg(describe_silhouette(mesh, request)))
    view = resolve_camera(request.camera, mesh.frame, 24, 24)
    truth = covered_by_rays(view, mesh.positions, mesh.faces, 10)
    assert np.abs(mask_of(polygons, 24, 24) - truth).max() <= 0.2
    if polygons:
        assert np.abs(np.concatenate(polygons)).max() <= 24 + 24 + 64 + 1


def test_drawing_is_a_picture_that_says_what_it_is():
    root = ElementTree.fromstring(silhouette_svg(describe_silhouette(BUMPY, ASKED)))
    assert root.attrib["viewBox"] == "0 0 40 30"
    assert (root.attrib["width"], root.attrib["height"]) == ("40", "30")
    assert root.find(SVG + "title").text == "Silhouette"
    assert "silhouette edges" in root.find(SVG + "desc").text
    (group,) = [g for g in root.iter(SVG + "g") if "fill-rule" in g.attrib]
    assert group.attrib["fill-rule"] == "nonzero"
    (used,) = root.iter(SVG + "use")
    assert used.attrib["href"] == "#" + next(root.iter(SVG + "path")).attrib["id"]


def test_drawing_without_an_image_is_refused():
    for request in (SilhouetteRequest(), SilhouetteRequest(contours=False, project=ProjectTo())):
        with pytest.raises(InvalidRequestError) as caught:
            silhouette_svg(describe_silhouette(BUMPY, request))
        assert caught.value.where["field"] == "project"


def test_a_mesh_that_is_not_closed_has_no_silhouette_and_says_why():
    with pytest.raises(CapabilityError, match="it has holes"):
        describe_silhouette(source(meshes.sphere(1), closed=False), ASKED)


def test_a_view_without_silhouette_makes_empty_documents():
    """From inside a sphere no face is front-facing."""
    inside = Camera(eye=[0.1, 0.0, 0.0], target=[1.0, 0.0, 0.0])
    described = describe_silhouette(source(meshes.sphere(2)), SilhouetteRequest(camera=inside, project=ProjectTo(width=9, height=9)))
    answer = json.loads(silhouette_json(described))
    assert (answer["edge_count"], answer["edges"], answer["contours"]) == (0, [], [])
    assert load(silhouette_binary(described))["edges"].shape == (0, 2)
    assert drawn_polygons(silhouette_svg(described)) == []
