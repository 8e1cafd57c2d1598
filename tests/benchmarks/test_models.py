import pytest

from benchmarks.models import AbsentError, mesh_file
from schemas.mesh import PreprocessOptions
from worker.load import load_mesh


@pytest.mark.parametrize(("name", "count"), [("knot", 185_856), ("holes3", 188_416)])
def test_generated_models_load_with_all_their_faces_and_can_be_clipped(name, count):
    with mesh_file(name) as path:
        mesh = load_mesh(path, path.suffix, PreprocessOptions())
    assert len(mesh.faces) == count
    assert mesh.clip.available
    assert not path.exists()


def test_a_file_is_taken_as_it_is(tmp_path):
    path = tmp_path / "own.ply"
    path.write_bytes(b"ply")
    with mesh_file(str(path)) as found:
        assert found == path


def test_an_absent_model_is_told_by_name():
    with pytest.raises(AbsentError, match="no_such_scan is not on this machine"), mesh_file("no_such_scan"):
        pass
