"""Keys in the store, and the short memory of them."""

import asyncio

import pytest

from backend.local_store import LocalStore
from schemas import keys
from schemas.access import NewKey, Scope
from schemas.errors import CorruptArtifactError, NotFoundError
from service.access.keys import KeyRing, KeyStore
from service.access.tokens import parse_token


@pytest.fixture
def objects(tmp_path):
    return LocalStore(tmp_path / "store")


@pytest.fixture
def stored(objects):
    return KeyStore(objects)


def wanted(name="shop"):
    return NewKey(name=name, scopes=[Scope.READ, Scope.WRITE, Scope.READ], expires_in_days=2, limits={"max_pixels": 100})


def test_a_key_comes_back_from_the_store_as_it_was_made(stored):
    made = stored.add(wanted())
    found = stored.get(made.id)
    assert found.info().model_dump() == made.model_dump(exclude={"token"})
    assert found.scopes == ["read", "write"] and found.limits.max_pixels == 100


def test_the_secret_is_nowhere_in_the_store(stored, objects):
    secrets = [parse_token(stored.add(wanted(name)).token)[1] for name in ("a", "b")]
    kept = [objects.get_bytes(key) for key in objects.list()]
    assert len(kept) == 2
    assert not any(secret.encode() in body for secret in secrets for body in kept)


def test_a_revoked_key_is_gone(stored):
    first, second = stored.add(wanted("a")), stored.add(wanted("b"))
    assert {record.id for record in stored.all()} == {first.id, second.id}
    stored.revoke(first.id)
    assert [record.id for record in stored.all()] == [second.id]
    for call in (stored.get, stored.revoke):
        with pytest.raises(NotFoundError, match="revoked"):
            call(first.id)


@pytest.mark.parametrize("name", ["", "../meshes/x", "0" * 15, "0" * 17, "accepted.json"])
def test_what_is_no_key_id_never_reaches_the_store(stored, name):
    for call in (stored.get, stored.revoke):
        with pytest.raises(NotFoundError):
            call(name)


def test_a_damaged_record_lets_nobody_in_and_is_not_quoted(stored, objects, caplog):
    made = stored.add(wanted())
    objects.put_bytes(keys.api_key(made.id), b'{"id": "something private"}')
    with pytest.raises(CorruptArtifactError) as error:
        stored.get(made.id)
    assert "private" not in str(error.value) and error.value.__cause__ is None
    assert list(stored.all()) == []
    assert "something private" not in caplog.text
    assert stored.any(), "a service with a damaged key is not one without keys"


def test_the_ring_forgets_a_key_that_was_revoked_elsewhere_in_its_time(stored):
    async def run():
        ring = KeyRing(stored, remembered_s=0.2)
        assert not await ring.any()
        made = stored.add(wanted())
        await asyncio.sleep(0.25)
        assert await ring.any()
        assert (await ring.find(made.id)).id == made.id
        KeyStore(stored._store).revoke(made.id)
        remembered = await ring.find(made.id)
        await asyncio.sleep(0.25)
        return remembered, await ring.find(made.id), await ring.any()

    remembered, later, there_are = asyncio.run(run())
    assert remembered is not None and later is None and not there_are


def test_the_ring_forgets_at_once_when_it_is_told(stored):
    async def run():
        ring = KeyRing(stored, remembered_s=1000.0)
        made = stored.add(wanted())
        assert await ring.find(made.id) is not None and await ring.any()
        stored.revoke(made.id)
        ring.forget()
        return await ring.find(made.id), await ring.any()

    assert asyncio.run(run()) == (None, False)


def test_asking_for_keys_that_there_are_not_takes_no_memory(stored, monkeypatch):
    monkeypatch.setattr("service.access.keys.REMEMBERED", 10)

    async def run():
        ring = KeyRing(stored)
        for number in range(50):
            assert await ring.find(f"{number:016x}") is None
        return len(ring._found)

    assert asyncio.run(run()) == 10
