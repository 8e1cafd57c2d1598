"""Schemathesis over the OpenAPI document of a running service: requests made from it, answers held against it, with every check it has.

The document's example mesh is replaced by one that is ready, so that requests reach what lies behind 404.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import httpx

EXAMPLE_MESH = "3f2a917c5be04d1f8a6c0d9e2b7f4a11"
NO_MESH, NO_KEY = "0" * 32, "0" * 16
REPORTED_CHARS = 6000

CONFIG = """
[parameters]
"path.mesh_id" = "{mesh}"
"path.suffix" = "png"
"path.name" = "hull.glb"
"path.key_id" = "{key}"

[checks.positive_data_acceptance]
# what a schema cannot say is refused: two cameras at once, a name without a known ending, bytes that are no mesh
expected-statuses = ["2xx", "3xx", "401", "403", "404", "406", "409", "413", "415", "422", "429"]

[[operations]]
include-path = "/v1/meshes/{{mesh_id}}/silhouette.{{suffix}}"
parameters = {{ "path.suffix" = "svg" }}

[[operations]]
include-method = "DELETE"
include-path = "/v1/meshes/{{mesh_id}}"
parameters = {{ "path.mesh_id" = "{no_mesh}" }}

[[operations]]
include-method = "DELETE"
include-path = "/v1/keys/{{key_id}}"
parameters = {{ "path.key_id" = "{no_key}" }}
"""


def check_service(url: str, token: str, mesh: str, folder: Path, *arguments: str) -> str:
    """Run schemathesis against the service at `url`, in which `mesh` is ready; what it found, empty when nothing.

    token: of a key that may do everything. folder: for the configuration and the document. arguments: of `schemathesis run`.
    """
    config, document = folder / "schemathesis.toml", folder / "openapi.json"
    key = token.split("_")[1]
    config.write_text(CONFIG.format(mesh=mesh, key=key, no_mesh=NO_MESH, no_key=NO_KEY))
    answer = httpx.get(f"{url}/openapi.json", headers={"Authorization": f"Bearer {token}"}, timeout=60.0).raise_for_status()
    document.write_text(answer.text.replace(EXAMPLE_MESH, mesh))
    command = [str(Path(sys.executable).with_name("schemathesis")), "--config-file", str(config), "run", str(document), "--url", url]
    flags = ["--checks", "all", "--continue-on-failure", "--request-timeout", "60", "--header", f"Authorization: Bearer {token}"]
    done = subprocess.run([*command, *flags, *arguments], capture_output=True, check=False, cwd=folder)
    said = done.stdout.decode(errors="replace") + done.stderr.decode(errors="replace")
    return "" if done.returncode == 0 else said[-REPORTED_CHARS:]
