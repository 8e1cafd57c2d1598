"""An upload that names files and addresses: nothing of that is opened, nobody is called."""

from __future__ import annotations

import itertools
import json
import socket
import subprocess
import sys

import numpy as np
import pytest

from schemas.errors import MeshRejectedError
from tests.meshes import cube
from tests.worker.loading.uploads import as_bytes, extension, glb, loaded

OPENED = """
import json, sys
names = []
sys.addaudithook(lambda event, found: names.append(str(found[0])) if event == "open" else None)
from worker.loading.limits import LoadLimits
from worker.loading.parse import parse
from schemas.errors import SilhouetteError
found = []
for kind, path in json.loads(sys.argv[1]):
    names.clear()
    try:
        parse(kind, open(path, "rb").read(), LoadLimits())
    except SilhouetteError:
        pass
    found.append(list(names))
print(json.dumps(found))
"""
CALLS = """
import socket, subprocess, sys, urllib.request
from worker.loading.child import deny_network_and_programs
deny_network_and_programs()
port = int(sys.argv[1])
for call in (
    lambda: socket.create_connection(("127.0.0.1", port), 1.0),
    lambda: socket.getaddrinfo("localhost", port),
    lambda: urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=1.0),
    lambda: subprocess.run(["true"]),
):
    try:
        call()
    except PermissionError:
        continue
    except OSError as error:
        if isinstance(getattr(error, "reason", None), PermissionError):
            continue
    print("it was let through")
"""


@pytest.fixture
def listener():
    """A socket that listens on this machine; nobody is to come."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(0.3)
        yield listening


def port_of(listener) -> int:
    return listener.getsockname()[1]


def nobody_came(listener) -> bool:
    try:
        listener.accept()[0].close()
    except TimeoutError:
        return True
    return False


def obj_naming(target: str) -> bytes:
    return f"mtllib {target}\nusemtl m\n".encode() + as_bytes(cube(), "obj")


def ply_naming(target: str) -> bytes:
    return as_bytes(cube(), "ply_ascii").replace(b"element vertex", f"comment TextureFile {target}\nelement vertex".encode(), 1)


def glb_naming(target: str, part: str) -> bytes:
    """A triangle whose picture or buffer lies at `target`."""
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"uri": target if part == "images" else "data:,"}],
        "buffers": [{"byteLength": 36} | ({"uri": target} if part == "buffers" else {})],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    }
    return glb(json.dumps(tree).encode(), np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes())


NAMING = {
    "obj": obj_naming,
    "ply_ascii": ply_naming,
    "glb images": lambda target: glb_naming(target, "images"),
    "glb buffers": lambda target: glb_naming(target, "buffers"),
}
FORMS = ("{folder}/hush-hush", "../hush-hush", "../../../../../../..{folder}/hush-hush", "file://{folder}/hush-hush")


def kind_of(what: str) -> str:
    return extension(what.split(maxsplit=1)[0])


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """(what, form) -> (upload, names of files that were opened to read it); all are read by one process."""
    uploads = {}
    for what, form in itertools.product(NAMING, FORMS):
        folder = tmp_path_factory.mktemp("around") / "beside"
        folder.mkdir()
        for hidden in (folder.parent / "hush-hush", folder / "hush-hush"):
            hidden.write_text("newmtl m\nKd 1 0 0\n")
        uploads[what, form] = folder / "upload"
        uploads[what, form].write_bytes(NAMING[what](form.format(folder=folder)))
    read = json.dumps([(kind_of(what), str(upload)) for (what, _), upload in uploads.items()])
    names = json.loads(subprocess.run([sys.executable, "-c", OPENED, read], capture_output=True, text=True, check=True).stdout)
    return dict(zip(uploads, zip(map(str, uploads.values()), names, strict=True), strict=True))


@pytest.mark.parametrize("what", NAMING)
@pytest.mark.parametrize("form", FORMS)
def test_files_that_an_upload_names_are_not_opened(opened, what, form):
    upload, names = opened[what, form]
    assert upload in names, "the look at what is opened sees nothing"
    assert not [name for name in names if "hush-hush" in name]


@pytest.mark.parametrize("what", NAMING)
def test_addresses_that_an_upload_names_are_not_called(tmp_path, listener, what):
    data = NAMING[what](f"http://127.0.0.1:{port_of(listener)}/hush-hush")
    try:
        mesh = loaded(tmp_path, data, kind_of(what))
    except MeshRejectedError as refused:
        assert refused.code == "external-reference"
    else:
        assert "not part of the upload" in mesh.repairs["ignored_references"]
    assert nobody_came(listener)


def test_the_child_cannot_connect_look_up_names_or_start_programs(listener):
    shown = subprocess.run([sys.executable, "-c", CALLS, str(port_of(listener))], capture_output=True, text=True, check=True)
    assert shown.stdout == "" and nobody_came(listener)


@pytest.mark.parametrize("nodes", [[{"children": [0], "mesh": 0}], [{"children": [1], "mesh": 0}, {"children": [0]}]])
def test_a_gltf_node_that_is_its_own_ancestor_ends_in_an_answer(tmp_path, nodes):
    tree = json.loads(glb_naming("data:,", "images")[20:].split(b"\0")[0].rpartition(b"}")[0] + b"}")
    data = glb(json.dumps(tree | {"nodes": nodes}).encode(), np.eye(3, dtype="<f4").tobytes())
    try:
        assert loaded(tmp_path, data, "glb").stats.faces == 1
    except MeshRejectedError as refused:
        assert refused.code in ("parse-failed", "no-faces")


def test_a_very_long_chain_of_gltf_nodes_ends_in_an_answer(tmp_path):
    tree = json.loads(glb_naming("data:,", "images")[20:].split(b"\0")[0].rpartition(b"}")[0] + b"}")
    chain = [{"children": [k + 1]} for k in range(5_000)] + [{"mesh": 0}]
    data = glb(json.dumps(tree | {"nodes": chain}).encode(), np.eye(3, dtype="<f4").tobytes())
    try:
        assert loaded(tmp_path, data, "glb").stats.faces == 1
    except MeshRejectedError as refused:
        assert refused.code in ("parse-failed", "time-limit")
