"""The command as people and scripts run it; in a process of its own, through pipes, where that is the claim."""

import json

import pytest
from PIL import Image

from client.cli import COMMANDS
from client.shapes import write_ply
from tests import meshes
from tests.client.command import silhouette, silhouette_process


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_has_an_example(command):
    run = silhouette(command, "--help")
    assert run.returncode == 0
    assert run.stdout.count(f"silhouette {command}".encode()) >= 2, "once for its usage, once in an example"


def test_upload_prints_the_id_alone_and_progress_elsewhere(service, knot, knot_file):
    run = silhouette_process("upload", knot_file, "--hull-faces", 200, "--texels", 256, url=service.url)
    assert run.stdout.decode().strip() == knot.id
    assert b"load" in run.stderr
    assert b"\x1b" not in run.stdout + run.stderr, "no terminal codes in a pipe"


def test_render_by_beginning_of_the_id(service, knot, tmp_path):
    run = silhouette("render", knot.id[:12], "-o", tmp_path / "k.webp", "--azimuth", 40, "--size", "80x60", url=service.url)
    assert run.returncode == 0, run.stderr
    with Image.open(tmp_path / "k.webp") as image:
        assert (image.format, image.size) == ("WEBP", (80, 60))


def test_render_to_stdout_is_png_and_nothing_else(service, knot):
    run = silhouette_process("render", knot.id, "-o", "-", "--eye", "0,0,12", "--size", 32, url=service.url)
    assert run.stdout[:8] == b"\x89PNG\r\n\x1a\n"


def test_render_of_a_file_uploads_it_first(service, tmp_path):
    write_ply(str(tmp_path / "cube.ply"), *meshes.cube())
    run = silhouette("render", tmp_path / "cube.ply", "-o", tmp_path / "k.png", "--size", 64, url=service.url)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "k.png").stat().st_size > 100


def test_visible_lines_as_dxf(service, knot, tmp_path):
    run = silhouette("silhouette", knot.id, "-o", tmp_path / "k.dxf", "--visible-only", "--kinds", "silhouette,ridge", url=service.url)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "k.dxf").read_bytes().endswith(b"EOF\n")
    assert b"HIDDEN" not in (tmp_path / "k.dxf").read_bytes()


def test_silhouette_as_drawing_and_as_data(service, knot, tmp_path):
    drawn = silhouette("silhouette", knot.id, "-o", tmp_path / "k.svg", url=service.url)
    assert drawn.returncode == 0, drawn.stderr
    assert "<svg" in (tmp_path / "k.svg").read_text()[:300]
    data = silhouette("silhouette", knot.id, "-o", "-", url=service.url)
    assert json.loads(data.stdout)["edge_count"] > 10


def test_render_with_lines_over_white(service, knot, tmp_path):
    options = ("--lines", "edge_mesh", "--line-width", 3, "--ridges", "--fill", "white", "--size", 96)
    run = silhouette("render", knot.id, "-o", tmp_path / "k.png", *options, url=service.url)
    assert run.returncode == 0, run.stderr
    assert b"edge_mesh" in run.stderr + run.stdout
    with Image.open(tmp_path / "k.png") as image:
        assert {(0, 0, 0, 255), (255, 255, 255, 255)} <= {colour for _, colour in image.getcolors(96 * 96)}


def test_strokes_in_a_picture_and_in_a_drawing(service, knot, tmp_path):
    stroke = ("--stroke", "width_by=depth", "--stroke", "dash=12,6", "--stroke", "wobble_px=2")
    run = silhouette("render", knot.id, "-o", tmp_path / "k.png", "--lines", "strokes", *stroke, "--size", 96, url=service.url)
    assert run.returncode == 0, run.stderr
    assert b"vector_lines" in run.stderr + run.stdout
    drawn = silhouette("silhouette", knot.id, "-o", tmp_path / "k.svg", "--visible-only", "--line-width", 7, *stroke, url=service.url)
    assert drawn.returncode == 0, drawn.stderr
    assert all(f'{name}="{value}"' in (tmp_path / "k.svg").read_text() for name, value in (("stroke", "none"), ("stroke-width", 7)))
    for wrong, says in ((("--stroke", "wobble_px=2"), b"--lines strokes"), (("--lines", "strokes", "--stroke", "wavy"), b"--stroke takes")):
        refused = silhouette("render", knot.id, "-o", tmp_path / "k.png", *wrong, url=service.url)
        assert refused.returncode != 0 and says in refused.stderr


def test_render_and_silhouette_of_a_file_that_is_not_kept(service, client, tmp_path, knot_file):
    known = {mesh.id for mesh in client.list()}
    run = silhouette("render", knot_file, "-o", tmp_path / "k.png", "--size", "60x40", "--once", url=service.url)
    assert run.returncode == 0, run.stderr
    with Image.open(tmp_path / "k.png") as image:
        assert image.size == (60, 40)
    drawn = silhouette("silhouette", knot_file, "-o", tmp_path / "k.svg", "--once", url=service.url)
    assert drawn.returncode == 0, drawn.stderr
    assert "<svg" in (tmp_path / "k.svg").read_text()[:300]
    assert {mesh.id for mesh in client.list()} == known
    refused = silhouette("render", "3f2a91", "-o", tmp_path / "k.png", "--once", url=service.url)
    assert refused.returncode != 0 and b"is none" in refused.stderr


