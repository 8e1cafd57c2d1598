"""Hulls of other sizes: what they enclose, how many faces they have, and which ones a mesh goes without."""

import shutil

import numpy as np
import pytest

from backend import records
from backend.artifacts import open_artifact
from backend.local_store import LocalStore
from backend.manifests import build_manifest
from backend.queue import JobQueue
from backend.redis_connection import connect
from geometry.topology import signed_volume
from schemas import artifacts, keys
from schemas.jobs import STAGES
from tests.backend.accepting import accept
from tests.meshes import bumpy_sphere, sphere
from tests.worker.processing import ply
from worker import hulls as made_of
from worker.bake import bake_hull, hull_normals
from worker.enclosure import NotEnclosedError, enclosure_fault
from worker.hull import build_hull
from worker.hulls import HullSource, LeftOutError, other_hulls
from worker.jobs import run_and_record

TEXELS = 128


def silent(part):
    assert 0.0 <= part <= 1.0


def source(mesh, hull_faces, colour=None):
    positions, faces = (np.ascontiguousarray(mesh[0], np.float32), np.ascontiguousarray(mesh[1], np.int32))
    positions /= np.linalg.norm(positions, axis=1).max()
    hull = build_hull(positions, faces, hull_faces, silent)
    original = {"positions": positions, "faces": faces, "normals": hull_normals(positions, faces)}
    drawn = {"positions": hull.positions, "faces": hull.faces, "normals": hull_normals(hull.positions, hull.faces)}
    return HullSource(original, drawn, {"step_vertices": hull.step_vertices, "step_positions": hull.step_positions}, colour, TEXELS)


@pytest.fixture(scope="module")
def bumpy():
    return source(bumpy_sphere(4), 400)


@pytest.fixture(scope="module")
def both(bumpy):
    fractions = []
    made, left_out = other_hulls(bumpy, fractions.append)
    assert left_out == []
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
    return made


def test_one_has_a_quarter_of_the_drawn_hulls_faces_and_one_four_times_as_many(bumpy, both):
    drawn = len(bumpy.drawn["faces"])
    coarser, finer = (len(one.hull["faces"]) for one in both)
    assert drawn // 4 - 2 < coarser <= drawn // 4
    assert 4 * drawn - 2 < finer <= 4 * drawn


def test_they_enclose_the_mesh_and_the_coarser_one_the_drawn_hull_too(bumpy, both):
    for one in both:
        enclosure_fault(bumpy.mesh["positions"], bumpy.mesh["faces"], one.hull["positions"], one.hull["faces"])
    coarser, finer = (one.hull for one in both)
    enclosure_fault(bumpy.drawn["positions"], bumpy.drawn["faces"], coarser["positions"], coarser["faces"])
    with pytest.raises(NotEnclosedError):
        enclosure_fault(coarser["positions"], coarser["faces"], finer["positions"], finer["faces"])


def test_volumes_grow_from_fine_to_coarse_and_are_told_of_the_mesh(bumpy, both):
    volumes = [signed_volume(h["positions"], h["faces"]) for h in (bumpy.mesh, both[1].hull, bumpy.drawn, both[0].hull)]
    assert volumes == sorted(volumes)
    for one, volume in ((both[1], volumes[1]), (both[0], volumes[3])):
        assert one.volume_excess == pytest.approx(volume / volumes[0] - 1.0)


def test_their_maps_are_those_of_the_bake_in_the_uploads_size(bumpy, both):
    for one in both:
        height, width = one.maps["normal"].shape[:2]
        assert 0.7 * TEXELS < max(width, height) <= TEXELS
        again = bake_hull(bumpy.mesh, one.hull, None, TEXELS, silent)
        assert np.array_equal(again.normal, one.maps["normal"]) and "color" not in one.maps


