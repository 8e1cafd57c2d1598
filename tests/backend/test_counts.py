import logging

import pytest
import redis

from backend.counts import BUCKETS_S, count_end, count_start, queue_depths, read_counts
from backend.redis_connection import connect
from schemas.manifest import StageRecord
from tests.backend.accepting import accept


def ended(stage="load", outcome="done", seconds=0.5):
    return StageRecord(stage=stage, outcome=outcome, seconds=seconds)


def test_counts_add_up_by_stage_and_outcome(connection):
    for stage in ("load", "load", "hull"):
        count_start(connection, stage)
    count_end(connection, ended(seconds=0.5))
    count_end(connection, ended(seconds=2.5))
    count_end(connection, ended("hull", "failed", 40.0))
    found = read_counts(connection)
    assert found.started == {"load": 2, "hull": 1}
    assert found.ended == {("load", "done"): 2, ("hull", "failed"): 1}
    assert found.seconds == {"load": pytest.approx(3.0), "hull": pytest.approx(40.0)}


@pytest.mark.parametrize("seconds", [0.0, 0.05, *BUCKETS_S, *(bound * 1.01 for bound in BUCKETS_S), 1e6])
def test_a_stage_is_in_the_first_bucket_whose_bound_it_does_not_exceed(connection, seconds):
    count_end(connection, ended(seconds=seconds))
    expected = next((number for number, bound in enumerate(BUCKETS_S) if seconds <= bound), len(BUCKETS_S))
    assert [number for number, times in enumerate(read_counts(connection).buckets["load"]) if times] == [expected]


def test_nothing_counted_is_nothing(connection):
    found = read_counts(connection)
    assert (found.started, found.ended, found.seconds, dict(found.buckets)) == ({}, {}, {}, {})


def test_without_a_redis_counting_is_a_line_in_the_log(tmp_path, caplog):
    away = connect(f"unix://{tmp_path}/none.sock")
    with caplog.at_level(logging.WARNING):
        count_start(away, "load")
        count_end(away, ended())
    assert [record.levelname for record in caplog.records] == ["WARNING", "WARNING"]
    with pytest.raises(redis.RedisError):
        read_counts(away)


def test_depths_are_those_of_each_queue(store, queue):
    for number in range(3):
        queue.advance(accept(store, f"mesh {number}".encode()))
    queue.read_once("token", "ply", {}, 60.0)
    taken = queue.queue.get_job_ids()[0]
    queue.redis.lrem(queue.queue.key, 1, taken)
    queue.redis.zadd(f"rq:wip:{queue.queue.name}", {f"{taken}:execution": 1e12})
    depths = queue_depths(queue.redis, queue)
    assert {name: (depth.waiting, depth.running, depth.failed) for name, depth in depths.items()} == {
        "silhouette": (2, 1, 0),
        "silhouette-later": (0, 0, 0),
        "silhouette-once": (1, 0, 0),
    }
