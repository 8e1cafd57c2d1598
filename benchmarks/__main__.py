"""All tables and figures, one after the other, and the summary.

    python -m benchmarks [--quick] [--out docs/results]

A table that fails is told and the others go on; the program then ends with status 1. --quick goes to benchmarks/out/quick, so
that it does not take the place of measured results.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

from benchmarks import summary

ROOT = Path(__file__).resolve().parents[1]
RESULTS, QUICK_RESULTS = ROOT / "docs" / "results", ROOT / "benchmarks" / "out" / "quick"
TABLES = ("table2", "figure9", "table1", "figure10", "figure11", "hulls", "preprocessing", "accuracy")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few rounds, to see that it runs")
    parser.add_argument("--out", type=Path, help="folder for the results")
    options = parser.parse_args()
    out = options.out or (QUICK_RESULTS if options.quick else RESULTS)
    failed = []
    for name in TABLES:
        begun = time.perf_counter()
        command = [sys.executable, "-m", f"benchmarks.tables.{name}", "--out", str(out), *(["--quick"] if options.quick else [])]
        done = subprocess.run(command, cwd=ROOT, check=False, stdout=subprocess.DEVNULL)
        print(f"{name}: {time.perf_counter() - begun:.0f} s{', FAILED' if done.returncode else ''}", flush=True)
        failed += [name] if done.returncode else []
    print(summary.write(out))
    print(f"results are in {out}")
    if failed:
        raise SystemExit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
