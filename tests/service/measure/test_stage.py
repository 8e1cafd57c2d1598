"""Measuring a stored mesh: in one go, with interruptions, and after what goes wrong between them."""

from __future__ import annotations

import importlib
import json
import multiprocessing
from datetime import UTC, datetime

import pytest

from backend import records
from backend.artifacts import identity_of, write_artifact
from backend.local_store import LocalStore
from schemas import artifacts, keys
from schemas.errors import CancelledError, NotReadyError, StageFailedError
from schemas.jobs import MEASURE
from schemas.ladder import SAMPLES, SIZES, VIEWS, Ladder
from schemas.manifest import FrameRecord, Manifest, StageRecord
from schemas.mesh import Capability
from service.assets import load_asset
from service.measure.stage import VERSION, measure
from service.render import context
from tests.backend.accepting import accept
from tests.service.render.made import clippable, tree_tensors

SMALL = 2, (24, 32)
STEPS = 4


def stored(root, shape="sphere"):
    """(store, id) of a shape as a mesh that is ready."""
    store, asset = LocalStore(root), clippable(shape)
    mesh_id = accept(store)
    mesh = {"positions": asset.positions, "faces": asset.faces, "normals": asset.normals}
    mesh |= {"edge_vertices": asset.edges[0], "edge_faces": asset.edges[1]}
    files = [(artifacts.MESH, mesh), (artifacts.HULL, asset.hull), (artifacts.MAPS, asset.maps), (artifacts.TREE, tree_tensors(shape))]
    made = {layout.file: write_artifact(store, mesh_id, layout, tensors, identity_of(mesh_id, "test")) for layout, tensors in files}
    manifest = Manifest(
        id=mesh_id,
        status="ready",
        frame=FrameRecord(centre=asset.frame.centre, scale=asset.frame.scale),
        capabilities={"clip": Capability(available=True)},
        stages=[StageRecord(stage="all", outcome="done", seconds=0.0, artifacts=made)],
        finished=datetime.now(UTC),
    )
    with records.publishing(store, mesh_id):
        records.write_manifest(store, manifest)
    return store, mesh_id


@pytest.fixture
def mesh(tmp_path):
    return stored(tmp_path / "store")


@pytest.fixture
def run(gpu, mesh):
    """Measures the stored mesh a little: (ladder, fractions of progress)."""
    store, mesh_id = mesh
    asset = load_asset(store, records.read_manifest(store, mesh_id))

    def running(most=STEPS):
        told = []
        return measure(store, mesh_id, asset, gpu, told.append, lambda: len(told) > most, *SMALL), told

    return running


def timeless(ladder):
    """What does not depend on how long anything took."""
    plain = ladder.model_dump()
    for rung in plain["rungs"]:
        for at in rung["sizes"]:
            del at["frame"]
            at["passes"] = sorted(at["passes"])
    return plain


def kept(mesh):
    store, mesh_id = mesh
    return json.loads(store.get_bytes(keys.partial(mesh_id, "measure")))


def change(mesh, **values):
    store, mesh_id = mesh
    store.put_bytes(keys.partial(mesh_id, "measure"), json.dumps(kept(mesh) | values).encode())


def test_without_pauses_everything_is_measured_in_one_go(run):
    ladder, told = run()
    assert told == [0.0, 0.25, 0.5, 0.75]
    assert [facts.size for facts in ladder.facts] == [24, 32]
    assert {rung.label.partition(",")[0] for rung in ladder.rungs} >= {"original/msaa", "clipped/line", "clipped/coverage"}


def test_paused_after_each_view_it_goes_on_where_it_was(run, mesh):
    whole = timeless(run()[0])
    store, mesh_id = mesh
    store.delete(keys.partial(mesh_id, "measure"))
    for done in range(STEPS - 1):
        ladder, told = run(1)
        assert ladder is None and told == [done / STEPS, (done + 1) / STEPS]
        assert len(kept(mesh)["measured"]) == done + 1
    ladder, told = run(1)
    assert told == [0.75]
    assert timeless(ladder) == whole


def test_it_gives_way_before_it_draws_anything(run, mesh):
    assert run(0) == (None, [0.0])
    store, mesh_id = mesh
    assert not store.exists(keys.partial(mesh_id, "measure"))


