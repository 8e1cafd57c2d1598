"""What is said of meshes as their records land, and how little is read for those that are at their end."""

import time

import pytest

from backend import records
from backend.local_store import LocalStore
from backend.manifests import build_manifest
from backend.progress import Progress
from backend.redis_connection import connect
from schemas import keys
from schemas.errors import NotFoundError, NotReadyError
from schemas.jobs import LATER_STAGES, STAGES
from schemas.mesh import Problem
from service.assets import state_of
from service.errors import FailedMeshError
from service.meshes import KEPT, Meshes
from tests.backend.accepting import LOAD_REPORT, accept, record, record_all


@pytest.fixture
def store(tmp_path):
    return LocalStore(tmp_path / "store")


@pytest.fixture
def progress(tmp_path):
    """Of a Redis that is not there: nothing is known of what runs."""
    return Progress(connect(f"unix://{tmp_path}/none.sock"))


@pytest.fixture
def meshes(store, progress):
    return Meshes(store, progress, measure=True)


def finish(store, mesh_id):
    done = {stage: records.read_stage(store, mesh_id, stage) for stage in STAGES}
    with records.publishing(store, mesh_id):
        assert records.write_manifest(store, build_manifest(mesh_id, done))


def ready(store, data=b"solid"):
    mesh_id = accept(store, data)
    record_all(store, mesh_id)
    finish(store, mesh_id)
    return mesh_id


def settled(store, data=b"solid"):
    mesh_id = ready(store, data)
    for stage in LATER_STAGES:
        record(store, mesh_id, stage)
    return mesh_id


def test_an_accepted_mesh_has_no_pictures(store, meshes):
    mesh_id = accept(store)
    with pytest.raises(NotReadyError):
        meshes.drawable(mesh_id)
    info = meshes.info(mesh_id)
    assert (info.status, set(info.links)) == ("queued", {"self", "events"})


def test_a_loaded_mesh_has_pictures_but_nothing_of_its_hull(store, meshes):
    mesh_id = accept(store)
    record(store, mesh_id, "load", report=LOAD_REPORT)
    manifest = meshes.drawable(mesh_id)
    assert (manifest.status, state_of(manifest)) == ("loaded", "loaded")
    assert manifest.frame.scale == 2.0
    with pytest.raises(NotReadyError):
        meshes.manifest(mesh_id)
    info = meshes.info(mesh_id)
    assert (info.status, set(info.links)) == ("processing", {"self", "events", "render", "thumbnail", "original.glb"})
    assert (info.stats.faces, info.sphere.radius, info.hull) == (4, 2.0, None)
    assert not info.capabilities["clip"].available and "has not ended" in info.capabilities["clip"].reason
    assert not store.exists(keys.manifest(mesh_id))


def test_a_loaded_mesh_that_never_will_be_clipped_says_so_at_once(store, meshes):
    mesh_id = accept(store)
    open_mesh = {**LOAD_REPORT, "capabilities": {"clip": {"available": False, "reason": "it is open"}}}
    record(store, mesh_id, "load", report=open_mesh)
    assert meshes.drawable(mesh_id).capabilities["clip"].reason == "it is open"


def test_a_mesh_that_failed_to_load_has_no_pictures(store, meshes):
    mesh_id = accept(store)
    record(store, mesh_id, "load", "failed", error=Problem(title="x", status=422, detail="It has no faces."))
    with pytest.raises(NotReadyError):
        meshes.drawable(mesh_id)
    finish(store, mesh_id)
    with pytest.raises(FailedMeshError, match="no faces"):
        meshes.drawable(mesh_id)
    info = meshes.info(mesh_id)
    assert set(info.links) == {"self", "events"}
    assert [stage.name for stage in info.stages] == list(STAGES)


