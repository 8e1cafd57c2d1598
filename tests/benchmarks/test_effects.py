"""The page of line effects: each has its picture, and nothing that can be asked of lines is without one."""

import json
import re
import subprocess
import sys
from pathlib import Path

from benchmarks.effects import EFFECTS
from schemas.lines import LineMethod
from schemas.render import Fill

ROOT = Path(__file__).resolve().parents[2]


def test_a_run_writes_the_page_with_all_its_pictures(tmp_path):
    command = [sys.executable, "-m", "benchmarks.effects", "--out", str(tmp_path), "--rounds", "1", "--json"]
    rows = json.loads(subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout)["effects"]
    assert [row["name"] for row in rows] == [effect.name for effect in EFFECTS]
    shown = re.findall(r"\]\((images/effects/[a-z_]+\.(?:png|svg))\)", (tmp_path / "effects.md").read_text())
    assert shown == [row["picture"] for row in rows] and all((tmp_path / path).stat().st_size > 500 for path in shown)
    assert all(row["passes"] for row in rows if row["name"] != "lines_alone")


def test_every_method_fill_and_pull_has_a_picture():
    asked = [effect.asked for effect in EFFECTS if not effect.vector]
    assert {one["lines"].get("method", "edge_mesh") for one in asked} == {method.value for method in LineMethod}
    assert {one.get("shading", {}).get("fill", "shaded") for one in asked} == {fill.value for fill in Fill}
    assert {one["lines"]["pull"]["by"] for one in asked if "pull" in one["lines"]} == {"z", "fixed", "offset"}


def test_the_page_in_the_docs_is_of_these_effects():
    page = (ROOT / "docs" / "effects.md").read_text()
    shown = re.findall(r"\]\((images/effects/[a-z_]+\.(?:png|svg))\)", page)
    assert [Path(path).stem for path in shown] == [effect.name for effect in EFFECTS]
    assert all((ROOT / "docs" / path).is_file() for path in shown)