def test_when_all_views_are_there_nothing_is_drawn_again(run):
    first, _ = run()
    again, told = run()
    assert told == []
    assert again == first


def test_a_damaged_partial_is_measured_anew(run, mesh):
    run(1)
    store, mesh_id = mesh
    whole = store.get_bytes(keys.partial(mesh_id, "measure"))
    for damaged in (b"", b"{}", whole[:-20], whole.replace(b'"ms":', b'"ms":-', 1), whole.replace(b'"ms":', b'"ms":"', 1)):
        store.put_bytes(keys.partial(mesh_id, "measure"), damaged)
        assert run(0)[1] == [0.0]
    store.put_bytes(keys.partial(mesh_id, "measure"), whole)
    assert run(0)[1] == [0.25]


@pytest.mark.parametrize("values", [{"version": VERSION + 1}, {"device": "another"}, {"samples": 8}, {"keys": []}, {"views": 3}])
def test_a_partial_of_something_else_is_measured_anew(run, mesh, values):
    run(1)
    change(mesh, **values)
    assert run(0)[1] == [0.0]


def test_a_partial_whose_views_are_not_the_first_ones_or_lack_something_is_measured_anew(run, mesh):
    run(2)
    first, second = kept(mesh)["measured"]
    unknown = first | {"rungs": first["rungs"] | {"999": first["rungs"]["0"]}}
    bare = first | {"outlines": {}}
    for wrong in ([second], [second, first], [first, first], [unknown], [bare]):
        change(mesh, measured=wrong)
        assert run(0)[1] == [0.0]
    change(mesh, measured=[first, second])
    assert run(0)[1] == [0.5]


def test_a_mesh_that_is_deleted_meanwhile_is_left_alone(run, mesh):
    store, mesh_id = mesh
    run(1)
    records.forget(store, mesh_id)
    with pytest.raises(CancelledError):
        run()
    assert not store.exists(keys.partial(mesh_id, "measure"))


def test_progress_may_stop_it(gpu, mesh):
    store, mesh_id = mesh
    asset = load_asset(store, records.read_manifest(store, mesh_id))

    def gone(part):
        if part:
            raise CancelledError("deleted")

    with pytest.raises(CancelledError):
        measure(store, mesh_id, asset, gpu, gone, lambda: False, *SMALL)
    assert len(kept(mesh)["measured"]) == 1


def named():
    """What the worker finds under the name in the contract."""
    module, _, name = MEASURE.rpartition(".")
    return getattr(importlib.import_module(module), name)


def in_its_own_process(root, mesh_id, answers):
    """As a worker's child, which has no GL yet."""
    answers.put(named()(LocalStore(root), mesh_id, lambda part: None, lambda: False))


@pytest.mark.heavy
def test_the_name_in_the_contract_measures_all_in_a_process_without_a_gl(tmp_path):
    store, mesh_id = stored(tmp_path / "store", "spindle")  # of few pixels, so that all views take seconds
    spawn = multiprocessing.get_context("spawn")
    answers = spawn.Queue()
    child = spawn.Process(target=in_its_own_process, args=(store.root, mesh_id, answers))
    child.start()
    ladder = Ladder.model_validate(answers.get(timeout=200))
    child.join(20)
    assert child.exitcode == 0
    assert [at.size for at in ladder.rungs[0].sizes] == list(SIZES)
    assert (ladder.views, ladder.samples) == (VIEWS, SAMPLES)
    exact = [rung for rung in ladder.rungs if rung.label.startswith("clipped/coverage")]
    assert exact and all(at.outline.alpha_error <= 0.008 and at.outline.alpha_rmse <= 0.015 for rung in exact for at in rung.sizes)


def test_a_machine_that_cannot_draw_is_told_what_to_install(mesh, monkeypatch):
    monkeypatch.setattr(context, "LEAST_VERSION", 990)
    with pytest.raises(StageFailedError, match=r"apt-get install .*libgl1-mesa-dri") as failed:
        named()(*mesh, lambda part: None, lambda: False)
    assert failed.value.code == "no-renderer"


def test_a_mesh_that_is_not_ready_is_not_measured(tmp_path):
    store = LocalStore(tmp_path / "empty")
    with pytest.raises(NotReadyError):
        named()(store, accept(store), lambda part: None, lambda: False)
