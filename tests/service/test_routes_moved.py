"""Meshes that are moved by a request, over real HTTP."""

import io
import json
import zipfile

import numpy as np
import pytest
import trimesh
from PIL import Image

from client.shapes import write_ply
from schemas.sequence import SequenceRequest
from tests import meshes, oracles, plain_http
from tests.conftest import MAX_UPLOAD_MIB
from tests.service.render.moved import bent, rotated

VIEW = {"camera": {"eye": [9.0, 6.0, 12.0]}, "width": 200, "height": 160, "accuracy": {"source": "original", "antialias": "msaa"}}
LINED = {"lines": {"ridge": {"color": "#ff0000"}, "ridge_deg": 30}}


@pytest.fixture(scope="module")
def http(service):
    with plain_http.Client(base_url=service.url, timeout=120.0) as connection:
        yield connection


@pytest.fixture(scope="module")
def places(http, knot):
    """(v, 3) f8 model units of the knot's vertices in their order, by original.glb alone."""
    answer = http.get(knot.links["original.glb"])
    assert answer.headers["content-type"] == "model/gltf-binary"
    mesh = trimesh.load(io.BytesIO(answer.content), file_type="glb", process=False).to_geometry()
    assert (len(mesh.vertices), len(mesh.faces)) == (knot.stats.vertices, knot.stats.faces)
    return np.asarray(mesh.vertices, np.float64)


def npy(array):
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def bare(array):
    return np.asarray(array, "<f4").tobytes()


def moved(http, mesh, positions, kind="render", headers=None, query=None, **request):
    form = {"request": (None, json.dumps(request))} | ({} if positions is None else {"positions": ("positions", positions)})
    return http.post(f"/v1/meshes/{mesh.id}/{kind}", files=form, headers=headers or {}, params=query or {})


def image_of(answer):
    assert answer.status_code == 200, answer.text
    return np.asarray(Image.open(io.BytesIO(answer.content)).convert("RGBA"))


@pytest.mark.parametrize("request_more", [{}, LINED], ids=["shaded", "lined"])
def test_positions_that_are_the_meshs_own_make_its_picture(http, knot, places, request_more):
    still = image_of(http.post(f"/v1/meshes/{knot.id}/render", json=VIEW | request_more | {"format": "png"}))
    answer = moved(http, knot, npy(places), **VIEW, **request_more)
    assert np.array_equal(image_of(answer), still)
    assert "deform" in answer.headers["X-Plan"].split(", ")
    assert answer.headers["Server-Timing"].startswith("pose;dur=")
    assert answer.headers["Cache-Control"] == "no-store"


@pytest.mark.parametrize("move", [bent, rotated])
def test_a_moved_mesh_is_the_picture_of_one_that_comes_so(http, knot, places, move, tmp_path):
    _, faces = meshes.knot()
    write_ply(str(tmp_path / "moved.ply"), move(meshes.knot()[0]), faces)
    form = {"file": ("moved.ply", (tmp_path / "moved.ply").read_bytes()), "request": (None, json.dumps(VIEW | LINED))}
    once = image_of(http.post("/v1/render", files=form))
    found = image_of(moved(http, knot, bare(move(places)), **VIEW, **LINED))
    still = image_of(moved(http, knot, bare(places), **VIEW, **LINED))
    assert (np.abs(found.astype(int) - once).max(axis=2) > 24).mean() < 0.005
    assert (np.abs(found.astype(int) - still).max(axis=2) > 24).mean() > 0.05


def test_a_form_can_ask_for_any_encoding_and_for_the_plan(http, knot, places):
    assert moved(http, knot, bare(places), headers={"Accept": "image/webp"}, width=32).headers["content-type"] == "image/webp"
    assert len(moved(http, knot, bare(places), width=8, height=4, format="raw").content) == 128
    plan = moved(http, knot, bare(places), query={"explain": "true"}, width=32).json()
    assert "deform" in [step["name"] for step in plan["passes"]]
    assert moved(http, knot, bare(places), headers={"Accept": "text/html"}).status_code == 406


