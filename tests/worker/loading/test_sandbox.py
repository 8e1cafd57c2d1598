"""The parsing child keeps its limits, leaves nothing behind, and is not believed."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy

from schemas.errors import MeshRejectedError, TooLargeError
from tests.meshes import cube, sphere
from tests.worker.loading.uploads import FORMATS, as_bytes, extension, loaded, parsed
from worker.loading import sandbox
from worker.loading.faults import CODES, from_report
from worker.loading.limits import LoadLimits


def children() -> set[str]:
    listed = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
    return {pid for pid in listed if "worker.loading" in Path(f"/proc/{pid}/cmdline").read_text()}


@pytest.fixture(autouse=True)
def scratch(tmp_path, monkeypatch) -> Path:
    """A folder for temporary files of this test alone."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def descriptors() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def refused(tmp_path, data: bytes, kind: str, limits: LoadLimits) -> str:
    before = descriptors()
    with pytest.raises(MeshRejectedError) as caught:
        loaded(tmp_path, data, kind, limits)
    assert not list((tmp_path / "scratch").iterdir())
    assert descriptors() == before and not children()
    return caught.value.code


def test_a_small_memory_limit_really_ends_the_child(tmp_path):
    data = as_bytes(sphere(6), "obj")
    assert loaded(tmp_path, data, "obj").stats.faces == 81920
    assert refused(tmp_path, data, "obj", LoadLimits(memory_mib=60)) == "out-of-memory"


def test_the_time_limit_really_ends_the_child(tmp_path):
    start = time.monotonic()
    assert refused(tmp_path, as_bytes(sphere(6), "obj"), "obj", LoadLimits(wall_s=0.05)) == "time-limit"
    assert time.monotonic() - start < 5.0


def test_the_processor_limit_really_ends_the_child(tmp_path):
    many = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * 6_000_000
    assert refused(tmp_path, many, "obj", LoadLimits(cpu_s=1)) == "time-limit"


def test_a_result_over_its_limit_is_refused(tmp_path):
    assert refused(tmp_path, as_bytes(sphere(6), "stl"), "stl", LoadLimits(result_mib=1)) == "out-of-memory"


def test_a_success_leaves_no_file_process_or_descriptor(tmp_path, scratch):
    loaded(tmp_path, as_bytes(cube(), "glb"), "glb")
    before = descriptors()
    loaded(tmp_path, as_bytes(cube(), "glb"), "glb")
    assert not list(scratch.iterdir()) and descriptors() == before and not children()


@pytest.mark.parametrize("kind", FORMATS)
def test_the_child_reads_the_same_without_the_libraries_that_it_leaves_out(tmp_path, kind):
    path, data = tmp_path / "upload", as_bytes(cube(), kind)
    path.write_bytes(data)
    by_child, here = sandbox.parse_limited(path, extension(kind), LoadLimits()), parsed(data, kind)
    assert np.array_equal(by_child.positions, here.positions) and np.array_equal(by_child.faces, here.faces)
    assert by_child.appearance.keys() == here.appearance.keys() and by_child.notes == here.notes


ALL = {"scipy", "networkx", "trimesh.base"}


@pytest.mark.parametrize(
    ("kind", "left_out"),
    [("ply", ALL), ("stl", ALL), ("obj", ALL), ("off", ALL), ("glb", {"scipy", "networkx"}), ("3mf", {"scipy"})],
)
def test_the_child_does_not_import_what_a_format_has_no_use_for(kind, left_out):
    code = (
        "import sys; from worker.loading.child import leave_out; leave_out(sys.argv[1]); from worker.loading.limits import LoadLimits;"
        "from worker.loading.parse import parse; assert len(parse(sys.argv[1], sys.stdin.buffer.read(), LoadLimits()).faces);"
        f"print(*(name for name in {sorted(ALL)} if sys.modules.get(name) is None))"
    )
    data = as_bytes(cube(), kind)
    shown = subprocess.run([sys.executable, "-c", code, kind], input=data, capture_output=True, check=True)
    assert set(shown.stdout.decode().split()) == left_out