def test_the_state_of_a_ready_mesh_follows_its_later_stages_and_its_status_does_not(store, meshes):
    mesh_id = ready(store)
    states = [state_of(meshes.drawable(mesh_id))]
    for stage in LATER_STAGES:
        record(store, mesh_id, stage)
        states.append(state_of(meshes.drawable(mesh_id)))
        assert meshes.info(mesh_id).status == "ready"
    assert states == ["ready", "ready+hulls", "ready+hulls+measure"]
    assert state_of(meshes.manifest(mesh_id)) == states[-1]
    assert [r.stage for r in records.read_manifest(store, mesh_id).stages] == list(STAGES)


def test_later_stages_are_listed_while_they_wait_and_when_they_have_ended(store, meshes, progress):
    mesh_id = ready(store)
    assert [(s.name, s.status) for s in meshes.info(mesh_id).stages][-2:] == [("hulls", "queued"), ("measure", "queued")]
    problem = Problem(title="Preprocessing failed", status=422, detail="It broke.")
    record(store, mesh_id, "hulls", "failed", error=problem)
    record(store, mesh_id, "measure", "skipped")
    hulls, measure = meshes.info(mesh_id).stages[-2:]
    assert (hulls.status, hulls.error, measure.status) == ("failed", problem, "skipped")
    assert meshes.info(mesh_id).error is None


def test_without_the_setting_later_stages_are_listed_only_where_they_ran(store, progress):
    unmeasured = Meshes(store, progress, measure=False)
    one, other = ready(store, b"1"), settled(store, b"2")
    assert [stage.name for stage in unmeasured.info(one).stages] == list(STAGES)
    assert [stage.name for stage in unmeasured.info(other).stages] == [*STAGES, *LATER_STAGES]
    assert state_of(unmeasured.drawable(other)) == "ready+hulls+measure"


@pytest.mark.parametrize("measure", [True, False])
def test_nothing_is_read_of_a_settled_mesh_twice(store, progress, measure, monkeypatch):
    mesh_id = settled(store) if measure else ready(store)
    meshes = Meshes(store, progress, measure=measure)
    first = meshes.drawable(mesh_id)
    meshes.info(mesh_id)
    monkeypatch.setattr(store, "get_bytes", lambda key: pytest.fail(f"{key} is read"))
    assert meshes.drawable(mesh_id) is first
    assert meshes.info(mesh_id).status == "ready"


def test_a_settled_mesh_deleted_and_taken_again_elsewhere_is_seen_as_what_it_is(store, meshes):
    mesh_id = settled(store)
    assert meshes.drawable(mesh_id).status == "ready"
    records.forget(store, mesh_id)
    with pytest.raises(NotFoundError):
        meshes.drawable(mesh_id)
    assert accept(store) == mesh_id
    with pytest.raises(NotReadyError):
        meshes.drawable(mesh_id)
    record_all(store, mesh_id)
    finish(store, mesh_id)
    assert state_of(meshes.drawable(mesh_id)) == "ready"


def test_a_record_that_lands_between_two_reads_is_seen_the_next_time(store, meshes, monkeypatch):
    mesh_id = ready(store)
    record(store, mesh_id, "hulls")
    exists, landed = store.exists, []

    def then_lands(key):
        found = exists(key)
        if key == keys.stage_record(mesh_id, "measure") and not landed:
            landed.append(key)
            record(store, mesh_id, "measure")
        return found

    monkeypatch.setattr(store, "exists", then_lands)
    meshes.drawable(mesh_id)
    assert landed
    assert state_of(meshes.drawable(mesh_id)) == "ready+hulls+measure"


def test_no_more_manifests_are_kept_than_said(store, progress):
    meshes = Meshes(store, progress, measure=False)
    mesh_id = ready(store)
    manifest = meshes.drawable(mesh_id)
    for number in range(KEPT + 3):
        meshes._keep(f"{number:032x}", "1", manifest)
    assert len(meshes._settled) == KEPT
    assert mesh_id not in meshes._settled