def test_silhouette_and_lines_of_a_moved_mesh(http, knot, places, tmp_path):
    wanted = {"camera": VIEW["camera"], "project": {"width": 300, "height": 300}}
    found = moved(http, knot, bare(bent(places)), "silhouette", **wanted).json()
    write_ply(str(tmp_path / "bent.ply"), bent(places), trimesh_faces(http, knot))
    form = {"file": ("bent.ply", (tmp_path / "bent.ply").read_bytes()), "request": (None, json.dumps(wanted))}
    once = http.post("/v1/silhouette", files=form).json()
    assert len(oracles.edge_set(found["edges"]) ^ oracles.edge_set(once["edges"])) <= 0.02 * found["edge_count"]
    still = http.post(f"/v1/meshes/{knot.id}/silhouette", json=wanted).json()
    same = moved(http, knot, npy(places), "silhouette", **wanted).json()
    assert oracles.edge_set(same["edges"]) == oracles.edge_set(still["edges"]) != oracles.edge_set(found["edges"])
    drawing = moved(http, knot, bare(bent(places)), "silhouette", {"Accept": "image/svg+xml"}, visible_only=True)
    assert drawing.text.startswith("<svg") and 'class="visible"' in drawing.text
    assert "pose;dur=" in drawing.headers["Server-Timing"] and "sight;dur=" in drawing.headers["Server-Timing"]


def trimesh_faces(http, knot):
    content = http.get(knot.links["original.glb"]).content
    return np.asarray(trimesh.load(io.BytesIO(content), file_type="glb", process=False).to_geometry().faces, np.int32)


def test_one_frame_is_the_picture(http, knot, places):
    wanted = VIEW | LINED
    alone = http.post(f"/v1/meshes/{knot.id}/render", json=wanted | {"format": "png"})
    archive = zipfile.ZipFile(io.BytesIO(moved(http, knot, npy(places[None]), "frames", format="zip", **wanted).content))
    assert archive.namelist() == ["0000.png"]
    assert archive.read("0000.png") == alone.content
    turned = http.post(f"/v1/meshes/{knot.id}/frames", json={"turn": {"frames": 1}, "width": 64, "format": "zip"})
    alone = http.post(f"/v1/meshes/{knot.id}/render", json={"width": 64, "format": "png"})
    assert zipfile.ZipFile(io.BytesIO(turned.content)).read("0000.png") == alone.content


@pytest.mark.parametrize(("accept", "kind"), [("image/webp", "WEBP"), ("image/apng", "PNG")])
def test_a_turntable_goes_round_in_time(http, knot, accept, kind):
    body = {"turn": {"frames": 7}, "width": 96, "height": 80, "fps": 12, "loop": 3}
    answer = http.post(f"/v1/meshes/{knot.id}/frames", json=body, headers={"Accept": accept})
    assert (answer.status_code, answer.headers["content-type"], answer.headers["X-Frames"]) == (200, accept, "7")
    film = Image.open(io.BytesIO(answer.content))
    assert (film.format, film.size, film.n_frames, film.info["loop"]) == (kind, (96, 80), 7, 3)
    lasts = 0.0
    for number in range(7):
        film.seek(number)
        frame = np.asarray(film.convert("RGBA")).astype(int)
        lasts += film.info["duration"]
        alone = image_of(
            http.get(
                f"/v1/meshes/{knot.id}/render.{'webp' if kind == 'WEBP' else 'png'}",
                params={"azimuth": 30 + 360 * number / 7, "width": 96, "height": 80},
            )
        )
        seen = alone[:, :, 3] > 0
        assert np.abs(frame - alone)[seen].max() <= (0 if kind == "PNG" else 2)
    assert lasts == pytest.approx(7000 / 12, abs=1.0)
    assert 'frames;desc="7"' in answer.headers["Server-Timing"]
    assert answer.headers["X-Accuracy"].startswith("rung=clipped/coverage; error_px=")