def test_colours_are_baked_where_the_mesh_has_them():
    mesh = bumpy_sphere(3)
    colour = {"corner_color": np.full((len(mesh[1]), 3, 4), (10, 200, 30, 255), np.uint8)}
    (coarser, _), _ = other_hulls(source(mesh, 300, colour), silent)
    assert (coarser.maps["color"].reshape(-1, 4).max(axis=0) == (10, 200, 30, 255)).all()


def test_small_meshes_have_neither_and_are_told_why():
    made, left_out = other_hulls(source(sphere(2), 100), silent)
    assert made == (None, None)
    assert [reason.split(" hull")[0] for reason in left_out] == ["a coarser", "a finer"]


def test_a_coarser_hull_that_topology_keeps_fine_is_left_out(bumpy, monkeypatch):
    monkeypatch.setattr(made_of, "LARGEST_SHARE", 0.2)
    with pytest.raises(LeftOutError, match="topology"):
        bumpy.coarser(silent)


def test_a_hull_that_does_not_pass_the_checks_is_left_out_and_the_other_kept(bumpy, monkeypatch):
    def too_small(positions, faces, steps, places, wanted):
        return tuple(np.ascontiguousarray(a) for a in (bumpy.mesh["positions"] * np.float32(0.9), faces))

    monkeypatch.setattr(made_of, "cut_hull", too_small)
    (coarser, finer), left_out = other_hulls(bumpy, silent)
    assert coarser is not None and finer is None
    assert len(left_out) == 1 and "did not pass the checks" in left_out[0]


def test_what_progress_raises_goes_through(bumpy):
    def stop(part):
        if part > 0.3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        other_hulls(bumpy, stop)


# As a stage, in this process.


@pytest.fixture(scope="module")
def made_ready(tmp_path_factory):
    """(folder of a store, the mesh in it), which is ready."""
    folder = tmp_path_factory.mktemp("ready")
    queue = JobQueue(connect(f"unix://{folder}/none.sock"), LocalStore(folder / "store"))
    mesh_id = accept(queue.store, ply(bumpy_sphere(4)), name="mesh.ply", hull_faces=400, texels=TEXELS)
    done = {stage: run_and_record(queue, mesh_id, stage) for stage in STAGES}
    with records.publishing(queue.store, mesh_id):
        records.write_manifest(queue.store, build_manifest(mesh_id, done))
    return queue.store.root, mesh_id


@pytest.fixture
def ready(made_ready, tmp_path):
    """(queue, mesh id): that mesh, whose later stages nobody runs."""
    folder, mesh_id = made_ready
    shutil.copytree(folder, tmp_path / "store")
    return JobQueue(connect(f"unix://{tmp_path}/none.sock"), LocalStore(tmp_path / "store")), mesh_id


def test_the_stage_keeps_what_it_reports(ready):
    queue, mesh_id = ready
    record = run_and_record(queue, mesh_id, "hulls")
    assert record.outcome == "done", record.error
    assert set(record.artifacts) == {layout.file for layout in (*artifacts.OTHER_HULLS, *artifacts.OTHER_MAPS)}
    assert record.report["left_out"] == []
    stored = zip(artifacts.OTHER_HULLS, artifacts.OTHER_MAPS, record.report["hulls"], strict=True)
    for layout, maps_layout, told in stored:
        hull, maps = (
            open_artifact(queue.store.local_path(keys.artifact(mesh_id, one.file)), one, verify=True) for one in (layout, maps_layout)
        )
        assert told["faces"] == len(hull["faces"]) == len(maps["tile_uv"])
        assert told["texels"] == max(maps["normal"].shape[:2])


def test_a_mesh_that_lost_clipping_to_its_checks_has_no_other_hulls(ready):
    queue, mesh_id = ready
    manifest = records.read_manifest(queue.store, mesh_id)
    lost = manifest.capabilities["clip"].model_copy(update={"available": False})
    queue.store.put_bytes(keys.manifest(mesh_id), manifest.model_copy(update={"capabilities": {"clip": lost}}).model_dump_json().encode())
    assert run_and_record(queue, mesh_id, "hulls").outcome == "skipped"
