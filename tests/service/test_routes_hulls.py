"""Hulls of other sizes over real HTTP: what comes encloses the mesh, or is enclosed by it; what cannot be had is said."""

import io

import numpy as np
import pytest
import trimesh

from client.errors import RequestError
from tests import meshes, plain_http
from worker.enclosure import enclosure_fault


@pytest.fixture(scope="module")
def http(service):
    with plain_http.Client(base_url=service.url, timeout=60.0) as connection:
        yield connection


def hull(http, mesh, **query):
    return http.get(f"/v1/meshes/{mesh.id}/artifacts/hull.glb", params=query)


def surface(answer):
    """(positions, faces) in model units."""
    mesh = trimesh.load(io.BytesIO(answer.content), file_type="glb", process=False).to_geometry()
    return np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)


def told(answer):
    return dict(item.split("=") for item in answer.headers["x-hull"].split("; "))


@pytest.mark.parametrize("faces", [150, 501, 2000, 5120])
@pytest.mark.parametrize("side", ["outer", "inner"])
def test_hulls_of_any_size_enclose_the_mesh_or_are_enclosed_by_it(http, knot, faces, side):
    answer = hull(http, knot, faces=faces, side=side)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "model/gltf-binary")
    positions, triangles = surface(answer)
    assert faces - 1 <= len(triangles) <= faces
    assert (told(answer)["side"], int(told(answer)["faces"])) == (side, len(triangles))
    excess = float(told(answer)["volume_excess"])
    assert excess == 0.0 if faces == 5120 else (excess > 0.0) == (side == "outer")
    centre, radius = np.array(knot.sphere.centre), knot.sphere.radius
    found = np.float32((positions - centre) / radius), triangles
    original, corners = meshes.knot()
    original = np.float32((original.astype(np.float32) - centre) / radius), corners
    inside, outside = (original, found) if side == "outer" else (found, original)
    volumes = [trimesh.Trimesh(p, f, process=False).volume for p, f in (inside, outside)]
    assert volumes[0] <= volumes[1] * (1.0 + 1e-6)
    grown = outside[0] + 3e-7 * trimesh.Trimesh(*outside, process=False).vertex_normals.astype(np.float32)  # for the ways through files
    assert enclosure_fault(*inside, np.float32(grown), outside[1]) >= 0


def test_without_faces_a_hull_is_as_large_as_the_drawn_one(http, knot):
    assert len(surface(hull(http, knot, side="inner"))[1]) <= knot.hull.faces
    assert int(told(hull(http, knot, side="outer"))["faces"]) == knot.hull.faces


def test_without_parameters_the_hull_has_its_maps(http, knot):
    answer = hull(http, knot)
    assert b"normalTexture" in answer.content
    assert "x-hull" not in answer.headers


def test_too_few_faces_are_refused_with_the_fewest_there_can_be(http, knot):
    answer = hull(http, knot, faces=4)
    assert answer.status_code == 422
    problem = answer.json()
    assert problem["errors"][0]["field"] == "faces"
    assert str(problem["fewest"]) in problem["detail"]
    assert hull(http, knot, faces=problem["fewest"]).status_code == 200
    assert hull(http, knot, faces=problem["fewest"] - 1).status_code == 422


def test_more_faces_than_the_mesh_has_are_refused(http, knot):
    answer = hull(http, knot, faces=5121)
    assert (answer.status_code, answer.json()["most"]) == (422, 5120)


@pytest.mark.parametrize(("query", "field"), [({"faces": 3}, "faces"), ({"faces": "many"}, "faces"), ({"side": "left"}, "side")])
def test_values_that_mean_nothing_are_named(http, knot, query, field):
    answer = hull(http, knot, **query)
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, field)


def test_only_the_hull_has_sizes(http, knot):
    assert http.get(f"/v1/meshes/{knot.id}/artifacts/normal.png", params={"faces": 100}).status_code == 422


def test_each_hull_has_a_tag_of_its_own_and_is_answered_304(http, knot):
    queries = [{}, {"faces": 300}, {"faces": 302}, {"faces": 300, "side": "inner"}]
    tags = [hull(http, knot, **query).headers["etag"] for query in queries]
    assert len(set(tags)) == len(tags)
    known = http.get(f"/v1/meshes/{knot.id}/artifacts/hull.glb", params=queries[1], headers={"If-None-Match": tags[1]})
    assert (known.status_code, known.content) == (304, b"")


def test_the_client_downloads_a_hull(client, knot):
    data = client.hull(knot.id, faces=400, side="inner")
    assert len(trimesh.load(io.BytesIO(data), file_type="glb").to_geometry().faces) == 400
    with pytest.raises(RequestError):
        client.hull(knot.id, faces=4)


def test_measured_hulls_are_listed(knot):
    outer = [level for level in knot.hull.levels if level.side == "outer"]
    assert len(outer) >= 3 and outer[-1].faces == knot.hull.faces
    assert all(level.distance > 0.0 for level in knot.hull.levels)
    assert {"clip", "levels", "inner"} <= set(knot.capabilities)
