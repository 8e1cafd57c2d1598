"""A picture of every line effect with what it costs: docs/effects.md and its pictures.

    python -m benchmarks.effects [--out docs] [--rounds 40] [--json]

The meshes are generated: a knot of 25,600 faces, and a slab with three holes. Cost is the median of frames with the effect, less that of
the same frames without, which take turns; both 512 x 512, with 4 samples a pixel, from the resolved request to pixels in memory. Vector
lines cost what finding and writing them takes, once the mesh has been looked at.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image

from benchmarks.lines import loaded
from benchmarks.machine import machine, sentence
from benchmarks.report import Result, markdown_table, number
from client.shapes import three_holed_torus, torus_knot, write_ply
from schemas.render import RenderRequest, SilhouetteRequest
from schemas.scene import SceneRequest
from service.assets import MeshAsset
from service.render.frame import RenderedImage, render_frame
from service.render.state import Gpu
from service.scene.draw import draw_scene
from service.scene.plan import plan_scene
from service.silhouette.describe import describe_silhouette
from service.silhouette.document import silhouette_svg

MESHES: dict[str, Callable[[], Any]] = {"knot": lambda: torus_knot(400, 32), "slab": lambda: three_holed_torus(0)}
CAMERA = {
    "knot": {"orbit": {"azimuth_deg": 30, "elevation_deg": 20}},
    "slab": {"orbit": {"azimuth_deg": 25, "elevation_deg": 35, "fov_y_deg": 25}},
    "both": {"orbit": {"azimuth_deg": 20, "elevation_deg": 25}},
}
SIDE, SHOWN = 512, 300
DOCS = Path(__file__).resolve().parents[1] / "docs"
RED, BLUE = {"color": "#b03020"}, {"color": "#2050b0"}


Draw = Callable[[], RenderedImage]


class Effect(NamedTuple):
    """A picture. asked: fields of a RenderRequest, of a SilhouetteRequest for vector lines, or of a SceneRequest where it has objects."""

    name: str
    mesh: str
    says: str
    asked: dict[str, Any]
    vector: bool = False


EFFECTS = (
    Effect("edge_mesh", "knot", "Silhouettes by the edge mesh", {"lines": {"method": "edge_mesh"}}),
    Effect("ridges", "slab", "Ridges and valleys in colours", {"lines": {"silhouette": {"width": 3}, "ridge": RED, "valley": BLUE}}),
    Effect("translucent", "slab", "Wide translucent lines", {"lines": {"silhouette": {"width": 8, "opacity": 0.4}, "ridge": RED}}),
    Effect("distance", "knot", "Widths that follow the distance", {"lines": {"silhouette": {"width": 4}, "scale": "distance"}}),
    Effect("wireframe", "knot", "Back faces as wires", {"lines": {"method": "wireframe", "silhouette": {"width": 3}}}),
    *(
        Effect(f"pulled_{by}", "slab", f"Back faces pulled forward {how}", {"lines": {"method": "translated", "pull": pull}})
        for by, how, pull in (
            ("z", "by a share of the distance", {"by": "z", "amount": 0.01}),
            ("fixed", "by a fixed distance", {"by": "fixed", "amount": 0.05}),
            ("offset", "by their slopes", {"by": "offset", "amount": 8}),
        )
    ),
    Effect("fattened", "knot", "Fattened back faces: one width", {"lines": {"method": "fattened", "silhouette": {"width": 4}}}),
    Effect("charcoal", "knot", "Charcoal", {"lines": {"method": "fattened", "charcoal": True}}),
    Effect(
        "turned_any_way",
        "slab",
        "Faces turned any way: the nearest layer is found by numbers",
        {"lines": {"method": "fattened", "orientation": "any", "ridge": RED}},
    ),
    Effect(
        "broad_pen",
        "knot",
        "Strokes of a broad pen, with a wobble",
        {
            "lines": {"method": "strokes", "silhouette": {"width": 7}, "stroke": {"width_by": "angle", "least": 0.15, "wobble_px": 2}},
            "shading": {"fill": "white"},
        },
    ),
    Effect(
        "pencil",
        "knot",
        "Strokes that follow depth and curvature",
        {
            "lines": {
                "method": "strokes",
                "silhouette": {"width": 6},
                "stroke": {"width_by": "curvature", "opacity_by": "depth", "wobble_px": 3},
            },
            "shading": {"fill": "none"},
        },
    ),
    Effect(
        "sketch",
        "slab",
        "Strokes wide near the eye, ridges in another colour",
        {
            "lines": {
                "method": "strokes",
                "silhouette": {"width": 5},
                "ridge": RED | {"width": 4},
                "stroke": {"width_by": "depth", "wobble_px": 3},
            },
            "shading": {"fill": "white"},
        },
    ),
    Effect(
        "dashed",
        "slab",
        "Dashed strokes",
        {"lines": {"method": "strokes", "silhouette": {"width": 3}, "ridge": BLUE, "stroke": {"dash": [14, 6, 3, 6]}}},
    ),
    Effect("white", "slab", "Over white", {"lines": {"ridge": {}}, "shading": {"fill": "white"}}),
    Effect("lines_alone", "knot", "Lines alone, on a transparent picture", {"lines": {}, "shading": {"fill": "none"}}),
    *(
        Effect(mode, mesh, f"Shading: {mode}", {"lines": {}, "shading": {"mode": mode}})
        for mode, mesh in (("gooch", "knot"), ("flat", "slab"), ("depth", "knot"), ("matcap", "knot"))
    ),
    Effect(
        "scene",
        "both",
        "Lines in scenes, some of an object's own",
        {
            "lines": {"silhouette": {"width": 3}, "ridge": {}},
            "objects": [
                {"mesh": "knot", "transform": {"translate": [0, 2, 0], "scale": 0.9}},
                {"mesh": "slab", "transform": {"rotate": {"axis": [1, 0, 0], "angle_deg": 90}}, "lines": {"ridge": RED}},
            ],
        },
    ),
    Effect(
        "visible",
        "slab",
        "Visible vector lines, SVG",
        {"kinds": ["silhouette", "ridge", "valley"], "visible_only": True},
        vector=True,
    ),
    Effect("hidden", "slab", "Hidden ones dashed", {"kinds": ["silhouette", "ridge", "valley"]}, vector=True),
    Effect("smooth", "knot", "Rounded within a pixel", {"visible_only": True, "smooth_px": 1.0}, vector=True),
    Effect(
        "ink",
        "knot",
        "Ink: widths by curvature, with a wobble, SVG",
        {
            "visible_only": True,
            "simplify_px": 0.5,
            "smooth_px": 0.5,
            "line_width": {"silhouette": 5},
            "stroke": {"width_by": "curvature", "least": 0.2, "wobble_px": 1.5},
        },
        vector=True,
    ),
)


def drawings(gpu: Gpu, assets: dict[str, MeshAsset], effect: Effect) -> tuple[Draw, Draw]:
    """The picture with the effect and that without."""
    accuracy = {"source": "original", "antialias": "msaa"}
    common = {"camera": CAMERA[effect.mesh], "width": SIDE, "height": SIDE, "accuracy": accuracy}
    if "objects" in effect.asked:
        scenes = [SceneRequest.model_validate(common | fields) for fields in (effect.asked, effect.asked | {"lines": None})]
        scenes[1] = scenes[1].model_copy(update={"objects": [item.model_copy(update={"lines": None}) for item in scenes[1].objects]})
        plans = [plan_scene(scene, [assets[item.mesh] for item in scene.objects]) for scene in scenes]
        return lambda: draw_scene(gpu, plans[0]), lambda: draw_scene(gpu, plans[1])
    asset, wanted, plain = assets[effect.mesh], RenderRequest.model_validate(common | effect.asked), RenderRequest.model_validate(common)
    return lambda: render_frame(gpu, asset, wanted), lambda: render_frame(gpu, asset, plain)


def drawn(gpu: Gpu, assets: dict[str, MeshAsset], effect: Effect, rounds: int, path: Path) -> tuple[float, str]:
    """(milliseconds that the effect adds, its passes); writes the picture."""
    wanted, plain = drawings(gpu, assets, effect)
    times: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(rounds):
        for lined in (True, False):
            times[lined].append((wanted if lined else plain)().ms)
    picture = wanted()
    background = Image.new("RGBA", (SIDE, SIDE), "white")
    background.alpha_composite(Image.fromarray(picture.pixels))
    background.convert("RGB").resize((SHOWN, SHOWN), Image.Resampling.LANCZOS).save(path, optimize=True)
    others = dict(plain().passes)
    passes = [name for name, _ in picture.passes if name not in others]
    return statistics.median(times[True]) - statistics.median(times[False]), ", ".join(passes)


def written(asset: MeshAsset, effect: Effect, rounds: int, path: Path) -> tuple[float, str]:
    """(milliseconds that finding and writing the lines takes, its steps); writes the drawing."""
    fields = {"camera": CAMERA[effect.mesh], "project": {"width": SHOWN, "height": SHOWN}, "contours": False}
    wanted = SilhouetteRequest.model_validate(fields | effect.asked)
    times = []
    for _ in range(rounds + 1):
        start = time.perf_counter()
        described = describe_silhouette(asset, wanted)
        path.write_bytes(silhouette_svg(described))
        times.append((time.perf_counter() - start) * 1e3)
    assert described.lines is not None
    return statistics.median(times[1:]), ", ".join(name for name, _ in described.lines.passes)


def make(out: Path, rounds: int) -> Result:
    """Write all pictures below `out`, images/effects/; what they cost."""
    folder = out / "images" / "effects"
    folder.mkdir(parents=True, exist_ok=True)
    gpu = Gpu(256)
    rows = []
    try:
        with tempfile.TemporaryDirectory() as temporary:
            assets = {}
            for name, build in MESHES.items():
                path = Path(temporary) / f"{name}.ply"
                write_ply(str(path), *build())
                assets[name] = loaded(path)
            for effect in EFFECTS:
                picture = folder / f"{effect.name}.{'svg' if effect.vector else 'png'}"
                if effect.vector:
                    ms, passes = written(assets[effect.mesh], effect, rounds, picture)
                else:
                    ms, passes = drawn(gpu, assets, effect, rounds, picture)
                rows.append({"name": effect.name, "picture": str(picture.relative_to(out)), "ms": round(ms, 3), "passes": passes})
    finally:
        gpu.release()
    return {"machine": machine(), "rounds": rounds, "effects": rows}


def page(result: Result) -> str:
    """docs/effects.md."""
    rows = []
    for effect, row in zip(EFFECTS, result["effects"], strict=True):
        asked = json.dumps(effect.asked).replace("|", "\\|")
        rows.append([f"![{effect.says}]({row['picture']})", f"**{effect.says}**<br>`{asked}`", number(row["ms"]), row["passes"]])
    return HEAD + markdown_table(["", "asked of", "adds, ms", "passes"], rows) + f"\n\nMeasured on {sentence(result['machine'])}\n"


HEAD = """\
# Line effects

Every one is asked of any picture (`POST .../render`, `/v1/render`, `/v1/scenes/render`) or drawing (`POST .../silhouette`,
`/v1/silhouette`), on any mesh; what is not asked for is not there and costs nothing. The fields are in [the API](api.md#lines).
Pictures and costs are made by
`python -m benchmarks.effects`: 512 x 512, 4 samples a pixel, on the CPU; the median with the effect less that without, and for vector
lines all that a view takes.

"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).resolve().parents[1] / "docs", help="folder of effects.md and images/effects"
    )
    parser.add_argument("--rounds", type=int, default=40, help="frames of each kind")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the page")
    given = parser.parse_args()
    result = make(given.out, given.rounds)
    (given.out / "effects.md").write_text(page(result))
    print(json.dumps(result) if given.json else page(result))


if __name__ == "__main__":
    main()
