"""Coverage-guided fuzzing by atheris: `python -m tests.fuzz [--seconds 60] [--targets glb,ply] [--corpus build/fuzz]`.

Each target runs in a process of its own, from the seeds, what was found before, and its corpus of earlier runs. An input that breaks a
claim, takes too long or too much memory is left beside the corpus; once the fault is mended it belongs into `tests/fuzz/findings`.
"""

from __future__ import annotations

import argparse
import logging
import subprocess
import sys
import tempfile
from pathlib import Path

FINDINGS = Path(__file__).parent / "findings"
ROOT = Path(__file__).parents[2]
INSTRUMENTED = ["backend", "service", "worker", "trimesh"]
COMPILED = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in ROOT.glob("*/kernels/*.py")]
"""Numba compiles no instrumented code."""
SERVICE = "service"
ENVIRONMENT = {"SILHOUETTE_REQUIRE_KEYS": "1", "SILHOUETTE_WARM_KERNELS": "0", "SILHOUETTE_MEASURE": "0", "SILHOUETTE_MAX_UPLOAD_MIB": "4"}
MEMORY_MIB = 2600
INPUT_BYTES = 8192
INPUT_S = 20


def main() -> int:
    """Fuzz the targets one after the other; 1 when there were findings."""
    flags = _flags()
    if flags.one:
        return _fuzz(flags.one, flags.corpus, flags.seconds)
    from tests.fuzz.targets import TARGETS

    names = flags.targets.split(",") if flags.targets else [*TARGETS, SERVICE]
    command = [sys.executable, "-m", "tests.fuzz", "--seconds", str(flags.seconds), "--corpus", str(flags.corpus), "--one"]
    broken = [name for name in names if name != SERVICE and subprocess.run([*command, name], check=False).returncode]
    for name in broken:
        print(f"{name}: findings are in {flags.corpus / name}")
    found = _check_service(flags.seconds) if SERVICE in names else ""
    print(found, end="")
    return 1 if broken or found else 0


def _check_service(seconds: int) -> str:
    """What schemathesis finds in so many seconds, in a service of its own."""
    from client import Client
    from client.local import LocalKeys, LocalService
    from client.shapes import write_ply
    from tests.fuzz.service import check_service
    from tests.meshes import cube

    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        token = LocalKeys(folder).add_key("fuzz", scopes=["read", "write", "admin"]).token
        write_ply(str(folder / "cube.ply"), *cube(3))
        with LocalService(folder, ENVIRONMENT, ("--workers", "1")) as service, Client(service.url, timeout_s=120.0, key=token) as client:
            mesh = client.wait(client.upload(folder / "cube.ply", hull_faces=100, texels=64).id, timeout_s=600.0)
            return check_service(service.url, token, mesh.id, folder, "--max-time", str(seconds))


def _flags() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="of each target")
    parser.add_argument("--targets", default="", help="names, separated by commas; all if none is given")
    parser.add_argument("--corpus", type=Path, default=Path("build/fuzz"), help="folder that is kept between runs")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    return parser.parse_args()


def _fuzz(name: str, corpus: Path, seconds: int) -> int:
    import atheris

    with atheris.instrument_imports(include=INSTRUMENTED, exclude=COMPILED):
        from tests.fuzz.seeds import seeds
        from tests.fuzz.targets import TARGETS
    logging.disable()
    target = TARGETS[name]
    folder = corpus / name / "corpus"
    folder.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(seeds()[name]):
        (folder / f"seed-{number}").write_bytes(seed)
        target(seed)
    options = [f"-max_total_time={seconds}", f"-rss_limit_mb={MEMORY_MIB}", f"-timeout={INPUT_S}", f"-max_len={INPUT_BYTES}"]
    known = [str(FINDINGS / name)] if (FINDINGS / name).is_dir() else []
    atheris.Setup([sys.argv[0], *options, f"-artifact_prefix={corpus / name}/", "-print_final_stats=1", str(folder), *known], target)
    atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main())
