"""Requests a minute over all processes, also while Redis is away; and pictures in work at once."""

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.access import KeyLimits
from schemas.errors import QuotaError
from service.access import quotas
from service.access.caller import tightest
from service.access.quotas import OverRateError, RenderQuota, RequestQuota
from service.embedded import EmbeddedBackend


@pytest.fixture
def backend(tmp_path):
    backend = EmbeddedBackend(tmp_path / "data", worker_count=0)
    backend.start()
    yield backend
    backend.stop()


async def allowed(quota, key, limit, times):
    """How many of so many requests are within the limit."""
    within = 0
    for _ in range(times):
        try:
            await quota.count(key, limit)
        except OverRateError:
            continue
        within += 1
    return within


def test_a_key_has_exactly_its_requests_a_minute_over_all_processes(backend):
    async def run():
        one, two = RequestQuota(backend.redis_url), RequestQuota(backend.redis_url)
        first = await allowed(one, "a", 10, 7)
        second = await allowed(two, "a", 10, 7)
        other = await allowed(two, "b", 10, 3)
        for quota in (one, two):
            await quota.close()
        return first, second, other

    assert asyncio.run(run()) == (7, 3, 3)


def test_what_is_left_is_told_and_when_there_is_more(backend):
    async def run():
        quota = RequestQuota(backend.redis_url)
        first = await quota.count("a", 2)
        await quota.count("a", 2)
        with pytest.raises(OverRateError) as error:
            await quota.count("a", 2)
        await quota.close()
        return first, error.value

    first, error = asyncio.run(run())
    assert first.headers().items() >= {"RateLimit-Limit": "2", "RateLimit-Remaining": "1"}.items()
    assert error.counted.left == 0
    assert 0 < error.retry_after_s <= 60 and error.where == {"quota": "requests_per_minute", "limit": 2}


def test_while_redis_is_away_each_process_counts_for_itself(backend, monkeypatch):
    monkeypatch.setattr(quotas, "AWAY_S", 1.0)

    async def run():
        quota = RequestQuota(backend.redis_url)
        shared = await allowed(quota, "a", 5, 2)
        backend.stop()
        alone = await allowed(quota, "a", 5, 9)
        await quota.close()
        return shared, alone

    assert asyncio.run(run()) == (2, 5)


def test_redis_that_comes_back_counts_again(tmp_path, monkeypatch):
    monkeypatch.setattr(quotas, "AWAY_S", 0.2)
    first = EmbeddedBackend(tmp_path / "data", worker_count=0)
    first.start()

    async def run():
        quota = RequestQuota(first.redis_url)
        await quota.count("a", 5)
        first.stop()
        await quota.count("a", 5)
        again = EmbeddedBackend(tmp_path / "data", worker_count=0)
        again.start()
        try:
            await asyncio.sleep(0.3)
            counted = await quota.count("a", 5)
            other = RequestQuota(again.redis_url)
            seen_by_other = await other.count("a", 5)
            await quota.close()
            await other.close()
        finally:
            again.stop()
        return counted, seen_by_other

    counted, seen_by_other = asyncio.run(run())
    assert seen_by_other.left == counted.left - 1


def test_pictures_in_work_are_counted_for_each_key_and_given_back():
    quota = RenderQuota()
    with quota.one_more("a", 2), quota.one_more("a", 2):
        with pytest.raises(QuotaError, match="2 pictures") as error, quota.one_more("a", 2):
            pass
        assert error.value.where == {"quota": "concurrent_renders", "limit": 2}
        with quota.one_more("b", 1):
            pass
        with quota.one_more("a", None):
            pass
    with pytest.raises(ZeroDivisionError), quota.one_more("a", 1):
        raise ZeroDivisionError
    with quota.one_more("a", 1):
        pass
    assert not quota._running


limits = st.builds(KeyLimits, **{name: st.none() | st.integers(1, 100) for name in KeyLimits.model_fields})


@given(limits, limits)
def test_a_keys_limit_only_ever_tightens(own, general):
    both = tightest(own, general)
    for name in KeyLimits.model_fields:
        given = [getattr(one, name) for one in (own, general) if getattr(one, name) is not None]
        assert getattr(both, name) == (min(given) if given else None)
