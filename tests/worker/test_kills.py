"""SIGKILL in every stage. The stages are caught in the act: what they made waits for the mesh, which is held meanwhile."""

import os
import shutil
import signal
import time
from dataclasses import dataclass

import pytest

from backend import records
from schemas import keys
from schemas.jobs import LATER_STAGES, STAGES
from tests.backend.accepting import accept
from tests.meshes import bumpy_sphere, sphere
from tests.worker.forks import descendants_of, forked_workers, held_elsewhere, lives, private_queue
from tests.worker.processing import SMALL, children_of, is_job, ply, wait_for
from worker.jobs import run_and_record

pytestmark = pytest.mark.xdist_group("kills")

EVERY_STAGE = {**STAGES, **LATER_STAGES}
AGAIN_S = 60.0
"""Longest that a stage may take to be started again."""


@dataclass
class Aftermath:
    """What became of a mesh with a stage that was killed. before, after: file -> (inode, ns of its last change)."""

    started_again_s: float
    manifest: records.Manifest
    outcomes: dict[str, str]
    before: dict[str, tuple[int, int]]
    after: dict[str, tuple[int, int]]


@dataclass
class Scene:
    """What became of all of them by stage, and what was left when all had ended."""

    meshes: dict[str, Aftermath]
    orphans: list[int]
    temporary: list[str]
    jobs: list[str]


def after(stage):
    """Stages that need this one, and it."""
    found = {stage}
    for name, before in EVERY_STAGE.items():
        if found & set(before):
            found.add(name)
    return found


def files_of(queue, mesh_id):
    paths = {key: queue.store.local_path(key).stat() for key in queue.store.list(keys.folder(mesh_id))}
    return {key: (state.st_ino, state.st_mtime_ns) for key, state in paths.items()}


def mesh_before(queue, number, stage):
    """A mesh all stages of which have ended but this one and those that need it."""
    mesh_id = accept(queue.store, ply(sphere(1, radius=1.0 + number)), name="mesh.ply", **SMALL)
    for name in EVERY_STAGE:
        if name in LATER_STAGES:
            queue.advance(mesh_id)
        if name not in after(stage):
            assert run_and_record(queue, mesh_id, name).outcome == "done"
    return mesh_id


@pytest.fixture(scope="module")
def prepared(tmp_path_factory, compiled):
    """(folder of a store, stage -> its mesh): one mesh before each stage."""
    folder = tmp_path_factory.mktemp("prepared")
    with pytest.MonkeyPatch.context() as patch, private_queue(folder, patch) as queue:
        return folder / "store", {stage: mesh_before(queue, number, stage) for number, stage in enumerate(EVERY_STAGE)}


def has_ended(queue, mesh_id):
    return all(records.read_stage(queue.store, mesh_id, stage) for stage in EVERY_STAGE)


def kill_all(workers, victim):
    """Kill the workers, or the processes of their stages alone; what had been started by whom was killed."""
    killed = workers if victim == "worker" else [pid for worker in workers for pid in descendants_of(worker) if is_job(pid)]
    left = [pid for one in killed for pid in descendants_of(one)]
    for pid in killed:
        os.kill(pid, signal.SIGKILL)
    return [*left, *(killed if victim != "worker" else ())]


@pytest.fixture(scope="module", params=["worker", "process of the stage"])
def scene(request, prepared, tmp_path_factory):
    """As many workers as there are stages; each, or the process of its stage, is killed in another stage."""
    (stored, meshes), folder = prepared, tmp_path_factory.mktemp("data")
    shutil.copytree(stored, folder / "store")
    with pytest.MonkeyPatch.context() as patch, private_queue(folder, patch) as queue, forked_workers() as start:
        before = {stage: files_of(queue, mesh_id) for stage, mesh_id in meshes.items()}
        for mesh_id in meshes.values():
            queue.advance(mesh_id)
        with held_elsewhere(queue.store, meshes.values()):
            workers = start(len(meshes))
            wait_for(lambda: all(stage in queue.progress.read(mesh_id) for stage, mesh_id in meshes.items()))
            doomed = kill_all(workers, request.param)
            killed = time.monotonic()
            wait_for(lambda: not any(map(lives, doomed)))
            assert all(records.read_stage(queue.store, mesh_id, stage) is None for stage, mesh_id in meshes.items())
            for mesh_id in meshes.values():
                queue.progress.clear(mesh_id)
        if request.param == "worker":
            workers = start(len(meshes))
        again = {}

        def all_started_again():
            for stage, mesh_id in meshes.items():
                if stage not in again and (stage in queue.progress.read(mesh_id) or records.read_stage(queue.store, mesh_id, stage)):
                    again[stage] = time.monotonic() - killed
            return len(again) == len(meshes)

        wait_for(all_started_again, 240.0)
        wait_for(lambda: all(has_ended(queue, mesh_id) for mesh_id in meshes.values()), 240.0)
        wait_for(lambda: not any(map(is_job, (pid for worker in workers for pid in descendants_of(worker)))))
        yield Scene(
            {
                stage: Aftermath(
                    again[stage],
                    records.read_manifest(queue.store, mesh_id),
                    {name: records.read_stage(queue.store, mesh_id, name).outcome for name in EVERY_STAGE},
                    before[stage],
                    files_of(queue, mesh_id),
                )
                for stage, mesh_id in meshes.items()
            },
            [pid for pid in doomed if lives(pid)],
            [path.name for path in (queue.store.root / ".tmp").iterdir()],
            [*queue.queue.get_job_ids(), *queue.later.get_job_ids()],
        )


@pytest.mark.parametrize("stage", EVERY_STAGE)
def test_a_stage_that_was_killed_runs_again_within_a_minute_and_those_before_it_do_not(scene, stage):
    mesh = scene.meshes[stage]
    assert mesh.started_again_s < AGAIN_S
    assert mesh.manifest.status == "ready" and mesh.manifest.capabilities["clip"].available
    assert set(mesh.outcomes.values()) == {"done"}
    assert {key: mesh.after[key] for key in mesh.before} == mesh.before


def test_stages_that_were_killed_leave_no_process_no_temporary_file_and_no_job(scene):
    assert (scene.orphans, scene.temporary, scene.jobs) == ([], [], [])


@pytest.mark.heavy
def test_a_stage_whose_process_always_dies_fails_the_mesh_and_not_the_worker(tmp_path, monkeypatch, compiled):
    with private_queue(tmp_path, monkeypatch) as queue, forked_workers() as start:
        mesh_id = accept(queue.store, ply(bumpy_sphere(4)), name="a.ply", **SMALL)
        queue.advance(mesh_id)
        (worker,) = start(1)
        killed = set()

        def kill_all_or_ended():
            for pid in set(children_of(worker)) - killed:
                if is_job(pid):
                    os.kill(pid, signal.SIGKILL)
                    killed.add(pid)
            return records.read_manifest(queue.store, mesh_id)

        manifest = wait_for(kill_all_or_ended)
        assert len(killed) == 4
        assert manifest.status == "failed"
        assert manifest.error.model_extra["code"] == "stage-failed"
        assert lives(worker)
