import json
import threading
import time

import pytest
import redis
from rq.intermediate_queue import IntermediateQueue
from rq.job import Job, JobStatus
from rq.serializers import JSONSerializer

from backend import records
from backend.queue import JobQueue
from backend.redis_connection import connect
from backend.stage_jobs import started_registry
from schemas import keys
from schemas.jobs import RUN_STAGE, STAGES
from schemas.mesh import Problem
from tests.backend.accepting import LOAD_REPORT, accept, record, record_all


def waiting(queue):
    return [job_id.rpartition("-")[2] for job_id in queue.queue.get_job_ids()]


def fetch(queue, mesh_id, stage):
    return Job.fetch(f"{mesh_id}-{stage}", connection=queue.redis, serializer=JSONSerializer)


def take(queue):
    """What a worker does first: move the next job to the intermediate list."""
    return queue.redis.lmove(queue.queue.key, queue.queue.intermediate_queue_key)


def test_a_new_mesh_is_loaded_first(store, queue):
    mesh_id = accept(store)
    queue.advance(mesh_id)
    assert waiting(queue) == ["load"]
    job = fetch(queue, mesh_id, "load")
    assert (job.func_name, tuple(job.args)) == (RUN_STAGE, (mesh_id, "load"))
    assert job.retries_left == 3
    assert job.timeout == 3600
    assert job.failure_ttl == 3600


def test_jobs_are_json_not_pickle(store, queue):
    mesh_id = accept(store)
    queue.advance(mesh_id)
    raw = queue.redis.hget(Job.key_for(f"{mesh_id}-load"), "data")
    import zlib

    assert json.loads(zlib.decompress(raw)) == [RUN_STAGE, None, [mesh_id, "load"], {}]


def test_enqueueing_twice_is_nothing(store, queue):
    mesh_id = accept(store)
    for _ in range(3):
        queue.advance(mesh_id)
        queue.reconcile()
    assert waiting(queue) == ["load"]


def test_many_advancing_at_once_enqueue_one_job(store, queue, redis_url):
    mesh_id = accept(store)
    start = threading.Barrier(6)

    def advance():
        own = JobQueue(connect(redis_url), store)
        start.wait()
        own.advance(mesh_id)

    threads = [threading.Thread(target=advance) for _ in range(6)]
    [t.start() for t in threads]
    [t.join() for t in threads]
    assert waiting(queue) == ["load"]


@pytest.mark.parametrize(
    ("done", "due"),
    [
        ([], ["load"]),
        (["load"], ["hull", "inner", "tree"]),
        (["load", "hull"], ["inner", "tree", "levels", "bake"]),
        (["load", "tree"], ["hull", "inner"]),
        (["load", "hull", "bake", "levels"], ["inner", "tree"]),
        (["load", "hull", "bake", "tree", "inner"], ["levels"]),
        (["load", "hull", "bake", "levels", "tree", "inner"], ["verify"]),
    ],
)
def test_stages_are_due_when_those_before_them_are_done_the_longest_first(store, queue, done, due):
    mesh_id = accept(store)
    for stage in done:
        record(store, mesh_id, stage)
    queue.advance(mesh_id)
    assert waiting(queue) == due


def test_skipped_stages_count_as_done(store, queue):
    mesh_id = accept(store)
    record(store, mesh_id, "load")
    for stage in ("hull", "bake", "levels", "tree", "inner"):
        record(store, mesh_id, stage, "skipped")
    queue.advance(mesh_id)
    assert waiting(queue) == ["verify"]


def test_the_ready_manifest_is_made_of_the_records(store, queue):
    mesh_id = accept(store)
    record_all(store, mesh_id)
    queue.advance(mesh_id)
    manifest = records.read_manifest(store, mesh_id)
    assert manifest.status == "ready"
    assert manifest.frame.centre == (1.0, 2.0, 3.0)
    assert manifest.stats.model_dump() == LOAD_REPORT["stats"]
    assert manifest.capabilities["clip"].available
    assert manifest.hull.faces == 4
    assert manifest.repairs == {"welded": 0}
    assert [r.stage for r in manifest.stages] == list(STAGES)
    assert waiting(queue) == []
    queue.advance(mesh_id)
    assert queue.reconcile() == 0


