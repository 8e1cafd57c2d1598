"""The later stages: of meshes that are ready, in a queue of their own."""

import time

import pytest
from rq.exceptions import DequeueTimeout
from rq.job import Job, JobStatus
from rq.serializers import JSONSerializer

from backend import records
from backend.queue import JobQueue
from backend.redis_connection import connect
from backend.stage_jobs import StageQueue, started_registry
from schemas import keys
from schemas.jobs import LATER_STAGES, STAGES
from schemas.mesh import Problem
from tests.backend.accepting import accept, record, record_all

BROKEN = Problem(title="Preprocessing failed", status=422, detail="It broke.", code="stage-failed")


@pytest.fixture
def queue(connection, store):
    return JobQueue(connection, store, measure=True)


def waiting(queue):
    """(stages that make a mesh ready, later ones) in the order of their queues."""
    return tuple([job_id.rpartition("-")[2] for job_id in one.get_job_ids()] for one in (queue.queue, queue.later))


def ready(store, queue, data=b"solid"):
    mesh_id = accept(store, data)
    record_all(store, mesh_id)
    queue.advance(mesh_id)
    return mesh_id


def forget_jobs(queue):
    queue.redis.flushall()


def test_a_ready_mesh_goes_on_with_its_later_stages_in_order(store, queue):
    mesh_id = ready(store, queue)
    assert records.read_manifest(store, mesh_id).status == "ready"
    assert [r.stage for r in records.read_manifest(store, mesh_id).stages] == list(STAGES)
    assert waiting(queue) == ([], ["hulls"])
    queue.advance(mesh_id)
    assert waiting(queue) == ([], ["hulls"])
    forget_jobs(queue)
    record(store, mesh_id, "hulls", "skipped")
    queue.advance(mesh_id)
    assert waiting(queue) == ([], ["measure"])
    forget_jobs(queue)
    record(store, mesh_id, "measure")
    queue.progress.report(mesh_id, "measure", 1.0)
    queue.advance(mesh_id)
    assert waiting(queue) == ([], [])
    assert queue.progress.read(mesh_id) == {}


def test_without_the_setting_a_ready_mesh_is_at_its_end(store, connection):
    queue = JobQueue(connection, store)
    mesh_id = ready(store, queue)
    queue.advance(mesh_id)
    assert queue.reconcile() == 0
    assert waiting(queue) == ([], [])


def test_a_failed_mesh_has_no_later_stages(store, queue):
    mesh_id = accept(store)
    record(store, mesh_id, "load", "failed", error=BROKEN)
    queue.advance(mesh_id)
    queue.advance(mesh_id)
    assert records.read_manifest(store, mesh_id).status == "failed"
    assert queue.reconcile() == 0
    assert waiting(queue) == ([], [])


@pytest.mark.parametrize("stage", LATER_STAGES)
def test_a_redis_that_forgot_everything_gets_later_stages_back(store, queue, stage):
    mesh_id = ready(store, queue)
    for earlier in list(LATER_STAGES)[: list(LATER_STAGES).index(stage)]:
        record(store, mesh_id, earlier)
    forget_jobs(queue)
    assert queue.reconcile() == 1
    assert waiting(queue) == ([], [stage])


def test_attempts_that_are_used_up_fail_the_stage_skip_what_needs_it_and_leave_the_mesh_ready(store, queue):
    mesh_id = ready(store, queue)
    before = store.get_bytes(keys.manifest(mesh_id))
    store.put_bytes(keys.partial(mesh_id, "hulls"), b"some of it")
    queue.redis.delete(queue.later.key)
    Job.fetch(f"{mesh_id}-hulls", connection=queue.redis, serializer=JSONSerializer).set_status(JobStatus.FAILED)
    queue.reconcile()
    failed, skipped = (records.read_stage(store, mesh_id, stage) for stage in ("hulls", "measure"))
    assert (failed.outcome, failed.error.model_extra["code"], skipped.outcome) == ("failed", "stage-failed", "skipped")
    assert store.get_bytes(keys.manifest(mesh_id)) == before
    assert not store.exists(keys.partial(mesh_id, "hulls"))
    assert waiting(queue) == ([], [])
    assert queue.reconcile() == 0