def test_the_child_dies_with_its_parent(tmp_path):
    path = tmp_path / "upload"
    path.write_bytes(b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * 3_000_000)
    script = (
        "import sys, pathlib; from worker.load import load_mesh; from schemas.mesh import PreprocessOptions\n"
        f"load_mesh(pathlib.Path({str(path)!r}), 'obj', PreprocessOptions())"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], cwd=Path(__file__).resolve().parents[3])
    child = ""
    deadline = time.monotonic() + 60.0
    while not child and time.monotonic() < deadline:
        child = Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().strip()
        time.sleep(0.02)
    time.sleep(0.3)
    parent.kill()
    parent.wait()
    while time.monotonic() < deadline and _runs(child):
        time.sleep(0.02)
    assert child and not _runs(child)


def _runs(pid: str) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.parametrize(
    ("status", "expected"),
    [
        (-signal.SIGSEGV, "parser-crashed"),
        (-signal.SIGABRT, "parser-crashed"),
        (1, "parser-crashed"),
        (-signal.SIGKILL, "out-of-memory"),
        (-signal.SIGXCPU, "time-limit"),
    ],
)
def test_the_death_of_a_child_has_a_code(status, expected):
    with pytest.raises(MeshRejectedError) as caught:
        sandbox._collect(io.BytesIO(), io.BytesIO(), status, LoadLimits())
    assert caught.value.code == expected


TRIANGLE = {"positions": np.eye(3), "faces": np.array([[0, 1, 2]], np.int32)}


def collected(tensors, report=b"{}"):
    data = safetensors.numpy.save(tensors) if isinstance(tensors, dict) else tensors
    return sandbox._collect(io.BytesIO(data), io.BytesIO(report), 0, LoadLimits(max_faces=10))


def test_a_sound_result_is_taken():
    assert collected(TRIANGLE).faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    "changes",
    [
        {"faces": np.array([[0, 1, 3]], np.int32)},
        {"faces": np.array([[0, 1, -1]], np.int32)},
        {"faces": np.array([[0, 1, 2]], np.int64)},
        {"faces": np.zeros((0, 3), np.int32)},
        {"faces": np.zeros((1, 4), np.int32)},
        {"positions": np.full((3, 3), np.nan)},
        {"positions": np.eye(3, dtype=np.float32)},
        {"extra": np.zeros(1)},
        {"corner_color": np.zeros((2, 3, 4), np.uint8)},
        {"corner_color": np.zeros((1, 3, 3), np.uint8)},
        {"corner_uv": np.zeros((1, 3, 2), np.float32)},
        {"texture": np.zeros((1, 1, 4), np.uint8)},
        {"corner_uv": np.full((1, 3, 2), np.inf, np.float32), "texture": np.zeros((1, 1, 4), np.uint8)},
    ],
)
def test_a_result_that_is_not_as_agreed_is_refused(changes):
    with pytest.raises(MeshRejectedError):
        collected(TRIANGLE | changes)


@pytest.mark.parametrize("data", [b"", b"\xff" * 64, b"\x08\0\0\0\0\0\0\0notjson!"])
def test_a_result_that_is_no_file_is_refused(data):
    with pytest.raises(MeshRejectedError):
        collected(data)


@pytest.mark.parametrize("report", [b"", b"[]", b"{", b'{"where": 3, "code": "truncated"}', b"[" * 9999])
def test_a_report_that_is_none_is_refused(report):
    with pytest.raises(MeshRejectedError) as caught:
        collected(TRIANGLE, report)
    assert caught.value.code == "parser-crashed"


def test_more_faces_than_allowed_are_refused():
    with pytest.raises(TooLargeError):
        collected(TRIANGLE | {"faces": np.array([[0, 1, 2]] * 11, np.int32)})


def test_the_words_of_a_child_are_only_taken_when_they_look_like_ours():
    assert from_report("truncated", "It breaks off.", {"line": 3}).where == {"line": 3}
    assert from_report("no-such-code", "It breaks off.", {}).code == "parse-failed"
    assert from_report("truncated", "a\nb", {}).code == "parse-failed"
    assert from_report("truncated", "x" * 5000, {}).code == "parse-failed"
    assert from_report("truncated", "It breaks off.", {"a": [1], "code": "x", "message": "y"}).code == "truncated"
    assert isinstance(from_report("too-large", "Too large.", {"limit": 3}), TooLargeError)


def test_every_code_is_a_slug():
    assert all(code == code.lower() and " " not in code for code in CODES)


def test_a_hostile_report_names_no_field_of_ours():
    report = json.dumps({"code": "truncated", "message": "Cut.", "where": {"code": "not-a-mesh"}}).encode()
    with pytest.raises(MeshRejectedError) as caught:
        collected(TRIANGLE, report)
    assert caught.value.code == "truncated"
