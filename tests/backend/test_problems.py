import pytest

from backend.problems import problem_of
from schemas import errors
from service.errors import problem_of as answered


@pytest.mark.parametrize(
    ("error", "status", "code"),
    [
        (errors.MeshRejectedError("It is empty.", code="empty-file"), 422, "empty-file"),
        (errors.UnknownFormatError("No loader."), 415, "unknown-format"),
        (errors.TooLargeError("Too many faces."), 413, "too-large"),
        (errors.StageFailedError("No room."), 422, "stage-failed"),
        (errors.CorruptArtifactError("Damaged."), 500, "corrupt-artifact"),
    ],
)
def test_an_error_becomes_the_problem_with_its_status_and_code(error, status, code):
    problem = problem_of(error)
    assert (problem.status, problem.model_extra["code"], problem.detail) == (status, code, error.message)
    assert problem.type.endswith(code)


def test_where_is_kept_but_cannot_replace_the_standard_members():
    problem = problem_of(errors.MeshRejectedError("NaN.", vertex=7, status=200, title="x"))
    assert problem.status == 422
    assert problem.model_extra["vertex"] == 7


def test_a_failed_mesh_and_a_refused_request_have_the_same_type():
    error = errors.MeshRejectedError("NaN.", code="non-finite-vertices")
    assert problem_of(error).type == answered(error).type == "urn:silhouette:problem:non-finite-vertices"
