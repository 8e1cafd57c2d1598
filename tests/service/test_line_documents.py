"""Lines as JSON, arrays, SVG and DXF, read back by other means."""

import json
import re
import xml.etree.ElementTree as ElementTree
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from safetensors.numpy import load

from geometry.topology import build_edges
from schemas.errors import CapabilityError, InvalidRequestError
from schemas.lines import LineKind
from schemas.mesh import Capability
from schemas.render import ProjectTo, Silhouette, SilhouetteRequest
from service.silhouette.describe import describe_silhouette
from service.silhouette.document import silhouette_binary, silhouette_dxf, silhouette_json, silhouette_svg
from service.silhouette.line_mesh import LineMesh
from service.silhouette.lines import KINDS
from service.silhouette.strokes import outlines_of
from tests import meshes
from tests.service.stroke_oracles import polygons_of
from tests.service.test_lines import crossing_cubes, grid

SVG = "{http://www.w3.org/2000/svg}"
ALL = list(LineKind)


def source(mesh, closed=True):
    positions, faces, frame = meshes.normalised(mesh)
    table = build_edges(faces) if closed else None
    return SimpleNamespace(
        frame=frame,
        positions=positions,
        faces=faces,
        edges=(table.vertices, table.faces) if table else None,
        tree=None,
        radius=1.0,
        clip=Capability(available=closed, reason=None if closed else "it has holes"),
        line_mesh=LineMesh(positions, faces),
    )


CUBES = source(crossing_cubes())
SHEET = source(grid(), closed=False)


def asked(**fields):
    return SilhouetteRequest(project=ProjectTo(width=300, height=200), **fields)


def tags_of(dxf):
    """(code, value) pairs of a DXF."""
    rows = dxf.decode("ascii").split("\n")
    assert rows.pop() == "" and len(rows) % 2 == 0
    return [(int(code), value) for code, value in zip(rows[::2], rows[1::2], strict=True)]


def widths_of(tags):
    """[(start, end), ...] of every vertex, by the rules of release 12."""
    found, mode = [], None
    for code, value in tags:
        if code == 0:
            mode = value
        elif mode == "VERTEX" and code in (40, 41):
            found.append(float(value))
    return list(zip(found[::2], found[1::2], strict=True))