def test_a_failed_stage_fails_the_mesh_and_drops_its_other_jobs(store, queue):
    mesh_id = accept(store)
    record(store, mesh_id, "load")
    queue.advance(mesh_id)
    assert waiting(queue) == ["hull", "inner", "tree"]
    problem = Problem(title="The mesh cannot be used", status=422, detail="It has no faces.", code="no-faces")
    record(store, mesh_id, "hull", "failed", error=problem)
    queue.advance(mesh_id)
    manifest = records.read_manifest(store, mesh_id)
    assert (manifest.status, manifest.error) == ("failed", problem)
    assert waiting(queue) == []
    assert not Job.exists(f"{mesh_id}-tree", connection=queue.redis)


def test_exhausted_attempts_fail_the_mesh_with_a_text_for_people(store, queue):
    mesh_id = accept(store)
    queue.advance(mesh_id)
    take(queue)
    queue.redis.lrem(queue.queue.intermediate_queue_key, 0, f"{mesh_id}-load")
    fetch(queue, mesh_id, "load").set_status(JobStatus.FAILED)
    queue.reconcile()
    manifest = records.read_manifest(store, mesh_id)
    assert manifest.status == "failed"
    assert manifest.error.status == 422
    assert manifest.error.model_extra["code"] == "stage-failed"
    assert manifest.stages[-1].outcome == "failed"


@pytest.mark.parametrize("status", [JobStatus.FINISHED, JobStatus.STOPPED, JobStatus.CANCELED, JobStatus.QUEUED, JobStatus.STARTED])
def test_a_job_that_is_over_or_lost_without_a_record_is_enqueued_again(store, queue, status):
    mesh_id = accept(store)
    queue.advance(mesh_id)
    fetch(queue, mesh_id, "load").set_status(status)
    queue.redis.delete(queue.queue.key)
    queue.reconcile()
    assert waiting(queue) == ["load"]
    assert fetch(queue, mesh_id, "load").get_status() == JobStatus.QUEUED


def test_many_reconciling_a_lost_job_enqueue_it_once(store, queue, redis_url):
    mesh_id = accept(store)
    queue.advance(mesh_id)
    for _ in range(5):
        queue.redis.delete(queue.queue.key)
        start = threading.Barrier(4)

        def reconcile(start=start):
            own = JobQueue(connect(redis_url), store)
            start.wait()
            own.reconcile()

        threads = [threading.Thread(target=reconcile) for _ in range(4)]
        [t.start() for t in threads]
        [t.join() for t in threads]
        assert waiting(queue) == ["load"]


def test_a_job_in_a_workers_hands_is_left_alone(store, queue):
    mesh_id = accept(store)
    queue.advance(mesh_id)
    take(queue)
    queue.reconcile()
    assert waiting(queue) == []
    queue.redis.delete(queue.queue.intermediate_queue_key)
    queue.redis.zadd(started_registry(queue.queue).key, {f"{mesh_id}-load:execution": 1e12})
    queue.reconcile()
    assert waiting(queue) == []


def test_a_redis_that_forgot_everything_is_filled_again(store, queue):
    first, second, finished = accept(store, b"1"), accept(store, b"2"), accept(store, b"3")
    record(store, second, "load")
    record_all(store, finished)
    queue.reconcile()
    queue.redis.flushall()
    assert queue.reconcile() == 2
    assert sorted(queue.queue.get_job_ids()) == sorted([f"{first}-load", f"{second}-hull", f"{second}-tree", f"{second}-inner"])


def test_deleting_leaves_no_file_and_no_job(store, queue):
    mesh_id = accept(store)
    record(store, mesh_id, "load")
    queue.advance(mesh_id)
    queue.progress.report(mesh_id, "load", 1.0)
    assert queue.cancel(mesh_id)
    assert list(store.list()) == []
    assert waiting(queue) == []
    assert [key for key in queue.redis.scan_iter() if mesh_id.encode() in key] == []
    assert not queue.cancel(mesh_id)
    queue.advance(mesh_id)
    assert waiting(queue) == []


