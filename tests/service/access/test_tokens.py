"""Tokens: what is stored of them, and how one is held against the record."""

import hashlib
import hmac
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.access import NewKey, Scope
from service.access import tokens


def made(**fields):
    record, key = tokens.make_key(NewKey(**{"name": "shop", "scopes": [Scope.READ], **fields}))
    return record, key, tokens.parse_token(key.token)


def test_the_secret_of_a_token_is_its_records_and_nobody_elses():
    record, _, (key_id, secret) = made()
    other, _, (_, foreign) = made()
    assert key_id == record.id != other.id
    assert tokens.is_secret_of(record, secret) and tokens.is_secret_of(other, foreign)
    assert not tokens.is_secret_of(record, foreign) and not tokens.is_secret_of(record, "")


def test_the_record_has_the_hash_and_not_the_secret():
    record, _, (_, secret) = made()
    assert record.secret_sha256 == hashlib.sha256(secret.encode()).hexdigest()
    assert secret not in record.model_dump_json()
    assert "secret_sha256" not in record.info().model_dump()


def test_secrets_have_256_bits_and_do_not_repeat():
    secrets = {made()[2][1] for _ in range(50)}
    assert len(secrets) == 50
    assert {len(secret) for secret in secrets} == {43}  # base64 of 32 bytes


@given(st.integers(0, 42), st.sampled_from("ABCxyz019-_"))
def test_a_secret_with_one_other_character_is_refused(place, character):
    record, _, (_, secret) = made()
    other = secret[:place] + character + secret[place + 1 :]
    assert tokens.is_secret_of(record, other) == (other == secret)


def test_comparing_does_not_tell_how_nearly_a_secret_fits(monkeypatch):
    record, _, (_, secret) = made()
    compared = []
    monkeypatch.setattr(hmac, "compare_digest", lambda a, b: compared.append((a, b)) or False)
    assert not tokens.is_secret_of(record, secret), "what hmac.compare_digest says decides"
    assert compared == [(record.secret_sha256, record.secret_sha256)]


@pytest.mark.parametrize(
    "text", ["", "sil", "sil__", "sil_0123456789abcdef_", "sil_../../x_" + "a" * 43, "SIL_" + "0" * 16 + "_" + "a" * 43]
)
def test_what_is_no_token_is_none(text):
    assert tokens.parse_token(text) is None


@given(st.text(max_size=80))
def test_any_text_is_a_token_or_none(text):
    found = tokens.parse_token(text)
    assert found is None or f"sil_{found[0]}_{found[1]}" == text


def test_a_key_expires_when_its_days_are_over():
    assert not tokens.has_expired(made()[0])
    record = made(expires_in_days=1)[0]
    assert not tokens.has_expired(record)
    assert tokens.has_expired(record.model_copy(update={"expires": datetime.now(UTC) - timedelta(seconds=1)}))


@pytest.mark.parametrize("fields", [{"scopes": []}, {"name": ""}, {"name": "a\nb"}, {"expires_in_days": 0}, {"limits": {"max_faces": 0}}])
def test_a_key_that_makes_no_sense_is_refused(fields):
    with pytest.raises(ValueError, match=next(iter(fields))):
        made(**fields)
