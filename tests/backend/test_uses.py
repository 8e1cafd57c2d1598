"""Which meshes an upload is used by: known without a look at all meshes, and right whatever was lost."""

import pytest

from backend import records
from backend.audit import audit
from schemas import keys
from tests.backend.accepting import accept


@pytest.fixture
def store(store):
    """Every kind of store in turn, one that was gone through once."""
    audit(store, measure=False)
    return store


def upload_of(store, mesh_id):
    return records.read_accepted(store, mesh_id).upload_sha256


def as_an_earlier_version_left_it(store):
    store.delete_prefix(keys.USES)
    store.delete(keys.USES_COMPLETE)


def test_the_last_mesh_of_an_upload_takes_it_along(store):
    first, second = accept(store), accept(store, hull_faces=500)
    key = keys.upload(upload_of(store, first))
    assert records.forget(store, first)
    assert store.exists(key)
    assert records.forget(store, second)
    assert list(store.list()) == [keys.USES_COMPLETE]


def test_deleting_looks_at_no_other_mesh(store, monkeypatch):
    mesh_id, other = accept(store), accept(store, b"other")
    looked, get_bytes, children = [], store.get_bytes, store.children
    monkeypatch.setattr(store, "get_bytes", lambda key: looked.append(key) or get_bytes(key))
    monkeypatch.setattr(store, "children", lambda prefix: looked.append(prefix) or children(prefix))
    assert records.forget(store, mesh_id)
    assert keys.MESHES not in looked and not any(other in key for key in looked)


def test_in_a_store_of_an_earlier_version_no_mesh_loses_its_upload(store):
    first, second = accept(store), accept(store, hull_faces=500)
    upload = upload_of(store, first)
    as_an_earlier_version_left_it(store)
    assert records.forget(store, first)
    assert store.exists(keys.upload(upload))
    audit(store, measure=False)
    assert list(store.list(keys.USES)) == [keys.use(upload, second)]
    assert records.forget(store, second)
    assert list(store.list()) == [keys.USES_COMPLETE]


def test_going_through_everything_mends_uses(store):
    kept, deleted = accept(store, b"kept"), accept(store, b"deleted")
    upload, other = upload_of(store, kept), upload_of(store, deleted)
    store.delete(keys.use(upload, kept))
    records.forget(store, deleted)
    store.put_bytes(keys.use(other, deleted), b"")
    store.put_bytes(keys.use(keys.UNKNOWN_UPLOAD, kept), b"")
    store.put_bytes(keys.use(keys.UNKNOWN_UPLOAD, deleted), b"")
    audit(store, measure=False)
    assert list(store.list(keys.USES)) == [keys.use(upload, kept)]


def test_no_upload_goes_that_may_be_of_a_torn_acceptance_until_that_is_mended_or_deleted(store, caplog):
    torn, deleted = accept(store, b"1"), accept(store, b"2")
    store.put_bytes(keys.accepted(torn), b"{")
    as_an_earlier_version_left_it(store)
    audit(store, measure=False)
    assert store.exists(keys.use(keys.UNKNOWN_UPLOAD, torn))
    assert "unreadable acceptance record" in caplog.text
    other = keys.upload(upload_of(store, deleted))
    assert records.forget(store, deleted)
    assert store.exists(other)
    assert accept(store, b"1") == torn
    assert not store.exists(keys.use(keys.UNKNOWN_UPLOAD, torn))
    audit(store, measure=False)
    assert not store.exists(other)
    assert store.exists(keys.upload(upload_of(store, torn)))


def test_a_torn_acceptance_with_a_use_keeps_its_upload_and_no_other(store):
    torn, deleted = accept(store, b"1"), accept(store, b"2")
    own, other = (keys.upload(upload_of(store, mesh_id)) for mesh_id in (torn, deleted))
    store.put_bytes(keys.accepted(torn), b"{")
    assert records.forget(store, deleted)
    audit(store, measure=False)
    assert store.exists(own) and not store.exists(other)


def test_a_mesh_whose_acceptance_was_torn_from_the_first_look_on_can_be_deleted(store):
    torn = accept(store)
    store.put_bytes(keys.accepted(torn), b"{")
    as_an_earlier_version_left_it(store)
    audit(store, measure=False)
    assert records.forget(store, torn)
    audit(store, measure=False)
    assert list(store.list()) == [keys.USES_COMPLETE]