def test_a_turntable_by_address_is_the_same_and_is_kept(http, knot):
    params = {"frames": 5, "width": 60, "height": 50, "azimuth": 10, "lines": "edge_mesh", "fps": 10, "degrees": -180}
    answer = http.get(f"/v1/meshes/{knot.id}/turntable.png", params=params)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/apng")
    body = {"camera": {"orbit": {"azimuth_deg": 10, "elevation_deg": 20}}, "width": 60, "height": 50, "lines": {}, "fps": 10}
    same = http.post(f"/v1/meshes/{knot.id}/frames", json=body | {"turn": {"frames": 5, "degrees": -180}, "format": "apng"})
    assert answer.content == same.content
    known = {"If-None-Match": answer.headers["etag"]}
    assert http.get(f"/v1/meshes/{knot.id}/turntable.png", params=params, headers=known).status_code == 304
    assert http.get(f"/v1/meshes/{knot.id}/turntable.png", params=params | {"frames": 6}, headers=known).status_code == 200
    assert http.get(f"/v1/meshes/{knot.id}/turntable.gif").status_code == 404
    for wrong, field in (
        ({"frames": 0}, "frames"),
        ({"eye": "9,9,9"}, "eye"),
        ({"fps": 1000}, "fps"),
        ({"width": 8000, "height": 8000}, "frames"),
    ):
        refused = http.get(f"/v1/meshes/{knot.id}/turntable.webp", params=wrong)
        assert (refused.status_code, refused.json()["errors"][0]["field"]) == (422, field)


def test_cameras_of_their_own_and_moving_vertices_go_together(http, knot, places):
    cameras = [{"eye": [9.0, 6.0, 12.0 + step]} for step in range(3)]
    poses = np.stack([bent(places, 0.3 * step) for step in range(3)])
    answer = moved(http, knot, bare(poses), "frames", format="zip", width=96, height=80, cameras=cameras)
    frames = zipfile.ZipFile(io.BytesIO(answer.content))
    assert len(frames.namelist()) == 3 and answer.headers["X-Frames"] == "3"
    for number, (camera, pose) in enumerate(zip(cameras, poses, strict=True)):
        alone = moved(http, knot, bare(pose), width=96, height=80, camera=camera, format="png")
        assert frames.read(f"{number:04d}.png") == alone.content
    one = moved(http, knot, bare(poses[2]), "frames", format="zip", width=96, height=80, cameras=cameras)
    assert zipfile.ZipFile(io.BytesIO(one.content)).read("0002.png") == frames.read("0002.png")


def test_steps_of_a_sequence_are_summed(http, knot, places):
    poses = np.stack([bent(places, 0.1 * step) for step in range(5)])
    answer = moved(http, knot, bare(poses), "frames", width=64, height=64)
    timing = answer.headers["Server-Timing"]
    assert all(f"{step};dur=" in timing for step in ("pose", "deform", "surface", "read", "encode", "write"))
    assert 'frames;desc="5"' in timing


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda p: bare(p[:-1]), "three float32 a vertex"),
        (lambda p: b"", "0 bytes"),
        (lambda p: npy(p[:-1]), "vertices"),
        (lambda p: npy(p.astype(np.int32)), "float32 or float64"),
        (lambda p: npy(np.asfortranarray(p)), "columns"),
        (lambda p: npy(p)[:-8], "no whole file"),
        (lambda p: b"\x93NUMPY" + bytes(20), "version 0.0"),
        (lambda p: npy(np.where(np.arange(len(p))[:, None] == 7, np.nan, p)), "not finite, the first of them that of vertex 7"),
        (lambda p: npy(p * 1e9), "farther than"),
        (lambda p: bare(np.stack([p, p])), "2 of 2,560 vertices"),
        (lambda p: None, "no field `positions`"),
    ],
)
@pytest.mark.parametrize("kind", ["render", "silhouette"])
def test_positions_that_cannot_be_are_refused(http, knot, places, spoil, says, kind):
    answer = moved(http, knot, spoil(places), kind)
    assert (answer.status_code, answer.headers["content-type"]) == (422, "application/problem+json"), answer.text
    assert says in answer.json()["detail"]
    assert answer.json()["errors"][0]["field"] == "positions"


