from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import CapabilityError, InvalidRequestError
from schemas.render import Accuracy, Antialias, RenderRequest, Shading, ShadingMode, Source
from service.moving import Moving
from service.render.frame import FRAME, tiles_of
from service.render.plan import plan_frame
from service.rungs import SILHOUETTE, SURFACE
from service.tile import Tile
from tests.service.render.made import clippable, seen_from, unclippable

OUTSIDE = np.array([3.0, 2.0, 4.0, 1.0])
INSIDE = np.array([0.1, 0.0, 0.0, 1.0])


def plan(asset=None, eye=OUTSIDE, mode="lambert", lines=None, fill="shaded", **accuracy):
    request = RenderRequest(accuracy=Accuracy(**accuracy), shading=Shading(mode=mode, fill=fill), lines=lines)
    asset = asset or clippable("sphere")
    return plan_frame(request, asset, seen_from(asset, eye))


def in_order(made):
    return [step.name for step in FRAME if step.name in made.passes]


@pytest.mark.parametrize(
    ("antialias", "rung"),
    [
        ("none", "clipped/none"),
        ("line", "clipped/line"),
        ("coverage", "clipped/coverage"),
        ("msaa", "original/msaa"),
        ("ssaa", "original/ssaa"),
    ],
)
def test_auto_clips_where_the_rung_allows_it(antialias, rung):
    assert plan(antialias=antialias).rung == rung


@pytest.mark.parametrize(
    ("antialias", "rung"),
    [("none", "none"), ("line", "msaa"), ("coverage", "msaa"), ("msaa", "msaa"), ("ssaa", "ssaa")],
)
def test_mesh_without_a_silhouette_falls_to_the_nearest_rung_of_the_original(antialias, rung):
    assert plan(unclippable(), antialias=antialias).rung == f"original/{rung}"
    assert plan(eye=INSIDE, antialias=antialias).rung == f"original/{rung}"


def test_original_takes_the_exact_outline_when_there_is_one():
    assert plan(source="original", antialias="coverage").rung == "original/coverage"


def test_passes_of_each_rung_are_as_documented():
    rest = ["read", "composite"]
    assert in_order(plan(antialias="none")) == ["background", "edges", "loops", "clear", "stencil", "surface", *rest]
    assert in_order(plan(antialias="line")) == [
        "background", "edges", "loops", "segments", "clear", "stencil", "surface", "rim", "interior", "outline", *rest,
    ]  # fmt: skip
    assert in_order(plan(antialias="coverage")) == ["background", "edges", "segments", "hull", "surface", "rim", "coverage", "composite"]
    assert in_order(plan(antialias="msaa")) == ["background", "clear", "surface", "resolve", *rest]
    assert in_order(plan(antialias="none", source="original")) == ["background", "clear", "surface", *rest]


def test_resolving_is_all_that_supersampling_adds():
    assert plan(antialias="ssaa").passes - plan(antialias="none", source="original").passes == {"resolve"}


def test_exact_outline_adds_exactly_its_passes():
    plain, outlined = plan(antialias="none", source="original"), plan(antialias="coverage", source="original")
    assert outlined.passes - plain.passes == {"edges", "segments", "coverage", "rim"}


def test_only_the_clipped_hull_under_an_exact_mask_is_drawn_without_the_gl():
    for source, antialias in SURFACE:
        made = plan(source=source, antialias=antialias)
        assert made.on_cpu == (made.rung == "clipped/coverage")
        assert made.on_cpu == (not made.passes & {"clear", "read"})


def test_lines_add_exactly_their_passes():
    assert plan(antialias="line").passes - plan(antialias="none").passes == {"segments", "outline", "interior", "rim"}


def test_mode_changes_no_pass_unless_it_needs_no_surface():
    assert plan(mode="normal").passes == plan().passes
    assert plan(mode="mask").passes == {"background", "edges", "segments", "coverage", "composite"}
    assert plan(mode="mask", antialias="none").passes == plan(antialias="none").passes - {"surface"} | {"interior"}


def test_every_pass_is_in_some_plan_and_every_plan_in_the_frame():
    names = [step.name for step in FRAME]
    assert len(set(names)) == len(names)
    used = {
        name
        for mode in ShadingMode
        for a in Antialias
        for s in ("auto", "original")
        for name in plan(mode=mode, antialias=a, source=s).passes
    }
    lined = ({"method": "fattened", "charcoal": True, "orientation": "any", "ridge": {}}, {"method": "strokes"}, {})
    asset = clippable("sphere")
    moved = Moving(asset).at(asset.frame.to_model(asset.positions))
    drawn = [plan(lines=lines).passes for lines in lined]
    assert used.union(plan(smooth=True).passes, plan(moved).passes, *drawn) == set(names)


def test_clipping_can_be_insisted_on():
    with pytest.raises(CapabilityError, match="boundary"):
        plan(unclippable(), source="clipped")
    with pytest.raises(CapabilityError, match="inside"):
        plan(eye=INSIDE, source="clipped")
    with pytest.raises(InvalidRequestError):
        plan(source="clipped", antialias="ssaa")


def test_eye_counts_as_outside_as_soon_as_it_leaves_the_convex_hull():
    asset = clippable("torus")
    hole = np.array([0.0, 0.0, 0.0, 1.0])
    assert plan(asset, hole, antialias="none").source is Source.ORIGINAL
    top = float(asset.hull["positions"][:, 2].max())
    for height, source in ((0.9 * top, Source.ORIGINAL), (top + 1e-4, Source.CLIPPED)):
        assert plan(asset, np.array([0.0, 0.0, height, 1.0]), antialias="none").source is source


def test_orthographic_eye_is_always_outside():
    assert plan(eye=np.array([0.0, 0.0, 1.0, 0.0])).source is Source.CLIPPED


def test_back_faces_are_drawn_only_where_they_can_be_seen():
    assert plan(source="original", antialias="none").closed
    assert not plan(eye=INSIDE, antialias="none").closed
    assert not plan(unclippable(), antialias="none").closed


def test_tables_name_rungs_of_the_contract_only():
    assert {antialias for _, antialias in SURFACE} == set(Antialias) - {Antialias.AUTO}
    assert set(SILHOUETTE) == {antialias for source, antialias in SURFACE if source is Source.CLIPPED}


@settings(deadline=None)  # the shapes are made once
@given(st.integers(0, 5000), st.integers(0, 5000), st.integers(1, 5000), st.integers(1, 5000), st.sampled_from(["none", "msaa", "ssaa"]))
def test_tiles_cover_the_area_once(x, y, width, height, antialias):
    made = plan(antialias=antialias, source="original")
    tiles = tiles_of(made, Tile(x, y, width, height))
    assert sum(t.width * t.height for t in tiles) == width * height
    assert min(t.x for t in tiles) == x
    assert max(t.x + t.width for t in tiles) == x + width
    assert max(t.y + t.height for t in tiles) == y + height
    assert max(max(t.width, t.height) for t in tiles) * made.sample_grid <= 2048
    assert not tiles_of(made, Tile(x, y, 0, 0))
