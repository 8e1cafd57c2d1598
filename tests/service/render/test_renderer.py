from __future__ import annotations

import ctypes
import threading
import time

import numpy as np
import pytest

from schemas.errors import BusyError, CapabilityError
from schemas.render import Accuracy, ImageFormat, RenderRequest
from service.render import bands, context
from service.render import renderer as renderers
from service.render.context import EglUnavailableError
from service.render.encode import encode
from service.render.frame import Timed, render_frame
from service.render.renderer import Renderer, patience_s, samples_of
from tests.service.render.made import clippable, unclippable

SMALL = RenderRequest(width=32, height=32)
ORIGINAL = RenderRequest(width=64, height=64, accuracy=Accuracy(source="original", antialias="msaa"))


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


def test_small_picture_comes_encoded_where_that_is_asked_for(renderer):
    sphere = clippable("sphere")
    asked = SMALL.model_copy(update={"format": ImageFormat.PNG})
    image = renderer.submit(sphere, asked, encodes=True).result(60)
    assert image.body == encode(image.pixels, ImageFormat.PNG)
    assert [name for name, _ in image.passes] == [*image.plan, "encode"]
    large, slow = asked.model_copy(update={"width": 800, "height": 800}), asked.model_copy(update={"format": ImageFormat.WEBP})
    others = [renderer.submit(sphere, request, encodes=True).result(60) for request in (large, slow)]
    assert [other.body for other in (*others, renderer.submit(sphere, asked).result(60))] == [None, None, None]


def test_while_others_wait_a_frame_takes_one_thread(held, monkeypatch):
    renderer, release, first = held
    counts = []
    real = bands.side_by_side
    monkeypatch.setattr(bands, "cores", lambda: 2)
    monkeypatch.setattr(bands, "side_by_side", lambda work, count: counts.append(count) or real(work, count))
    large = SMALL.model_copy(update={"width": 256, "height": 256})
    waiting = [renderer.submit(clippable("sphere"), large) for _ in range(2)]
    release.set()
    pictures = [future.result(60).pixels for future in (first, *waiting)][1:]
    assert counts[1:] == [1, 2]
    assert np.array_equal(*pictures)


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


def test_lost_context_is_replaced_and_the_same_picture_comes_out(renderer):
    """What EGL has taken away draws nothing and reports no error: blank pictures must not be handed out as done."""
    before = renderer.submit(clippable("sphere"), ORIGINAL).result(60).pixels
    egl, tries = ctypes.CDLL("libEGL.so.1"), []
    egl.eglGetCurrentDisplay.restype = ctypes.c_void_p

    def lose_then_draw(gpu, true_times):
        tries.append(gpu)
        if len(tries) == 1:
            assert egl.eglMakeCurrent(ctypes.c_void_p(egl.eglGetCurrentDisplay()), None, None, None)
        return render_frame(gpu, clippable("sphere"), ORIGINAL)

    after = renderer.submit_drawing(lose_then_draw).result(60).pixels
    assert np.array_equal(before, after)
    assert tries[0] is not tries[1]
    assert tries[1].costs is tries[0].costs
    assert np.array_equal(before, renderer.submit(clippable("sphere"), ORIGINAL).result(60).pixels)


def test_gl_that_has_no_memory_fails_one_picture_and_no_other(renderer):
    def asks_too_much(gpu, true_times):
        largest = gpu.ctx.info["GL_MAX_TEXTURE_SIZE"]
        kept = [gpu.gl.ctx.texture((largest, largest), 4, dtype="f4") for _ in range(64)]
        gpu.gl.check()
        raise AssertionError(f"{len(kept)} textures of {largest} x {largest} were to be had")

    with pytest.raises(BusyError, match="GL"):
        renderer.submit_drawing(asks_too_much).result(120)
    assert renderer.submit(clippable("sphere"), ORIGINAL).result(60).pixels.any()


def test_drawing_that_is_cancelled_ends_at_the_next_pass(renderer):
    begun, passes = threading.Event(), []

    def draw(gpu, true_times):
        times = Timed(gpu, true_times)
        begun.set()
        for number in range(2000):
            times.run("pass", lambda _: time.sleep(0.005), None)
            passes.append(number)
        raise AssertionError("it went on to the end")

    drawing = renderer.submit_drawing(draw)
    assert begun.wait(30)
    assert not drawing.cancel()
    with pytest.raises(BusyError):
        drawing.result(60)
    assert len(passes) < 2000
    assert renderer.submit(clippable("sphere"), SMALL).result(60).pixels.any()


def test_frame_whose_time_is_up_before_its_turn_is_not_drawn():
    renderer, gate, drawn = Renderer(queue_depth=3, gpu_cache_mib=16, limit_s=0.05), threading.Event(), []
    renderer.start()
    try:
        first = renderer.submit_drawing(lambda gpu, _: gate.wait(30) and render_frame(gpu, clippable("sphere"), SMALL))
        late = renderer.submit_drawing(lambda *_: drawn.append(1))
        time.sleep(0.1)
        gate.set()
        for future in (first, late):
            with pytest.raises(BusyError, match="in time"):
                future.result(60)
        assert not drawn
    finally:
        renderer.close()


def test_clients_take_turns_and_the_longest_line_makes_room(held):
    renderer, release, _ = held
    order = []

    def noted(name):
        return lambda gpu, _: order.append(name) or renderers.render_frame(gpu, clippable("sphere"), SMALL)

    crowd = [renderer.submit_drawing(noted(f"crowd {n}"), "crowd") for n in range(3)]
    one = renderer.submit_drawing(noted("one"), "one")
    with pytest.raises(BusyError) as refused:
        crowd[2].result(1)
    assert refused.value.retry_after_s > 0.0
    release.set()
    assert all(future.result(60).pixels.any() for future in (*crowd[:2], one))
    assert order == ["crowd 0", "one", "crowd 1"]


def test_small_pictures_pass_large_ones_that_have_not_waited_long(held):
    renderer, release, _ = held
    order = []

    def noted(name):
        return lambda gpu, _: order.append(name) or renderers.render_frame(gpu, clippable("sphere"), SMALL)

    sizes = {"large": 4096**2, "small": 64**2, "middle": 1024**2}
    waiting = [renderer.submit_drawing(noted(name), "one", samples) for name, samples in sizes.items()]
    release.set()
    assert all(future.result(60).pixels.any() for future in waiting)
    assert order == ["small", "middle", "large"]


def test_no_picture_is_so_large_that_others_pass_it_until_its_time_is_up():
    assert patience_s(0.01, 30.0) == pytest.approx(0.1)
    assert patience_s(100.0, 30.0) < 30.0 / 2


def test_samples_are_those_that_antialiasing_takes():
    def samples(**fields):
        return samples_of(RenderRequest(width=100, height=50, **fields))

    assert samples() == 5000
    assert samples(lines={}) == samples(accuracy={"antialias": "msaa"}) == 4 * 5000
    assert samples(accuracy={"antialias": "ssaa"}) == 16 * 5000
    assert samples(lines={}, accuracy={"antialias": "none"}) == 5000


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
