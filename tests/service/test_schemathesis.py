"""The service keeps to its OpenAPI document; a longer run is `make fuzz`."""

from tests.fuzz.service import check_service

SHORT = ("--phases", "examples,fuzzing", "--max-examples", "3", "--seed", "1", "--generation-deterministic")


def test_service_keeps_to_its_document(guarded, guarded_cube, tmp_path):
    assert check_service(guarded.running.url, guarded.tokens["everything"], guarded_cube.id, tmp_path, *SHORT) == ""