def test_list_and_info_as_json_and_as_table(service, knot):
    assert knot.id in [mesh["id"] for mesh in json.loads(silhouette("list", "--json", url=service.url).stdout)]
    assert json.loads(silhouette("info", knot.id, "--json", url=service.url).stdout)["stats"]["faces"] == 5120
    assert b"5,120" in silhouette("info", knot.id[:10], url=service.url).stdout
    assert knot.id in silhouette("list", url=service.url, env={"COLUMNS": "150"}).stdout.decode()
    assert knot.id in silhouette("list", url=service.url, env={"COLUMNS": "60"}).stdout.decode(), "ids are for copying, however narrow"


def test_delete_removes_the_mesh(service, tmp_path, knot_file):
    run = silhouette("upload", knot_file, "--no-wait", "--hull-faces", 210, "--texels", 128, url=service.url)
    mesh_id = run.stdout.decode().strip()
    assert silhouette("delete", mesh_id, url=service.url).returncode == 0
    assert silhouette("info", mesh_id, url=service.url).returncode == 1


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("render", "nothing-like-it", "-o", "x.png"), "neither a file nor a mesh id"),
        (("render", "0" * 32, "-o", "x.png"), "no such mesh"),
        (("render", "abcdef", "-o", "x.png"), "no mesh id begins with"),
        (("render", "KNOT", "-o", "x.gif"), ".png"),
        (("render", "KNOT", "-o", "x.png", "--size", "big"), "--size"),
        (("render", "KNOT", "-o", "x.png", "--size", "0"), "width"),
        (("render", "KNOT", "-o", "x.png", "--eye", "0,0"), "--eye"),
        (("render", "KNOT", "-o", "x.png", "--elevation", "91"), "elevation"),
        (("render", "KNOT", "-o", "no/such/folder/x.png"), "no/such/folder"),
        (("silhouette", "KNOT", "-o", "x.png"), ".svg"),
    ],
)
def test_fault_is_one_line_and_exit_code_1(service, knot, tmp_path, arguments, word):
    run = silhouette(*(knot.id if part == "KNOT" else part for part in arguments), url=service.url, cwd=tmp_path)
    lines = run.stderr.decode().strip().splitlines()
    assert (run.returncode, len(lines)) == (1, 1), lines
    assert lines[0].startswith("error ")
    assert word in lines[0]


def test_service_that_is_not_there_is_one_line():
    run = silhouette_process("list", url="http://127.0.0.1:9")
    assert run.returncode == 1
    assert run.stderr.decode().startswith("error No silhouette service answers")
    assert "Traceback" not in run.stderr.decode()


def test_unusable_file_is_one_line(service, tmp_path):
    page = tmp_path / "page.stl"
    page.write_text("<!doctype html><html>not a mesh at all, however long it may be</html>" * 4)
    run = silhouette("upload", page, url=service.url)
    assert run.returncode == 1
    assert run.stdout == b""
    assert run.stderr.decode().strip().splitlines()[-1].startswith("error ")


def test_scene_of_ids_and_files_beside_it(service, knot, tmp_path):
    write_ply(str(tmp_path / "cube.ply"), *meshes.cube())
    scene = {"width": 90, "objects": [{"mesh": knot.id[:10]}, {"mesh": "cube.ply", "transform": {"translate": [0, 0, -20]}}]}
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    run = silhouette("scene", tmp_path / "scene.json", "-o", tmp_path / "s.png", url=service.url)
    assert run.returncode == 0, run.stderr
    assert b"layer[1]" in run.stderr
    with Image.open(tmp_path / "s.png") as image:
        assert image.size == (90, 512)
    said = json.dumps({"objects": [{"mesh": knot.id}]}).encode()
    piped = silhouette_process("scene", "-", "-o", "-", "--size", "40x30", url=service.url, said=said)
    assert piped.stdout[:8] == b"\x89PNG\r\n\x1a\n"
    (tmp_path / "scene.json").write_text(json.dumps(scene | {"lines": {}}))
    lined = silhouette("scene", tmp_path / "scene.json", "-o", tmp_path / "s.png", url=service.url)
    assert b"edge_mesh" in lined.stderr


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("{", b"not valid JSON"),
        ("[]", b"holds no scene"),
        ('{"objects": [3]}', b"objects[0]"),
        ('{"objects": [{"mesh": "zz"}]}', b"neither a file"),
    ],
)
def test_a_file_that_is_no_scene_is_one_line(service, tmp_path, text, word):
    (tmp_path / "scene.json").write_text(text)
    run = silhouette("scene", tmp_path / "scene.json", "-o", tmp_path / "s.png", url=service.url)
    assert run.returncode == 1
    assert word in run.stderr
    assert b"Traceback" not in run.stderr