def polylines_of(tags):
    """[(layer, closed, points)] of the entities, by the rules of release 12."""
    found, mode = [], None
    for code, value in tags:
        if code == 0:
            mode = value
            if value == "POLYLINE":
                found.append(["", False, []])
            elif value == "VERTEX":
                found[-1][2].append([0.0, 0.0])
        elif mode == "POLYLINE" and code == 8:
            found[-1][0] = value
        elif mode == "POLYLINE" and code == 70:
            found[-1][1] = bool(int(value) & 1)
        elif mode == "VERTEX" and code in (10, 20):
            found[-1][2][-1][code // 10 - 1] = float(value)
    return found


def test_json_has_lines_as_documented():
    described = describe_silhouette(CUBES, asked(kinds=ALL))
    answer = json.loads(silhouette_json(described))
    model = Silhouette.model_validate(answer)
    lines = described.lines
    assert len(model.lines) == len(lines) > 5
    for line, kind, visible, closed, points in zip(model.lines, lines.kinds, lines.visible, lines.closed, lines.polylines(), strict=True):
        assert (line.kind, line.visible, line.closed) == (KINDS[kind], visible, closed)
        assert np.abs(np.array(line.points) - points).max() <= 5e-5
        assert len(line.vertices) == len(line.points)
    assert {line.visible for line in model.lines} == {True, False}
    assert None in [v for line in model.lines for v in line.vertices]
    assert model.edge_count == len(model.edges) and model.contours


def test_lines_come_by_kind_visible_ones_first():
    lines = describe_silhouette(CUBES, asked(kinds=ALL)).lines
    order = list(zip(lines.kinds.tolist(), (~lines.visible).tolist(), strict=True))
    assert order == sorted(order)


def test_answers_without_lines_have_none():
    answer = json.loads(silhouette_json(describe_silhouette(CUBES, asked(ridge_deg=10.0, line_width={"ridge": 2.0}))))
    assert "lines" not in answer
    plain = describe_silhouette(CUBES, asked())
    assert not [name for name in load(silhouette_binary(plain)) if name.startswith("line")]


def test_a_mesh_that_is_not_closed_has_lines_and_without_them_still_no_silhouette():
    aside = {"orbit": {"azimuth_deg": 75.0, "elevation_deg": 15.0}}
    answer = json.loads(silhouette_json(describe_silhouette(SHEET, asked(camera=aside, kinds=["silhouette", "boundary"]))))
    assert "contours" not in answer
    assert {line["kind"] for line in answer["lines"]} == {"silhouette", "boundary"}
    assert answer["edge_count"] == len(answer["edges"]) > 0
    with pytest.raises(CapabilityError, match="it has holes"):
        describe_silhouette(SHEET, asked())


def test_silhouette_edges_of_an_open_mesh_are_those_of_the_closed_one_away_from_its_hole():
    mesh = meshes.sphere(2)
    whole = describe_silhouette(source(mesh), asked(visible_only=True)).edges
    hole = int(np.argmin(mesh[0][mesh[1]].mean(axis=1)[:, 2]))
    cut = describe_silhouette(source((mesh[0], np.delete(mesh[1], hole, axis=0)), closed=False), asked(visible_only=True)).edges
    missing = {tuple(e) for e in whole.tolist()} ^ {tuple(e) for e in cut.tolist()}
    assert all(set(e) <= set(mesh[1][hole].tolist()) for e in missing)


def test_binary_holds_the_same_lines():
    described = describe_silhouette(CUBES, asked(kinds=ALL))
    tensors = load(silhouette_binary(described))
    assert np.array_equal(tensors["line_points"], described.lines.points)
    assert np.array_equal(tensors["line_vertices"], described.lines.vertices)
    assert tensors["line_offsets"][-1] == len(tensors["line_points"])
    assert np.array_equal(tensors["line_kinds"], described.lines.kinds)
    assert np.array_equal(tensors["line_visible"].astype(bool), described.lines.visible)
    assert np.array_equal(tensors["line_closed"].astype(bool), described.lines.closed)


def test_svg_has_a_group_a_kind_with_hidden_lines_dashed():
    described = describe_silhouette(CUBES, asked(kinds=ALL, line_width={LineKind.RIDGE: 3.5}))
    lines, root = described.lines, ElementTree.fromstring(silhouette_svg(described))
    assert root.attrib["viewBox"] == "0 0 300 200"
    groups = {g.attrib["class"]: g for g in root.iter(SVG + "g") if "class" in g.attrib}
    assert set(groups) == {KINDS[k] for k in lines.kinds}
    assert groups["ridge"].attrib["stroke-width"] == "3.5"
    count = 0
    for name, group in groups.items():
        assert float(group.attrib["stroke-width"]) > 0.0
        for path in group.iter(SVG + "path"):
            visible = path.attrib["class"] == "visible"
            assert ("stroke-dasharray" in path.attrib) == (not visible)
            drawn = re.findall(r"M([^MZ]*)(Z?)", path.attrib["d"])
            numbers = np.flatnonzero((lines.kinds == KINDS.index(name)) & (lines.visible == visible))
            assert len(drawn) == len(numbers)
            for (text, end), number in zip(drawn, numbers, strict=True):
                points = np.array([p.split(",") for p in text.split(" ")], float)
                assert np.abs(points - lines.polylines()[number]).max() <= 0.0051
                assert bool(end) == lines.closed[number]
            count += len(drawn)
    assert count == len(lines)


def test_dxf_has_every_polyline_on_the_layer_of_its_kind():
    described = describe_silhouette(CUBES, asked(kinds=ALL))
    tags, lines = tags_of(silhouette_dxf(described)), described.lines
    sections = [tags[i + 1][1] for i, tag in enumerate(tags) if tag == (0, "SECTION")]
    assert sections == ["HEADER", "TABLES", "ENTITIES"] and tags[-1] == (0, "EOF")
    assert (9, "$ACADVER") in tags and (1, "AC1009") in tags
    declared = {tags[i + 1][1] for i, tag in enumerate(tags) if tag == (0, "LAYER")}
    found = polylines_of(tags)
    assert {layer for layer, _, _ in found} == declared
    for (layer, closed, points), kind, visible, is_closed, expected in zip(
        found, lines.kinds, lines.visible, lines.closed, lines.polylines(), strict=True
    ):
        assert layer == KINDS[kind].upper() + ("" if visible else "_HIDDEN")
        assert closed == is_closed
        assert np.abs(np.array(points) - [0.0, 200.0] - expected * [1.0, -1.0]).max() <= 6e-5


def test_dxf_without_lines_is_refused():
    with pytest.raises(InvalidRequestError) as caught:
        silhouette_dxf(describe_silhouette(CUBES, asked()))
    assert caught.value.where["field"] == "kinds"


def test_smooth_lines_have_no_vertices():
    answer = json.loads(silhouette_json(describe_silhouette(CUBES, asked(visible_only=True, smooth_px=0.5))))
    assert answer["lines"] and not any("vertices" in line for line in answer["lines"])
    assert {line["kind"] for line in answer["lines"]} == {"silhouette"}


STROKE = {"width_by": "depth", "opacity_by": "depth", "least": 0.2, "wobble_px": 1.5, "dash": [9.0, 5.0]}


def test_json_and_binary_have_widths_and_opacities_of_strokes_at_every_point():
    described = describe_silhouette(CUBES, asked(kinds=ALL, stroke=STROKE, line_width={LineKind.RIDGE: 4.0}))
    lines, tensors = described.lines, load(silhouette_binary(described))
    answer = Silhouette.model_validate(json.loads(silhouette_json(described)))
    for line, (a, b), kind, visible in zip(answer.lines, pairwise(lines.offsets.tolist()), lines.kinds, lines.visible, strict=True):
        assert line.vertices is None and len(line.points) == len(line.widths) == len(line.opacities)
        assert np.abs(np.array(line.widths) - lines.widths[a:b]).max() <= 5.1e-4
        assert np.abs(np.array(line.opacities) - lines.opacities[a:b]).max() <= 5.1e-4
        if KINDS[kind] is LineKind.RIDGE:
            assert 0.2 * 4.0 * (1.0 if visible else 0.6) - 1e-3 <= min(line.widths) <= max(line.widths) <= 4.001
    assert np.array_equal(tensors["line_widths"], lines.widths) and np.array_equal(tensors["line_opacities"], lines.opacities)
    assert lines.opacities[np.repeat(~lines.visible, np.diff(lines.offsets))].max() <= 0.55


def test_svg_of_strokes_is_filled_outlines_that_are_those_of_the_lines():
    described = describe_silhouette(CUBES, asked(visible_only=True, stroke={"width_by": "depth", "wobble_px": 2.0}))
    (path,) = ElementTree.fromstring(silhouette_svg(described)).iter(SVG + "path")
    assert path.attrib["stroke"] == "none" and path.attrib["fill"] == "#111111" and "fill-opacity" not in path.attrib
    drawn = [np.array([p.split(",") for p in text.split(" ")], float) for text in re.findall(r"M([^MZ]*)Z", path.attrib["d"])]
    expected = polygons_of(*outlines_of(described.lines, 2.0))
    assert [len(polygon) for polygon in drawn] == [len(polygon) for polygon in expected]
    assert max(np.abs(a - b).max() for a, b in zip(drawn, expected, strict=True)) <= 0.0051


def test_svg_of_strokes_has_a_path_for_each_level_of_opacity_and_hidden_lines_thinner():
    described = describe_silhouette(CUBES, asked(kinds=["silhouette"], stroke={"opacity_by": "depth"}))
    paths = list(ElementTree.fromstring(silhouette_svg(described)).iter(SVG + "path"))
    shown, hidden = ([p for p in paths if p.attrib["class"] == name] for name in ("visible", "hidden"))
    assert 2 <= len(shown) <= 8 and 2 <= len(hidden) <= 8
    assert all(0.0 < float(p.attrib["stroke-opacity"]) < 1.0 for p in paths)
    assert {p.attrib["stroke-width"] for p in hidden} == {"1.2"} and not any("stroke-width" in p.attrib for p in shown)
    assert all(p.attrib["stroke-linecap"] == "butt" and "stroke-dasharray" not in p.attrib for p in hidden)
    assert len(re.findall("M", hidden[0].attrib["d"])) > (~described.lines.visible).sum(), "cut into dashes"


def test_svg_of_strokes_of_one_width_keeps_stroked_paths():
    described = describe_silhouette(CUBES, asked(kinds=["silhouette"], stroke={"dash": [9.0, 5.0], "wobble_px": 1.0}))
    shown, hidden = ElementTree.fromstring(silhouette_svg(described)).iter(SVG + "path")
    if shown.attrib["class"] == "hidden":
        shown, hidden = hidden, shown
    assert shown.attrib["stroke-linecap"] == "butt" and "Z" not in shown.attrib["d"]
    assert len(re.findall("M", shown.attrib["d"])) == described.lines.visible.sum()
    assert hidden.attrib["stroke-opacity"] == "0.55" and "stroke-dasharray" in hidden.attrib


def test_dxf_of_strokes_has_their_widths_at_both_ends_of_every_piece():
    described = describe_silhouette(CUBES, asked(kinds=ALL, stroke=STROKE))
    tags, lines = tags_of(silhouette_dxf(described)), described.lines
    assert [len(points) for _, _, points in polylines_of(tags)] == np.diff(lines.offsets).tolist()
    found = np.array(widths_of(tags))
    for a, b in pairwise(lines.offsets.tolist()):
        assert np.abs(found[a:b, 0] - lines.widths[a:b]).max() <= 5.1e-4
        assert np.abs(found[a : b - 1, 1] - lines.widths[a + 1 : b]).max() <= 5.1e-4
    assert widths_of(tags_of(silhouette_dxf(describe_silhouette(CUBES, asked(kinds=ALL))))) == []


def test_a_view_of_nothing_makes_empty_documents():
    behind = {"eye": [0.0, 0.0, 9.0], "target": [0.0, 0.0, 20.0]}
    described = describe_silhouette(CUBES, asked(camera=behind, kinds=ALL, simplify_px=1.0, smooth_px=1.0))
    assert json.loads(silhouette_json(described))["lines"] == []
    assert list(ElementTree.fromstring(silhouette_svg(described)).iter(SVG + "path")) == []
    assert polylines_of(tags_of(silhouette_dxf(described))) == []
    assert load(silhouette_binary(described))["line_points"].shape == (0, 2)


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"kinds": ["ridge"], "project": None}, "kinds"),
        ({"visible_only": True, "project": None}, "visible_only"),
        ({"kinds": ["ridge"], "smooth": True}, "smooth"),
        ({"visible_only": True, "max_error_px": 1.0}, "max_error_px"),
        ({"stroke": {}}, "stroke"),
    ],
)
def test_what_does_not_go_together_is_named(fields, field):
    request = SilhouetteRequest(**{"project": ProjectTo(), **fields})
    with pytest.raises(InvalidRequestError) as caught:
        describe_silhouette(CUBES, request)
    assert caught.value.where["field"] == field


def test_polylines_follow_one_another_in_the_array_of_points():
    lines = describe_silhouette(CUBES, asked(kinds=ALL)).lines
    assert lines.offsets[0] == 0 and lines.offsets[-1] == len(lines.points)
    assert all(b - a >= 2 for a, b in pairwise(lines.offsets))
