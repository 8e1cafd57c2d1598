"""Pictures are given again while there is room, and made once however many ask."""

from __future__ import annotations

import asyncio

import pytest

from schemas.errors import BusyError
from service.picture_cache import HEADER_BYTES, KeptPicture, PictureCache


def picture(size):
    return KeptPicture(bytes(size), {})


def test_least_recently_used_goes_first_and_the_limit_holds():
    cache = PictureCache(3 * (100 + HEADER_BYTES))
    for tag in "abc":
        cache.put(tag, picture(100))
    assert cache.get("a") is not None
    cache.put("d", picture(100))
    assert [cache.get(tag) is not None for tag in "abcd"] == [True, False, True, True]
    assert cache.nbytes == 3 * (100 + HEADER_BYTES)


def test_too_large_a_picture_is_not_kept_and_costs_nobody_a_place():
    cache = PictureCache(1000 + HEADER_BYTES)
    cache.put("small", picture(10))
    cache.put("large", picture(1001))
    assert cache.get("large") is None
    assert cache.get("small") is not None


def test_a_picture_put_twice_counts_once():
    cache = PictureCache(10_000)
    cache.put("a", picture(10))
    cache.put("a", picture(30))
    assert cache.nbytes == 30 + HEADER_BYTES


def test_one_at_a_time_makes_a_picture_and_the_others_find_it():
    made = []

    async def ask(cache):
        async with cache.alone("a", 60.0):
            if cache.get("a") is None:
                await asyncio.sleep(0.01)
                made.append(1)
                cache.put("a", picture(1))
        return cache.get("a")

    async def all_of_them():
        cache = PictureCache(10_000)
        return await asyncio.gather(*(ask(cache) for _ in range(5)))

    assert all(asyncio.run(all_of_them()))
    assert len(made) == 1


def test_one_who_has_waited_long_enough_for_a_picture_that_another_makes_is_told_to_come_back():
    async def ask(cache):
        async with cache.alone("a", 0.01):
            await asyncio.sleep(0.1)

    async def both():
        cache = PictureCache(10_000)
        first = asyncio.ensure_future(ask(cache))
        await asyncio.sleep(0)
        with pytest.raises(BusyError):
            await ask(cache)
        await first
        await ask(cache)  # nothing of who gave up is left

    asyncio.run(both())


def test_one_who_gives_up_leaves_it_to_the_next():
    async def fails(cache):
        async with cache.alone("a", 60.0):
            await asyncio.sleep(0.01)
            raise ConnectionError

    async def makes(cache):
        async with cache.alone("a", 60.0):
            cache.put("a", picture(1))

    async def both():
        cache = PictureCache(10_000)
        first = asyncio.ensure_future(fails(cache))
        await asyncio.gather(first, makes(cache), return_exceptions=True)
        return isinstance(first.exception(), ConnectionError) and cache.get("a") is not None

    assert asyncio.run(both())
