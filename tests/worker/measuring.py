"""A measurement small enough for tests of the stage `measure`: called, paused and gone on with like the real one."""

import json
import os
import time

from backend import records
from backend.artifacts import open_artifact
from schemas import artifacts, keys

STEPS, STEP_S = 20, 0.04


def measure_mesh(store, mesh_id, progress, pause):
    """Count the mesh's faces, slowly. Says how many steps this call made itself, and how nice its process is."""
    place, first = keys.partial(mesh_id, "measure"), 0
    if store.exists(place):
        first = json.loads(store.get_bytes(place))
    for step in range(first, STEPS):
        progress(step / STEPS)
        if pause():
            return None
        time.sleep(STEP_S)
        with records.publishing(store, mesh_id):
            store.put_bytes(place, json.dumps(step + 1).encode())
    faces = open_artifact(store.local_path(keys.artifact(mesh_id, artifacts.MESH.file)), artifacts.MESH)["faces"]
    return {"faces": len(faces), "steps": STEPS - first, "nice": os.nice(0)}


def measure_nothing(store, mesh_id, progress, pause):
    """One that breaks, for a reason that may go away."""
    raise RuntimeError("no renderer")
