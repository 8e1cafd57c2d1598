"""The plot: well-formed, inside its card, every rung in it, no label over another."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import pytest

from schemas.ladder import Front
from service.accuracy.plot import MOST_NAMED, STYLES, accuracy_svg
from service.accuracy.report import accuracy_report
from service.rungs import SURFACE
from tests.service.accuracy.ladders import ID, a_ladder, a_report, changed

SVG = "{http://www.w3.org/2000/svg}"
COUNTS = [1, 6, 40, 184]


def drawn(report, faces=None):
    return ET.fromstring(accuracy_svg(report, faces))


def words(root):
    return [node.text for node in root.iter(f"{SVG}text")]


def badges(root):
    """(x, y) of the middles of the dark pills that hold numbers."""
    pills = [node for node in root.iter(f"{SVG}rect") if node.get("rx") == "7"]
    return [(float(node.get("x")) + 10.0, float(node.get("y")) + 7.0) for node in pills]


@pytest.mark.parametrize("count", COUNTS)
def test_every_rung_is_in_both_panels_with_its_numbers(count):
    report = a_report(count)
    titles = [node.text for node in drawn(report).iter(f"{SVG}title")]
    assert len(titles) == 2 * len(report.rungs)
    for rung in report.rungs:
        assert sum(title.startswith(f"{rung.name}: ") and f"{rung.psnr_db:.1f} dB" in title for title in titles) == 2


@pytest.mark.parametrize("count", COUNTS)
def test_numbers_do_not_hide_each_other(count):
    places = badges(drawn(a_report(count)))
    assert len(places) >= 4
    for i, (x, y) in enumerate(places):
        assert all(abs(x - a) >= 20.0 or abs(y - b) >= 14.0 for a, b in places[:i])


@pytest.mark.parametrize("count", COUNTS)
def test_everything_is_inside_the_card(count):
    root = drawn(a_report(count, name="W" * 300))
    width, height = float(root.get("width")), float(root.get("height"))
    for node in root.iter(f"{SVG}circle"):
        assert 0.0 < float(node.get("cx")) < width
        assert 0.0 < float(node.get("cy")) < height
    for node in root.iter(f"{SVG}text"):
        assert 0.0 < float(node.get("x")) < width
        assert 0.0 < float(node.get("y")) < height
    assert max(len(text) for text in words(root)) < 140


def test_a_front_of_many_rungs_has_numbers_for_some_and_a_line_for_all():
    report = a_report(184)
    everything = sorted(range(184), key=lambda n: report.rungs[n].ms)
    root = drawn(report.model_copy(update={"pareto": Front(outline=everything, shading=everything)}))
    assert len(badges(root)) == 4 * MOST_NAMED, "in each panel and in each table"
    assert all(path.get("d").count("V") == 183 for path in list(root.iter(f"{SVG}path"))[:2])


def test_an_error_of_nought_has_a_tick_of_its_own_below_all_others():
    exact = accuracy_report(ID, "one", changed(a_ladder(6), 5, alpha_error=0.0), None, None, {})
    assert words(drawn(exact)).count("0") == 2, "the tick, and its row in the table"
    assert "0" not in words(drawn(a_report(6)))


def test_head_says_what_was_measured_of_what_and_where():
    text = " ".join(words(drawn(a_report(6, name="a <knot> & co.ply"), 185_856)))
    for said in (
        "a <knot> & co.ply",
        "185,856 faces",
        "512 × 512",
        "12 views",
        "256 samples",
        "measured on a device",
        "milliseconds",
        "dB",
    ):
        assert said in text
    times = [1.0 + n for n in range(6)]
    elsewhere = a_report(6, device="fast", predicted={"fast": {256: times, 512: times}})
    assert "Times predicted on fast" in words(drawn(elsewhere))


def test_every_way_of_drawing_has_a_marker_and_the_key_has_those_that_occur():
    assert {f"{source.value}/{antialias.value}" for source, antialias in SURFACE} == set(STYLES)
    assert "clipped/line" in words(drawn(a_report(40)))
    assert "clipped/line" not in words(drawn(a_report(4)))


def test_plot_needs_nothing_else():
    text = accuracy_svg(a_report(100))
    assert re.findall(r"(?:href|url\(|@import|<script|<style|<image)", text) == []
    assert text.count("http") == 1, "the name space"
