"""Requests name the field that is wrong."""

import pytest
from pydantic import TypeAdapter, ValidationError

from schemas.render import AnyCamera, Camera, OrbitCamera, RenderRequest, SilhouetteRequest


@pytest.mark.parametrize(
    ("camera", "word"),
    [
        ({"eye": [1, 2, 3], "target": [1, 2, 3]}, "eye and target"),
        ({"eye": [1, 2, 3], "up": [0, 0, 0]}, "up is the zero"),
        ({"eye": [0, 3, 0]}, "parallel"),
        ({"eye": [0, 0, 3], "fov_y_deg": 0}, "fov_y_deg"),
        ({"eye": [0, 0, 3], "fov_y_deg": 180}, "fov_y_deg"),
        ({"eye": [0, 0, float("nan")]}, "eye"),
        ({"eye": [0, 0, 1e308], "target": [0, 0, -1e308]}, "too far"),
        ({"eye": [0, 0]}, "eye"),
        ({"eye": [0, 0, 3], "projection": "orthographic"}, "height"),
        ({"eye": [0, 0, 3], "projection": "orthographic", "height": 0}, "height"),
        ({"eye": [0, 0, 3], "zoom": 2}, "zoom"),
    ],
)
def test_unusable_cameras_are_refused_with_the_reason(camera, word):
    with pytest.raises(ValidationError, match=word):
        Camera.model_validate(camera)


@pytest.mark.parametrize("field", ["width", "height"])
@pytest.mark.parametrize("size", [0, -1, 100_000, 1.5])
def test_image_sizes_out_of_range_name_their_field(field, size):
    with pytest.raises(ValidationError, match=field):
        RenderRequest.model_validate({field: size})


def test_both_camera_forms_are_told_apart():
    camera = TypeAdapter(AnyCamera)
    assert isinstance(camera.validate_python({"eye": [0, 0, 3]}), Camera)
    assert isinstance(camera.validate_python({"orbit": {"azimuth_deg": 10}}), OrbitCamera)


def test_every_field_of_the_requests_has_a_default():
    assert RenderRequest().width == 512
    assert SilhouetteRequest().contours