def test_deleting_removes_what_rq_notes_of_jobs_on_their_way_to_a_worker(store, queue):
    """It stays for a day, and a job of the same name that is on its way later would count as stuck."""
    mesh_id = accept(store)
    queue.advance(mesh_id)
    take(queue)
    assert IntermediateQueue(queue.queue.key, queue.redis).set_first_seen(f"{mesh_id}-load")
    assert queue.cancel(mesh_id)
    assert [key for key in queue.redis.scan_iter() if b"first_seen" in key] == []


def test_a_deleted_mesh_can_be_accepted_again(store, queue):
    mesh_id = accept(store)
    queue.advance(mesh_id)
    queue.cancel(mesh_id)
    assert accept(store) == mesh_id
    queue.advance(mesh_id)
    assert waiting(queue) == ["load"]


def test_deleting_works_without_redis(store, tmp_path):
    mesh_id = accept(store)
    offline = JobQueue(connect(f"unix://{tmp_path}/nothing.sock"), store)
    assert offline.cancel(mesh_id)
    assert list(store.list()) == []
    assert offline.progress.read(mesh_id) == {}
    offline.progress.report(mesh_id, "load", 0.5)
    with pytest.raises(redis.RedisError):
        offline.advance(accept(store))


def test_one_mesh_that_cannot_be_advanced_does_not_stop_the_others(store, queue):
    first, second = sorted([accept(store, b"1"), accept(store, b"2")])
    record_all(store, first)
    damaged = keys.stage_record(first, "load")
    store.put_bytes(damaged, store.get_bytes(damaged).replace(b'"scale":2.0', b'"scale":"x"'))
    queue.reconcile()
    assert queue.queue.get_job_ids() == [f"{second}-load"]


def test_reconciling_takes_turns(store, queue):
    accept(store)
    queue.redis.set("silhouette:reconciling", 1)
    queue.reconcile_in_turn(10.0)
    assert waiting(queue) == []
    queue.redis.delete("silhouette:reconciling")
    queue.reconcile_in_turn(10.0)
    assert waiting(queue) == ["load"]
    assert 0 < queue.redis.pttl("silhouette:reconciling") <= 10_000


def begin(queue, mesh_id, stage):
    """What a worker does with a job it has taken."""
    job = fetch(queue, mesh_id, stage)
    job.set_status(JobStatus.STARTED)
    queue.redis.lrem(queue.queue.intermediate_queue_key, 0, job.id)
    queue.redis.zadd(started_registry(queue.queue).key, {f"{job.id}:execution": time.time() + 10})


def test_the_owner_of_dead_workers_starts_their_jobs_again_at_the_cost_of_an_attempt(store, queue):
    mesh_id = accept(store)
    queue.advance(mesh_id)
    take(queue)
    queue.jobs.restart_abandoned()
    assert waiting(queue) == ["load"]
    assert fetch(queue, mesh_id, "load").retries_left == 3
    take(queue)
    begin(queue, mesh_id, "load")
    queue.jobs.restart_abandoned()
    assert waiting(queue) == ["load"]
    assert fetch(queue, mesh_id, "load").retries_left == 2
    queue.reconcile()
    assert waiting(queue) == ["load"]


def test_jobs_stopped_on_purpose_keep_their_attempts(store, queue):
    mesh_id = accept(store)
    queue.advance(mesh_id)
    take(queue)
    begin(queue, mesh_id, "load")
    queue.jobs.release_started()
    assert waiting(queue) == []
    queue.reconcile()
    assert waiting(queue) == ["load"]
    assert fetch(queue, mesh_id, "load").retries_left == 3


def test_two_never_reconcile_at_once_however_long_it_takes(store, queue, redis_url):
    accept(store)
    with queue.turn_to_reconcile().held(0.001):
        other = JobQueue(connect(redis_url), store)
        other.reconcile_in_turn(0.001)
        assert waiting(queue) == []


def test_everything_is_gone_through_once_in_a_while_by_one(store, queue):
    never = keys.upload("f" * 64)
    for expected in (False, True):
        store.put_bytes(never, b"accepted never")
        queue.audit_in_turn(3600.0, 3600.0)
        assert store.exists(never) == expected
    queue.redis.flushall()
    queue.audit_in_turn(3600.0, 3600.0)
    assert not store.exists(never), "a Redis that lost its data forgets the turn, too"
