"""Sequences frame by frame with a renderer of their own: turns for others, and nothing left behind however they end."""

import asyncio
import io
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from starlette.requests import ClientDisconnect, Request

from schemas.errors import BusyError, InvalidRequestError
from schemas.render import RenderRequest
from schemas.sequence import SequenceFormat, SequenceRequest
from service.access.caller import Caller, set_caller
from service.animation import animation, durations_ms
from service.render import renderer as renderers
from service.render.renderer import Renderer
from service.sequence import Drawing
from service.slots import Slots
from tests import meshes
from tests.service.render.moved import bent, read

LINED = {"width": 48, "height": 40, "lines": {"ridge": {}}}


@pytest.fixture
def parts():
    """What drawing takes of a service: a renderer that two frames may wait for, and slots."""
    renderer, cpu = Renderer(queue_depth=2, gpu_cache_mib=16), Slots(2, 4, "test")
    renderer.start()
    yield SimpleNamespace(renderer=renderer, cpu=cpu, settings=SimpleNamespace(render_timeout_s=20.0))
    renderer.close()
    cpu.close()


def request(leaves=None):
    """A request whose client leaves when the event is set, or never."""

    async def receive():
        while leaves is None or not leaves.is_set():
            await asyncio.sleep(0.005)
        return {"type": "http.disconnect"}

    connection = {"type": "http", "headers": []}
    set_caller(connection, Caller())
    return Request(connection, receive)


def drawn(parts, asset, wanted, poses, leaves=None):
    return asyncio.run(Drawing(request(leaves), parts, asset, wanted, poses).frames(SequenceFormat.ZIP))


def kept(parts):
    """How many things the renderer keeps in the GL."""
    found = []

    def look(gpu, _):
        found.append(len(gpu.cache))
        return SimpleNamespace(passes=())

    parts.renderer.submit_drawing(look).result(20)
    return found[0]


def poses_of(vertices, count):
    return np.stack([bent(vertices, 0.2 * number) for number in range(count)])


@pytest.fixture
def ball():
    return read(meshes.bumpy_sphere(2, 0.4))


def test_a_sequence_leaves_only_the_mesh_at_rest(parts, ball):
    asset, vertices = ball
    found = drawn(parts, asset, SequenceRequest(**LINED), poses_of(vertices, 4))
    assert len(found.pictures) == 4 == len(set(found.pictures))
    assert kept(parts) == 1, "its edge mesh, for the next time"
    parts.renderer.submit_once(asset, RenderRequest(**LINED)).result(20)
    assert kept(parts) == 0


def test_a_frame_that_fails_leaves_nothing(parts, ball):
    asset, vertices = ball
    poses = poses_of(vertices, 5)
    poses[3, 7, 1] = np.nan
    with pytest.raises(InvalidRequestError) as refused:
        drawn(parts, asset, SequenceRequest(**LINED), poses)
    assert refused.value.message.startswith("frame 3: 1 of 162 positions are not finite")
    assert kept(parts) == 1
    with pytest.raises(InvalidRequestError, match="hull"):
        drawn(parts, asset, SequenceRequest(width=32, accuracy={"source": "clipped"}), poses[:2])
    assert kept(parts) == 1


def test_a_client_that_leaves_ends_the_sequence_and_leaves_nothing(parts, ball, monkeypatch):
    asset, vertices = ball
    leaves, frames, real = threading.Event(), [], renderers.render_frame

    def counted(*args, **options):
        frames.append(args)
        if len(frames) == 3:
            leaves.set()
        return real(*args, **options)

    monkeypatch.setattr(renderers, "render_frame", counted)
    with pytest.raises(ClientDisconnect):
        drawn(parts, asset, SequenceRequest(width=400, height=400, lines={}), poses_of(vertices, 300), leaves)
    assert kept(parts) == 1
    assert 3 <= len(frames) < 100


def test_others_have_their_turns_and_the_sequence_waits_for_its_own(parts, ball, monkeypatch):
    asset, vertices = ball
    begun, over, order, real = threading.Event(), threading.Event(), [], renderers.render_frame

    def noted(gpu, mesh, *args, **options):
        order.append(mesh is asset)
        begun.set()
        return real(gpu, mesh, *args, **options)

    def others():
        begun.wait(20)
        while not over.is_set():
            try:
                parts.renderer.submit(asset, RenderRequest(width=32, height=32)).result(20)
            except BusyError:
                continue

    monkeypatch.setattr(renderers, "render_frame", noted)
    crowd = [threading.Thread(target=others) for _ in range(2)]
    for one in crowd:
        one.start()
    try:
        found = drawn(parts, asset, SequenceRequest(width=32, height=32), poses_of(vertices, 12))
    finally:
        over.set()
        for one in crowd:
            one.join()
    assert len(found.pictures) == 12 == order.count(False)
    assert order.count(True) >= 6
    assert not any(order[n : n + 4] == [False] * 4 for n in range(4, 9)), "one frame of a sequence waits at a time"


def test_frames_are_drawn_as_pictures_by_themselves(parts, ball):
    asset, _ = ball
    wanted = SequenceRequest(turn={"frames": 3, "degrees": -90}, **LINED)
    found = drawn(parts, asset, wanted, None)
    for number, picture in enumerate(found.pictures):
        camera = {"orbit": {"azimuth_deg": 30 - 30 * number, "elevation_deg": 20}}
        alone = parts.renderer.submit(asset, RenderRequest(camera=camera, **LINED)).result(20)
        assert np.array_equal(np.asarray(Image.open(io.BytesIO(picture))), alone.pixels)
    assert found.summed.rung == "original/msaa"
    assert dict(found.summed.passes).keys() >= {"surface", "edge_mesh", "encode"}


@pytest.mark.parametrize("fps", [0.1, 1.0, 24.0, 29.97, 60.0, 100.0])
def test_frames_last_as_long_as_the_rate_says(fps):
    lasts = durations_ms(250, fps)
    assert abs(sum(lasts) - 250_000.0 / fps) <= 1.0
    assert max(lasts) - min(lasts) <= 1


@pytest.mark.parametrize("form", [SequenceFormat.APNG, SequenceFormat.WEBP])
@pytest.mark.parametrize("size", [(1, 1), (37, 20), (200, 3)])
def test_animations_hold_their_frames_unchanged(form, size):
    rng = np.random.default_rng(0)
    images = [Image.fromarray(rng.integers(0, 256, (size[1], size[0], 4), np.uint8)) for _ in range(3)]
    pictures = []
    for image in images:
        out = io.BytesIO()
        image.save(out, "PNG" if form is SequenceFormat.APNG else "WEBP", lossless=True, exact=True)
        pictures.append(out.getvalue())
    film = Image.open(io.BytesIO(animation(pictures, form, 10.0, 2)))
    assert (film.n_frames, film.size, film.info["loop"]) == (3, size, 2)
    for number, image in enumerate(images):
        film.seek(number)
        assert np.array_equal(np.asarray(film.convert("RGBA")), np.asarray(image))
        assert film.info["duration"] == 100.0
