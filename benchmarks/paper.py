"""What Silhouette Clipping (Sander, Gu, Gortler, Hoppe, Snyder, SIGGRAPH 2000) reports: Tables 1 and 2, times in milliseconds.

A 550 MHz Pentium III with a GeForce 256. Its parasaur is not public; it has no counterpart here.
"""

from __future__ import annotations

MACHINE = "Pentium III, 550 MHz, GeForce 256, 2000"

TABLE_1: dict[str, dict[str, float]] = {
    "bunny": {
        "faces": 69_674,
        "hull_faces": 500,
        "original": 34.7,
        "extraction": 4.5,
        "stencil": 2.7,
        "hull": 4.8,
        "total": 7.8,
        "speed_up": 4.4,
        "antialiasing": 3.0,
    },
    "dragon": {
        "faces": 400_000,
        "hull_faces": 4_000,
        "original": 204.7,
        "extraction": 24.2,
        "stencil": 21.5,
        "hull": 5.2,
        "total": 50.3,
        "speed_up": 4.1,
        "antialiasing": 22.5,
    },
    "knot": {
        "faces": 185_856,
        "hull_faces": 928,
        "original": 81.12,
        "extraction": 6.5,
        "stencil": 2.8,
        "hull": 4.9,
        "total": 10.3,
        "speed_up": 7.9,
        "antialiasing": 3.4,
    },
    "holes3": {
        "faces": 188_416,
        "hull_faces": 500,
        "original": 90.3,
        "extraction": 4.0,
        "stencil": 1.0,
        "hull": 4.4,
        "total": 5.5,
        "speed_up": 16.4,
        "antialiasing": 1.5,
    },
}

TABLE_2: dict[str, dict[str, float]] = {
    "bunny": {
        "edges": 104_511,
        "silhouette_edges": 3_461,
        "tested_edges": 10_256,
        "tested_nodes": 4_282,
        "tree": 4.1,
        "brute_force": 20.4,
        "speed_up": 5.0,
    },
    "dragon": {
        "edges": 600_000,
        "silhouette_edges": 23_493,
        "tested_edges": 67_934,
        "tested_nodes": 26_291,
        "tree": 28.2,
        "brute_force": 117.3,
        "speed_up": 4.2,
    },
    "knot": {
        "edges": 278_784,
        "silhouette_edges": 3_291,
        "tested_edges": 13_134,
        "tested_nodes": 7_926,
        "tree": 6.4,
        "brute_force": 50.6,
        "speed_up": 7.9,
    },
    "holes3": {
        "edges": 282_624,
        "silhouette_edges": 1_737,
        "tested_edges": 5_976,
        "tested_nodes": 4_594,
        "tree": 3.3,
        "brute_force": 51.4,
        "speed_up": 15.6,
    },
}

NAMES = {"bunny_closed": "bunny", "dragon_400k": "dragon", "knot": "knot", "holes3": "holes3"}
"""Our models that are the paper's, by our name."""

BUNNY_FACES = (500, 4_000, 20_000, 50_000)
"""Simplified bunnies of Figure 9, beside the full one."""