def test_of_settled_meshes_nothing_is_looked_at(store, queue, monkeypatch):
    for mesh_id in [ready(store, queue, bytes([n])) for n in range(3)]:
        for stage in LATER_STAGES:
            record(store, mesh_id, stage)
    assert queue.reconcile() == 0
    looks, entries = [], store.entries
    for look in ("get_bytes", "exists", "version", "versions", "children"):
        monkeypatch.setattr(store, look, lambda *arguments: pytest.fail(f"{arguments} is looked at"))
    monkeypatch.setattr(store, "entries", lambda prefix: looks.append(prefix) or entries(prefix))
    assert queue.reconcile() == 0
    assert looks == [keys.UNFINISHED]


def test_a_settled_mesh_that_another_process_deleted_and_took_again_is_not_settled(store, queue, redis_url):
    mesh_id = ready(store, queue)
    for stage in LATER_STAGES:
        record(store, mesh_id, stage)
    assert queue.reconcile() == 0
    other = JobQueue(connect(redis_url), store, measure=True)
    assert other.cancel(mesh_id)
    assert queue.reconcile() == 0 or pytest.fail("a deleted mesh is advanced")
    assert ready(store, other) == mesh_id
    forget_jobs(queue)
    assert queue.reconcile() == 1
    assert waiting(queue) == ([], ["hulls"])


def test_deleting_a_ready_mesh_leaves_no_later_job_and_nothing_done_in_part(store, queue):
    mesh_id = ready(store, queue)
    record(store, mesh_id, "hulls")
    queue.advance(mesh_id)
    queue.progress.report(mesh_id, "measure", 0.5)
    store.put_bytes(keys.partial(mesh_id, "measure"), b"some of it")
    assert queue.cancel(mesh_id)
    assert waiting(queue) == ([], [])
    assert list(store.list()) == []
    assert [key for key in queue.redis.scan_iter() if mesh_id.encode() in key] == []


def test_owners_of_dead_workers_put_back_later_jobs_too(store, queue):
    mesh_id = ready(store, queue)
    job = Job.fetch(f"{mesh_id}-hulls", connection=queue.redis, serializer=JSONSerializer)
    queue.redis.lmove(queue.later.key, queue.later.intermediate_queue_key)
    queue.jobs.restart_abandoned()
    assert waiting(queue) == ([], ["hulls"])
    for mend, waits in ((queue.jobs.restart_abandoned, ["hulls"]), (queue.jobs.release_started, [])):
        queue.redis.delete(queue.later.key)
        job.set_status(JobStatus.STARTED)
        queue.redis.zadd(started_registry(queue.later).key, {f"{job.id}:execution": time.time() + 10})
        mend()
        assert waiting(queue) == ([], waits)
    queue.reconcile()
    assert waiting(queue) == ([], ["hulls"])


def take(queue, timeout=None):
    return StageQueue.lpop([queue.queue.key, queue.later.key], timeout, connection=queue.redis)


def test_later_jobs_are_taken_when_no_other_waits_and_are_in_a_list_until_they_begin(store, queue):
    first = ready(store, queue, b"1")
    second = accept(store, b"2")
    queue.advance(second)
    assert queue.has_waiting()
    assert take(queue) == (queue.queue.key, f"{second}-load".encode())
    assert not queue.has_waiting()
    assert take(queue) == (queue.later.key, f"{first}-hulls".encode())
    assert take(queue) is None
    queue.reconcile()
    assert waiting(queue) == ([], []), "what a worker has taken is alive"
    assert queue.later.intermediate_queue.get_job_ids() == [f"{first}-hulls"]


def test_waiting_for_a_job_ends_in_time(store, queue):
    with pytest.raises(DequeueTimeout):
        take(queue, timeout=1)


def test_a_queue_without_redis_has_nobody_waiting(store, tmp_path):
    assert not JobQueue(connect(f"unix://{tmp_path}/nothing.sock"), store).has_waiting()
