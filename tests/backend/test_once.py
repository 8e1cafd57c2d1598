"""Meshes that are not kept, in both kinds of store."""

from pathlib import Path

from backend import once, records
from schemas import keys
from schemas.manifest import StageRecord


def put(store, data=b"mesh"):
    with store.temporary() as file:
        file.write(data)
        file.flush()
        return once.put(store, Path(file.name))


def test_a_mesh_is_wanted_answered_and_forgotten_and_the_kept_ones_are_not_touched(store):
    store.put_bytes(keys.accepted("0" * 32), b"kept")
    apart = once.store_of(store)
    token = put(apart)
    assert once.is_wanted(apart, token) and once.answer(apart, token) is None
    assert apart.local_path(keys.upload(token)).read_bytes() == b"mesh"
    records.write_stage(apart, token, StageRecord(stage=once.LOAD, outcome="done", seconds=0.1))
    answer = once.answer(apart, token)
    assert answer is not None and answer.outcome == "done"
    once.forget(apart, token)
    assert not once.is_wanted(apart, token) and list(apart.list()) == []
    assert list(store.list()) == [keys.accepted("0" * 32)]


def test_what_a_service_that_died_left_is_swept_by_the_age_of_the_youngest_of_it(store):
    apart = once.store_of(store)
    first, second = put(apart), put(apart, b"other")
    records.write_stage(apart, first, StageRecord(stage=once.LOAD, outcome="done", seconds=0.1))
    once.sweep(apart, 3600.0)
    assert once.is_wanted(apart, first) and once.is_wanted(apart, second)
    once.sweep(apart, -5.0)
    assert list(apart.list()) == []
