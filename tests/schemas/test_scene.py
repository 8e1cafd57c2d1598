"""Transforms and defaults of scene requests."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from schemas.scene import MAX_OBJECTS, SceneRequest, matrix_of
from service.errors import invalid_fields

MESH = "0" * 32
ROW = [[1, 0, 0, 4], [0, 2, 0, 5], [0, 0, -3, 6], [0, 0, 0, 1]]


def first(transform):
    """The matrix of an object with this transform."""
    return matrix_of(SceneRequest(objects=[{"mesh": MESH, "transform": transform}]).objects[0].transform)


def test_a_matrix_is_rows_for_column_vectors():
    assert np.array_equal(first(ROW) @ [1, 1, 1, 1], [5, 7, 3, 1])


def test_no_transform_and_empty_parts_are_the_identity():
    assert np.array_equal(first({}), np.eye(4))
    assert np.array_equal(matrix_of(SceneRequest(objects=[{"mesh": MESH}]).objects[0].transform), np.eye(4))


def test_parts_scale_then_rotate_then_move():
    matrix = first({"translate": [10, 0, 0], "rotate": {"axis": [0, 0, 2], "angle_deg": 90}, "scale": [2, 3, -1]})
    assert np.allclose(matrix @ [1, 1, 1, 1], [10 - 3, 2, -1, 1])
    assert np.linalg.det(matrix) < 0


def test_one_scale_is_for_all_axes():
    assert np.allclose(first({"scale": 0.5}), np.diag([0.5, 0.5, 0.5, 1.0]))


@pytest.mark.parametrize("length", [1.0, 1e-200, 1e200])
def test_quaternion_and_axis_say_the_same_rotation_at_any_length(length):
    half = np.radians(70) / 2
    axis = np.array([1, -2, 0.5]) / np.linalg.norm([1, -2, 0.5])
    quaternion = (length * np.append(axis * np.sin(half), np.cos(half))).tolist()
    by_axis = first({"rotate": {"axis": (length * axis).tolist(), "angle_deg": 70 + 720}})
    assert np.allclose(first({"rotate": quaternion}), by_axis, atol=1e-12)
    assert np.allclose(by_axis[:3, :3] @ by_axis[:3, :3].T, np.eye(3))
    assert np.allclose(by_axis[:3, :3] @ axis, axis)


def test_an_objects_shading_has_the_scenes_for_what_it_does_not_say():
    request = SceneRequest(
        shading={"mode": "mask", "color": "#010203", "ambient": 0.5},
        objects=[{"mesh": MESH}, {"mesh": MESH, "shading": {"color": "#ff0000"}}, {"mesh": MESH, "shading": {"mode": "lambert"}}],
    )
    shades = [request.shading_of(i) for i in range(3)]
    assert [(s.mode, s.color, s.ambient) for s in shades] == [
        ("mask", "#010203", 0.5),
        ("mask", "#ff0000", 0.5),
        ("lambert", "#010203", 0.5),
    ]


STYLES = {"silhouette": {"width": 3.0, "color": "#010203"}, "ridge": {"opacity": 0.5}, "method": "fattened"}


def test_an_objects_lines_have_the_scenes_for_what_they_do_not_say():
    own = {"silhouette": {"color": "#ff0000"}, "ridge": None, "valley": {"width": 2.0}, "method": "wireframe"}
    request = SceneRequest(lines=STYLES, objects=[{"mesh": MESH}, {"mesh": MESH, "lines": own}, {"mesh": MESH, "lines": None}])
    scenes, objects, none = (request.lines_of(i) for i in range(3))
    assert scenes == request.lines
    assert (objects.method, objects.silhouette.width, objects.silhouette.color) == ("wireframe", 3.0, "#ff0000")
    assert (objects.ridge, objects.valley.width, objects.boundary) == (None, 2.0, request.lines.boundary)
    assert none is None


def test_lines_of_one_object_alone_are_as_they_say():
    request = SceneRequest(objects=[{"mesh": MESH}, {"mesh": MESH, "lines": {"ridge": {"width": 4.0}}}])
    assert request.lines_of(0) is None
    assert request.lines_of(1).ridge.width == 4.0


@pytest.mark.parametrize(
    ("lines", "of_objects", "expected"),
    [(None, [{}, {}], False), ({}, [{}, {}], True), ({}, [{"lines": None}, {"lines": None}], False), (None, [{}, {"lines": {}}], True)],
)
def test_a_scene_has_lines_when_one_of_its_objects_has(lines, of_objects, expected):
    assert SceneRequest(lines=lines, objects=[{"mesh": MESH} | one for one in of_objects]).has_lines == expected


def test_requests_that_are_drawn_differently_are_resolved_to_different_ones():
    """What an object does not say is not what it says as the default."""
    alike = [{}, {"lines": {}}, {"shading": {}}, {"lines": {"silhouette": {}}, "shading": {"color": "#010203"}}]
    others = [{"lines": None}, {"lines": {"silhouette": {"width": 1.5}}}, {"lines": {"silhouette": None}}, {"shading": {"ambient": 0.25}}]

    def dumped(one):
        shading = {"ambient": 0.5, "color": "#010203"}
        return SceneRequest(lines=STYLES, shading=shading, objects=[{"mesh": MESH} | one]).resolved().model_dump_json()

    assert len({dumped(one) for one in alike}) == 1
    assert len({dumped(one) for one in [{}, *others]}) == len(others) + 1


def changed(row, column, value):
    rows = [list(r) for r in ROW]
    rows[row][column] = value
    return rows


WRONG = [
    ({"objects": []}, "objects"),
    ({}, "objects"),
    ({"objects": [{"mesh": MESH}] * (MAX_OBJECTS + 1)}, "objects"),
    ({"objects": [{"mesh": MESH}, {}]}, "objects[1].mesh"),
    ({"objects": [{"mesh": MESH}, {"mesh": 3}]}, "objects[1].mesh"),
    ({"objects": [{"mesh": MESH, "color": 1}]}, "objects[0].color"),
    ({"objects": [{"mesh": MESH, "shading": {"color": "red"}}]}, "objects[0].shading.color"),
    ({"objects": [{"mesh": MESH, "transform": 3}]}, "objects[0].transform"),
    ({"objects": [{"mesh": MESH, "transform": [[1, 0, 0, 0]]}]}, "objects[0].transform"),
    ({"objects": [{"mesh": MESH, "transform": ROW[:3]}]}, "objects[0].transform"),
    ({"objects": [{"mesh": MESH, "transform": changed(1, 2, "x")}]}, "objects[0].transform[1][2]"),
    ({"objects": [{"mesh": MESH, "transform": changed(1, 2, float("inf"))}]}, "objects[0].transform[1][2]"),
    ({"objects": [{"mesh": MESH, "transform": changed(3, 0, 0.1)}]}, "objects[0].transform"),
    ({"objects": [{"mesh": MESH, "transform": changed(1, 1, 0.0)}]}, "objects[0].transform"),
    ({"objects": [{"mesh": MESH, "transform": changed(1, 1, 1e-7)}]}, "objects[0].transform"),
    ({"objects": [{"mesh": MESH, "transform": {"turn": 1}}]}, "objects[0].transform.turn"),
    ({"objects": [{"mesh": MESH, "transform": {"scale": 0}}]}, "objects[0].transform"),
    ({"objects": [{"mesh": MESH, "transform": {"scale": "big"}}]}, "objects[0].transform.scale"),
    ({"objects": [{"mesh": MESH, "transform": {"scale": [1, 2]}}]}, "objects[0].transform.scale"),
    ({"objects": [{"mesh": MESH, "transform": {"rotate": [0, 0, 0, 0]}}]}, "objects[0].transform"),
    ({"objects": [{"mesh": MESH, "transform": {"rotate": [0, 0, 1]}}]}, "objects[0].transform.rotate"),
    ({"objects": [{"mesh": MESH, "transform": {"rotate": {"axis": [0, 0, 0], "angle_deg": 1}}}]}, "objects[0].transform.rotate.axis"),
    ({"objects": [{"mesh": MESH, "transform": {"rotate": {"axis": [0, 0, 1]}}}]}, "objects[0].transform.rotate.angle_deg"),
    ({"objects": [{"mesh": MESH}], "camera": {"eye": [0, 0]}}, "camera.eye"),
]


@pytest.mark.parametrize(("body", "field"), WRONG)
def test_a_wrong_scene_is_refused_by_the_name_of_its_field(body, field):
    with pytest.raises(ValidationError) as caught:
        SceneRequest.model_validate(body)
    assert [fault["field"] for fault in invalid_fields(caught.value.errors())] == [field]


def test_the_example_of_the_reference_is_a_scene():
    SceneRequest.model_validate(SceneRequest.model_config["json_schema_extra"]["example"])
