"""Store keys and mesh ids."""

import hashlib
import json

import pytest

from schemas import keys
from schemas.jobs import STAGES
from schemas.mesh import PreprocessOptions


def test_the_same_upload_twice_is_the_same_mesh():
    assert keys.mesh_id("ab", "ply", PreprocessOptions()) == keys.mesh_id("ab", "ply", PreprocessOptions())


@pytest.mark.parametrize("options", [{"hull_faces": 500}, {"texels": 512}, {"repair": "never"}, {"max_faces": 9}])
def test_other_options_are_another_mesh(options):
    assert keys.mesh_id("ab", "ply", PreprocessOptions(**options)) != keys.mesh_id("ab", "ply", PreprocessOptions())


def test_options_that_say_nothing_are_no_part_of_the_identity():
    told = json.dumps(["ab", "ply", {"hull_faces": 1000, "repair": "auto", "texels": 1024}, keys.PIPELINE_VERSION])
    assert keys.mesh_id("ab", "ply", PreprocessOptions(max_faces=None)) == hashlib.sha256(told.encode()).hexdigest()[:32]


@pytest.mark.parametrize(("own", "most", "both"), [(None, None, None), (5, None, 5), (None, 7, 7), (5, 7, 5), (9, 7, 7)])
def test_a_limit_of_faces_only_ever_tightens(own, most, both):
    assert PreprocessOptions(max_faces=own).narrowed(most).max_faces == both


def test_bytes_and_format_are_part_of_the_identity():
    ids = {keys.mesh_id(sha, ext, PreprocessOptions()) for sha in ("ab", "cd") for ext in ("ply", "stl")}
    assert len(ids) == 4
    assert all(keys.MESH_ID.match(i) for i in ids)


def test_stages_only_wait_for_stages_before_them():
    seen: set[str] = set()
    for stage, needs in STAGES.items():
        assert set(needs) <= seen
        seen.add(stage)
