from __future__ import annotations

import threading

import pytest

from schemas.errors import BusyError, CapabilityError
from schemas.render import Accuracy, RenderRequest
from service.render import context
from service.render import renderer as renderers
from service.render.context import EglUnavailableError
from service.render.renderer import Renderer
from tests.service.render.made import clippable, unclippable

SMALL = RenderRequest(width=32, height=32)


@pytest.fixture
def renderer():
    renderer = Renderer(queue_depth=3, gpu_cache_mib=16)
    renderer.start()
    yield renderer
    renderer.close()


@pytest.fixture
def held(renderer, monkeypatch):
    """A renderer whose frames wait until the event is set; its first one is under way."""
    started, release, real = threading.Event(), threading.Event(), renderers.render_frame

    def wait_then_render(*args, **options):
        started.set()
        assert release.wait(30)
        return real(*args, **options)

    monkeypatch.setattr(renderers, "render_frame", wait_then_render)
    first = renderer.submit(clippable("sphere"), SMALL)
    assert started.wait(30)
    yield renderer, release, first
    release.set()


def test_frames_are_answered(renderer):
    image = renderer.submit(clippable("sphere"), SMALL).result(60)
    assert image.pixels.shape == (32, 32, 4)
    assert image.rung == "clipped/coverage"
    assert [name for name, _ in image.passes] == list(image.plan)
    assert all(ms >= 0.0 for _, ms in image.passes)


def test_frame_more_than_the_queue_holds_is_refused(held):
    renderer, release, first = held
    waiting = [renderer.submit(clippable("sphere"), SMALL) for _ in range(3)]
    with pytest.raises(BusyError) as caught:
        renderer.submit(clippable("sphere"), SMALL)
    assert caught.value.retry_after_s > 0.0
    release.set()
    assert all(future.result(60).pixels.any() for future in (first, *waiting))


def test_cancelled_frame_is_never_drawn(held):
    renderer, release, first = held
    dropped, kept = (renderer.submit(clippable("sphere"), SMALL) for _ in range(2))
    assert dropped.cancel()
    release.set()
    assert kept.result(60).pixels.any()
    assert dropped.cancelled()
    assert first.result(60).pixels.any()


def test_failing_frame_fails_only_itself(renderer):
    clipped = RenderRequest(width=32, height=32, accuracy=Accuracy(source="clipped"))
    failing = renderer.submit(unclippable(), clipped)
    fine = renderer.submit(clippable("sphere"), clipped)
    with pytest.raises(CapabilityError):
        failing.result(60)
    assert fine.result(60).pixels.any()


def test_unexpected_fault_fails_only_its_frame(renderer, monkeypatch):
    monkeypatch.setattr(renderers, "render_frame", lambda *_, **__: 1 / 0)
    failing = renderer.submit(clippable("sphere"), SMALL)
    with pytest.raises(ZeroDivisionError):
        failing.result(60)
    monkeypatch.undo()
    assert renderer.submit(clippable("sphere"), SMALL).result(60).pixels.any()


def test_closing_cancels_what_waits_and_refuses_what_comes(held):
    renderer, release, first = held
    waiting = renderer.submit(clippable("sphere"), SMALL)
    threading.Timer(0.2, release.set).start()
    renderer.close()
    assert waiting.cancelled()
    assert first.result(1).pixels.any()
    with pytest.raises(BusyError):
        renderer.submit(clippable("sphere"), SMALL)
    renderer.close()


def test_missing_library_is_named_with_the_command_that_installs_it(monkeypatch):
    monkeypatch.setattr(context, "LIBRARIES", {"libNoSuchEGL.so.1": "libegl1"})
    with pytest.raises(EglUnavailableError, match=r"libNoSuchEGL\.so\.1 is missing: apt-get install libegl1"):
        Renderer().start()


def test_context_that_egl_refuses_says_what_to_install(monkeypatch):
    monkeypatch.setattr(context, "LEAST_VERSION", 990)
    with pytest.raises(EglUnavailableError, match=r"apt-get install .*libgl1-mesa-dri"):
        Renderer().start()
