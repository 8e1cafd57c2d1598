"""Accept headers, entity tags, and flat query parameters."""

import pytest
from starlette.exceptions import HTTPException

from schemas.errors import InvalidRequestError
from schemas.render import Camera, ImageFormat, OrbitCamera
from service.errors import problem_of
from service.negotiation import choose, image_format
from service.view_query import RenderQuery, SilhouetteQuery, query_names

BROWSER_IMAGE = "image/avif,image/webp,image/apng,image/svg+xml,image/*,*/*;q=0.8"


@pytest.mark.parametrize(
    ("accept", "wanted"),
    [
        (None, ImageFormat.PNG),
        ("*/*", ImageFormat.PNG),
        ("image/*", ImageFormat.PNG),
        ("image/webp", ImageFormat.WEBP),
        ("image/jpeg, image/png;q=0.5", ImageFormat.JPEG),
        ("image/png;q=0.1, image/*;q=0.9", ImageFormat.WEBP),
        ("application/octet-stream", ImageFormat.RAW),
        ("IMAGE/JPEG ; Q=1.0", ImageFormat.JPEG),
        (BROWSER_IMAGE, ImageFormat.PNG),
    ],
)
def test_accept_header_chooses_the_encoding(accept, wanted):
    assert image_format(accept) is wanted


@pytest.mark.parametrize("accept", ["text/html", "image/png;q=0", "image/avif", "image/png;q=x"])
def test_accept_header_that_nothing_meets_is_406(accept):
    with pytest.raises(HTTPException) as refused:
        image_format(accept)
    assert refused.value.status_code == 406


def test_most_specific_range_counts():
    assert choose("*/*;q=0.1, application/json;q=0", ["application/json", "image/svg+xml"]) == "image/svg+xml"


def test_query_without_eye_is_an_orbit():
    request = RenderQuery(azimuth=40.0, distance="2.5", background="ffffff").request(ImageFormat.PNG)
    assert isinstance(request.camera, OrbitCamera)
    assert (request.camera.orbit.azimuth_deg, request.camera.orbit.distance, request.background) == (40.0, 2.5, "#ffffff")


def test_query_with_eye_is_a_place():
    request = SilhouetteQuery(eye="0,0,3", target="0,1,0", projection="orthographic", height_units=2.0).request()
    assert isinstance(request.camera, Camera)
    assert (request.camera.eye, request.camera.target, request.camera.height) == ([0.0, 0.0, 3.0], [0.0, 1.0, 0.0], 2.0)


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ({"eye": "0,0,0"}, "eye"),
        ({"eye": "0,0"}, "eye"),
        ({"eye": "0,0,x"}, "eye"),
        ({"eye": "nan,0,0"}, "eye"),
        ({"eye": "0,0,3", "up": "0,0,0"}, "up"),
        ({"eye": "0,0,3", "up": "0,0,1"}, "up"),
        ({"eye": "0,0,3", "projection": "orthographic"}, "height_units"),
        ({"eye": "0,0,3", "azimuth": 3.0}, "azimuth"),
        ({"target": "0,0,0"}, "target"),
        ({"fov": 0.0}, "fov"),
        ({"fov": 180.0}, "fov"),
        ({"eye": "0,0,3", "fov": 180.0}, "fov"),
        ({"elevation": 91.0}, "elevation"),
        ({"distance": "0"}, "distance"),
        ({"distance": "far"}, "distance"),
        ({"width": 0}, "width"),
        ({"height": 100_000}, "height"),
        ({"color": "red"}, "color"),
        ({"background": "12345"}, "background"),
        ({"ambient": 2.0}, "ambient"),
        ({"light": "1,2"}, "light"),
    ],
)
def test_wrong_query_parameter_is_named_as_it_was_given(query, field):
    with pytest.raises(InvalidRequestError) as refused, query_names():
        RenderQuery(**query).request(ImageFormat.PNG)
    problem = problem_of(refused.value)
    assert problem.status == 422
    assert [item["field"] for item in problem.model_extra["errors"]] == [field]


def test_faults_found_later_are_named_as_query_parameters_too():
    with pytest.raises(InvalidRequestError) as refused, query_names():
        raise InvalidRequestError("camera.orbit.distance is too extreme for this mesh", field="camera.orbit.distance")
    assert refused.value.where["field"] == "distance"
    assert refused.value.message == "distance is too extreme for this mesh"
