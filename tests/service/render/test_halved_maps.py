from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geometry.tile_layout import TileLayout
from schemas.render import Accuracy, Orbit, OrbitCamera, RenderRequest
from service.measure.errors import shading_of
from service.measure.reference import reference
from service.render.frame import render_frame
from service.render.halved_maps import halved_maps
from tests.service.render.made import clippable

FACES, TEXELS = 37, 256


def layout_and_turns():
    return TileLayout.fitting(FACES, TEXELS), np.arange(FACES, dtype=np.int32) % 3


def maps_of(value):
    """Maps whose texel at barycentric weights (1 - s - t, s, t) of a face is value(face, s, t); nothing sensible between tiles."""
    layout, turns = layout_and_turns()
    normal = np.full((layout.height, layout.width, 3), 7, np.uint8)
    for face in range(FACES):
        for j in range(layout.side + 2):
            for i in range(layout.side + 2 - j):
                if i + j <= layout.side or (i and j):
                    normal[place(layout, face, i, j)] = np.rint(value(face, i / layout.side, j / layout.side))
    return {"tile_uv": layout.tile_uv(turns), "normal": normal}


def place(layout, face, i, j):
    cell = face // 2
    row, column = cell // layout.columns * (layout.side + 2), cell % layout.columns * (layout.side + 3)
    return (row + j, column + i) if face % 2 == 0 else (row + layout.side + 1 - j, column + layout.side + 2 - i)


def lattice(maps, layout, face):
    """{(i, j): texel} of a tile."""
    return {
        (i, j): maps["normal"][place(layout, face, i, j)].astype(int) for j in range(layout.side + 1) for i in range(layout.side + 1 - j)
    }


def test_none_are_the_same_maps():
    maps = maps_of(lambda face, s, t: (1, 2, 3))
    assert halved_maps(maps, 0) == maps


@pytest.mark.parametrize("halvings", [1, 2])
def test_tiles_keep_their_cells_and_their_corners(halvings):
    maps = maps_of(lambda face, s, t: (face, 0, 0))
    layout, turns = layout_and_turns()
    small = layout.halved(halvings)
    made = halved_maps(maps, halvings)
    assert made["normal"].shape == (small.height, small.width, 3)
    assert small.side == pytest.approx(layout.side / 2**halvings, abs=0.5)
    assert np.array_equal(made["tile_uv"], small.tile_uv(turns))
    assert np.array_equal(layout.turns(maps["tile_uv"]), turns)


@pytest.mark.parametrize("halvings", [1, 2])
def test_a_tile_is_filtered_from_its_own_texels_alone(halvings):
    made = halved_maps(maps_of(lambda face, s, t: (5 * face, 255 - face, 90)), halvings)
    small = layout_and_turns()[0].halved(halvings)
    for face in range(FACES):
        assert all(tuple(texel) == (5 * face, 255 - face, 90) for texel in lattice(made, small, face).values())


@pytest.mark.parametrize("halvings", [1, 2])
def test_a_ramp_stays_a_ramp_in_the_middle_and_on_the_sides(halvings):
    made = halved_maps(maps_of(lambda face, s, t: (200 * s, 200 * t, 200 * (1 - s - t))), halvings)
    small = layout_and_turns()[0].halved(halvings)
    for (i, j), texel in lattice(made, small, 4).items():
        expected = 200.0 * np.array([i, j, small.side - i - j]) / small.side
        near_a_side = min(i, j, small.side - i - j) == 1  # the mean is of a part of the neighbours there
        assert np.abs(texel - expected).max() <= (200.0 / small.side if near_a_side else 1.5)


def test_faces_that_share_a_side_agree_along_it():
    """The hypotenuse of one tile and a leg of another with the same texels along them, whatever lies inside."""
    rng = np.random.default_rng(3)
    inside, side = rng.integers(0, 255, 3), lambda x: 100 + 80 * np.sin(7 * x)

    def value(face, s, t):
        if face == 0 and abs(s + t - 1.0) < 1e-9:
            return [side(s)] * 3
        if face == 1 and t == 0.0:
            return [side(s)] * 3
        return inside if face == 0 else 255 - inside

    made = halved_maps(maps_of(value), 1)
    small = layout_and_turns()[0].halved(1)
    hypotenuse, leg = lattice(made, small, 0), lattice(made, small, 1)
    for k in range(1, small.side):
        assert np.abs(hypotenuse[k, small.side - k] - leg[k, 0]).max() <= 1


def test_colours_are_averaged_in_linear_light_by_their_alpha():
    maps = maps_of(lambda face, s, t: (128, 128, 255))
    height, width = maps["normal"].shape[:2]
    color = np.zeros((height, width, 4), np.uint8)
    color[::2] = (255, 255, 255, 255)  # every other row white, between rows of nothing
    made = halved_maps(maps | {"color": color}, 1)["color"]
    small = layout_and_turns()[0].halved(1)
    texels = np.array([made[place(small, 0, i, j)] for j in range(2, small.side - 2) for i in range(2, small.side - 2 - j)])
    assert (texels[:, :3] == 255).all(), "what is transparent has no colour to mix in"
    assert np.abs(texels[:, 3].astype(int) - 128).max() <= 64


def test_small_pictures_are_as_near_to_the_original_with_halved_maps_as_with_full_ones(gpu):
    asset = replace(clippable("bumpy", 400), id="bumpy under 400 faces")  # caches know meshes by their names
    camera = OrbitCamera(orbit=Orbit(azimuth_deg=30.0, elevation_deg=20.0))
    true = reference(gpu, asset, camera, 64)
    errors = []
    for texels in asset.hulls[0].facts.texels:
        request = RenderRequest(camera=camera, width=64, height=64, accuracy=Accuracy(source="clipped", texels=texels))
        sums = shading_of(render_frame(gpu, asset, request).pixels, true)
        errors.append(sums.squares / sums.bytes)
    assert len(errors) == 3
    assert max(errors[1:]) < 1.1 * errors[0]