@pytest.mark.parametrize(
    ("request_fields", "poses", "field", "says"),
    [
        ({}, None, "turn", "nothing says what changes"),
        ({"turn": {"frames": 3}}, 2, "turn.frames", "3 views and positions of 2"),
        ({"cameras": [{"eye": [9, 9, 9]}] * 2}, 3, "cameras", "2 views and positions of 3"),
        ({"cameras": [{"eye": [9, 9, 9]}], "turn": {}}, None, "cameras", "not both"),
        ({"camera": {"eye": [9, 9, 9]}, "turn": {}}, None, "turn", "orbit"),
        ({"turn": {"frames": 1001}}, None, "turn.frames", "1000"),
        ({"turn": {"frames": 100}, "width": 1000, "height": 1000}, None, "turn.frames", "100,000,000 pixels"),
        ({"turn": {}, "fps": 0}, None, "fps", "0.1"),
        ({"turn": {"count": 3}}, None, "turn.count", "no such field"),
        ({"cameras": [{"eye": [9, 9, 9]}, {"eye": [0, 0, 0]}]}, None, "cameras[1].eye", "same point"),
        ({"turn": {}, "format": "gif"}, None, "format", "webp"),
    ],
)
def test_sequences_that_cannot_be_are_refused(http, knot, places, request_fields, poses, field, says):
    positions = None if poses is None else bare(np.stack([places] * poses))
    for answer in (
        moved(http, knot, positions, "frames", **request_fields),
        *([] if poses else [http.post(f"/v1/meshes/{knot.id}/frames", json=request_fields)]),
    ):
        assert answer.status_code == 422, answer.text
        assert answer.json()["errors"][0]["field"] == field
        assert says in answer.json()["detail"]


def test_a_wrong_frame_is_named(http, knot, places):
    poses = np.stack([places] * 4)
    poses[2, 5] = np.inf
    answer = moved(http, knot, bare(poses), "frames", width=32)
    assert answer.status_code == 422
    assert answer.json()["frame"] == 2 and "frame 2: 1 of 2,560 positions are not finite" in answer.json()["detail"]


@pytest.mark.parametrize(
    ("form", "status", "field"),
    [
        ({"request": (None, '{"width": 0}'), "positions": b""}, 422, "width"),
        ({"request": (None, "no json"), "positions": b""}, 422, "body"),
        ({"azimuth": (None, "3"), "positions": b""}, 422, "azimuth"),
        ({"request": (None, '{"accuracy": {"source": "clipped"}}'), "positions": "own"}, 422, "accuracy.source"),
        ({"request": (None, " " * (1 << 21)), "positions": b""}, 413, None),
    ],
)
def test_forms_that_are_wrong_name_their_field(http, knot, places, form, status, field):
    form = form | {"positions": ("p", bare(places) if form["positions"] == "own" else form["positions"])}
    answer = http.post(f"/v1/meshes/{knot.id}/render", files=form)
    assert answer.status_code == status, answer.text
    assert field is None or answer.json()["errors"][0]["field"] == field


def test_forms_are_no_larger_than_uploads(http, knot):
    answer = moved(http, knot, bytes((MAX_UPLOAD_MIB << 20) + (1 << 20)))
    assert answer.status_code == 413
    assert http.post(f"/v1/meshes/{knot.id}/render", content=b"{" + b" " * (2 << 20)).status_code == 413


@pytest.mark.parametrize("kind", ["render", "silhouette", "frames"])
def test_a_mesh_that_is_not_there_is_404(http, kind, knot, places):
    form = {"request": (None, "{}"), "positions": ("p", bare(places))}
    assert http.post(f"/v1/meshes/{'0' * 32}/{kind}", files=form).status_code == 404


def test_nothing_of_the_positions_is_left_on_the_disk(http, service, knot, places):
    def stored():
        found = (path.relative_to(service.data_dir / "store") for path in (service.data_dir / "store").rglob("*") if path.is_file())
        return sorted(path for path in found if path.parts[0] not in ("unfinished", "indexed"))

    before = stored()
    moved(http, knot, bare(places), width=32)
    moved(http, knot, bare(places)[:-4], width=32)
    moved(http, knot, bare(np.stack([places] * 3)), "frames", width=32)
    assert stored() == before


def test_the_original_has_an_identity_and_is_no_hull(http, knot):
    url = knot.links["original.glb"]
    answer = http.get(url)
    assert http.get(url, headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
    assert http.get(url, params={"faces": 100}).status_code == 422
    assert "original.glb" in http.get(url.replace("original.glb", "original.stl")).json()["detail"]


def test_the_reference_has_a_sequence_to_try_and_the_forms(http):
    document = http.get("/openapi.json").json()
    SequenceRequest.model_validate(document["components"]["schemas"]["SequenceRequest"]["example"])
    for kind in ("render", "silhouette", "frames"):
        content = document["paths"][f"/v1/meshes/{{mesh_id}}/{kind}"]["post"]["requestBody"]["content"]
        assert content["application/json"]["schema"]["$ref"]
        assert set(content["multipart/form-data"]["schema"]["properties"]) == {"request", "positions"}