def test_where_looking_is_slow_a_ready_mesh_is_looked_up_now_and_then(store, meshes, monkeypatch):
    monkeypatch.setattr(store, "look_interval_s", 60.0)
    mesh_id, loading = settled(store), accept(store, b"other")
    record(store, loading, "load", report=LOAD_REPORT)
    assert meshes.drawable(loading).status == "loaded"
    kept = meshes.drawable(mesh_id)
    records.forget(store, mesh_id)  # as another replica does
    records.forget(store, loading)
    assert meshes.drawable(mesh_id) is kept
    with pytest.raises(NotFoundError):
        meshes.drawable(loading)
    monkeypatch.setattr(store, "look_interval_s", 0.01)
    time.sleep(0.02)
    with pytest.raises(NotFoundError):
        meshes.drawable(mesh_id)


def test_what_was_found_ready_a_moment_ago_needs_no_look(store, meshes, monkeypatch):
    monkeypatch.setattr("service.meshes.RECENT_S", 60.0)
    mesh_id, loading = settled(store), accept(store, b"other")
    record(store, loading, "load", report=LOAD_REPORT)
    assert meshes.recent(mesh_id) is None
    assert (meshes.drawable(loading).status, meshes.recent(loading)) == ("loaded", None)
    kept = meshes.drawable(mesh_id)
    assert meshes.recent(mesh_id) is kept
    monkeypatch.setattr("service.meshes.RECENT_S", 0.0)
    assert meshes.recent(mesh_id) is None
    monkeypatch.setattr("service.meshes.RECENT_S", 60.0)
    meshes.drawable(mesh_id)
    records.forget(store, mesh_id)
    meshes.forget(mesh_id)
    assert meshes.recent(mesh_id) is None


def test_a_mesh_that_is_deleted_while_it_is_looked_up_is_gone_at_once(store, meshes, monkeypatch):
    monkeypatch.setattr(store, "look_interval_s", 60.0)
    mesh_id, read = settled(store), records.read_manifest

    def then_is_deleted(*given):
        found = read(*given)
        records.forget(store, mesh_id)
        meshes.forget(mesh_id)
        return found

    monkeypatch.setattr(records, "read_manifest", then_is_deleted)
    meshes.drawable(mesh_id)  # who asked before the deletion may get it
    assert meshes.recent(mesh_id) is None
    with pytest.raises(NotFoundError):
        meshes.drawable(mesh_id)


def test_what_this_service_deletes_is_gone_at_once(store, meshes, monkeypatch):
    monkeypatch.setattr(store, "look_interval_s", 60.0)
    mesh_id = settled(store)
    meshes.drawable(mesh_id)
    records.forget(store, mesh_id)
    meshes.forget(mesh_id)
    with pytest.raises(NotFoundError):
        meshes.drawable(mesh_id)


def test_a_torn_acceptance_is_said_hides_no_other_mesh_and_stops_no_picture(store, meshes):
    torn, other = settled(store, b"torn"), settled(store, b"other")
    store.put_bytes(keys.accepted(torn), b"{")
    with pytest.raises(FailedMeshError) as caught:
        meshes.info(torn)
    assert caught.value.problem.model_extra["code"] == "damaged-upload"
    assert [mesh.id for mesh in meshes.page(10, None).meshes] == [other]
    assert meshes.drawable(torn).status == "ready"


def test_no_more_acceptances_are_kept_than_said_and_those_that_were_asked_for_last(store, progress, monkeypatch):
    monkeypatch.setattr("service.meshes.ACCEPTED_KEPT", 2)
    meshes = Meshes(store, progress, measure=False)
    first, second, third = (accept(store, bytes([number])) for number in range(3))
    for mesh_id in (first, second, first, third):
        meshes.info(mesh_id)
    assert set(meshes._accepted) == {first, third}
    assert {mesh.id for mesh in meshes.page(10, None).meshes} == {first, second, third}
