"""Every error of the tree has a status, and nothing private gets out."""

import json

import httpx
import pytest

from schemas import errors as tree
from schemas.mesh import Problem
from service.errors import FailedMeshError, problem_of, problem_response, status_of


def all_errors(kind=tree.SilhouetteError):
    return [kind, *(found for child in kind.__subclasses__() if child.__module__ == tree.__name__ for found in all_errors(child))]


@pytest.mark.parametrize("kind", all_errors())
def test_every_error_of_the_tree_is_a_problem_with_a_sentence(kind):
    problem = problem_of(kind("What is wrong."))
    assert problem.detail == "What is wrong."
    assert 400 <= problem.status <= 599
    assert problem.type.endswith(problem.model_extra["code"])


def test_subclass_has_its_own_status_and_unknown_subclass_that_of_its_parent():
    class Narrower(tree.TooLargeError):
        pass

    assert status_of(Narrower("x"))[0] == 413


def test_store_keys_and_paths_stay_inside():
    problem = problem_of(tree.NotFoundError("none", key="meshes/secret", path="/var/lib", limit=3, blob=object()))
    assert problem.model_extra == {"code": "not-found", "limit": 3}


def test_a_where_that_is_named_like_a_member_does_not_replace_it():
    assert problem_of(tree.TooLargeError("big", status=200, title="fine")).status == 413


def test_failed_mesh_speaks_with_its_own_problem():
    problem = problem_of(FailedMeshError(Problem(title="t", status=200, detail="no faces", where="face 3")))
    assert (problem.status, problem.detail, problem.model_extra) == (422, "no faces", {"where": "face 3"})


def test_problem_response_is_problem_json_and_is_not_kept():
    answer = problem_response(problem_of(tree.BusyError("later")), {"Retry-After": "2"})
    assert (answer.status_code, answer.headers["content-type"]) == (503, "application/problem+json")
    assert (answer.headers["retry-after"], answer.headers["cache-control"]) == ("2", "no-store")
    assert json.loads(answer.body)["detail"] == "later"


def test_allow_of_a_405_names_every_method_of_the_address(service):
    with httpx.Client(base_url=service.url) as http:
        for path, methods in (("/v1/meshes", "GET, POST"), (f"/v1/meshes/{'0' * 32}", "DELETE, GET"), ("/v1/keys", "GET, POST")):
            answer = http.put(path)
            assert answer.status_code == 405 and answer.headers["allow"] == methods, path
