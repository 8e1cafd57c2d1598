from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from backend.artifacts import identity_of, write_artifact
from backend.local_store import LocalStore
from backend.manifests import NOT_ENDED, loaded_manifest
from backend.store import Store
from schemas import artifacts
from schemas.errors import CorruptArtifactError, NotReadyError
from schemas.keys import artifact
from schemas.manifest import FrameRecord, Manifest, StageRecord
from schemas.mesh import Capability
from service.assets import AssetCache, MeshAsset, load_asset, state_of
from tests.ladders import small_ladder
from tests.service.render.made import clippable, tree_tensors

MESH_ID = "0123456789abcdef0123456789abcdef"


def stored(store: Store, mesh_id: str = MESH_ID, *, clip: bool = True) -> Manifest:
    made = clippable("torus")
    mesh = {"positions": made.positions, "faces": made.faces, "normals": made.normals}
    mesh |= {"edge_vertices": made.edges[0], "edge_faces": made.edges[1]}
    files = [(artifacts.MESH, mesh)]
    if clip:
        files += [(artifacts.HULL, made.hull), (artifacts.MAPS, made.maps), (artifacts.TREE, tree_tensors("torus"))]
    names = {layout.file: write_artifact(store, mesh_id, layout, tensors, identity_of(mesh_id, "test")) for layout, tensors in files}
    return Manifest(
        id=mesh_id,
        status="ready",
        frame=FrameRecord(centre=made.frame.centre, scale=made.frame.scale),
        capabilities={"clip": Capability(available=clip, reason=None if clip else "it is open")},
        stages=[StageRecord(stage="all", outcome="done", seconds=0.0, artifacts=names)],
        finished=datetime.now(UTC),
    )


@pytest.fixture
def store(tmp_path):
    return LocalStore(tmp_path)


def test_ready_mesh_is_mapped_with_everything_it_has(store):
    asset, made = load_asset(store, stored(store)), clippable("torus")
    assert asset.clippable
    assert asset.appearance is None
    assert np.array_equal(asset.positions, made.positions)
    assert np.array_equal(asset.hull["faces"], made.hull["faces"])
    assert asset.frame == made.frame
    eye = np.array([2.0, 1.0, 3.0, 1.0])
    assert set(map(tuple, asset.tree.extract(eye).edges.tolist())) == set(map(tuple, made.tree.extract(eye).edges.tolist()))


def test_mesh_without_hull_says_why_it_cannot_be_clipped(store):
    asset = load_asset(store, stored(store, clip=False))
    assert not asset.clippable
    assert asset.clip.reason == "it is open"
    assert asset.hull is None
    assert asset.radius == 1.0


def test_mesh_that_failed_is_not_ready(store):
    manifest = stored(store).model_copy(update={"status": "failed"})
    with pytest.raises(NotReadyError):
        load_asset(store, manifest)


def test_damaged_artifact_is_not_drawn(store):
    manifest = stored(store)
    path = store.local_path(artifact(MESH_ID, artifacts.HULL.file))
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(CorruptArtifactError):
        load_asset(store, manifest)


def test_left_face_of_every_directed_edge_has_it_in_its_own_order(store):
    asset: MeshAsset = clippable("torus")
    edges = np.concatenate([asset.edges[0], asset.edges[0][:, ::-1]])
    faces = asset.faces[asset.left_faces(edges)]
    first = np.argmax(faces == edges[:, :1], axis=1)
    assert np.array_equal(np.take_along_axis(faces, first[:, None], 1)[:, 0], edges[:, 0])
    assert np.array_equal(np.take_along_axis(faces, (first[:, None] + 1) % 3, 1)[:, 0], edges[:, 1])


def test_cache_gives_the_same_asset_until_it_is_dropped(store):
    manifest, cache = stored(store), AssetCache(store, 64)
    first = cache.get(manifest)
    assert cache.get(manifest) is first
    cache.drop(MESH_ID)
    assert cache.get(manifest) is not first


def test_cache_lets_the_least_recently_used_go_first(store):
    manifests = [stored(store, f"{k:032x}") for k in range(4)]
    size = load_asset(store, manifests[0]).nbytes
    cache = AssetCache(store, 1)
    room = (1 << 20) // size
    assert 1 <= room < 4, "the capacity of this test holds some of the meshes, not all"
    assets = [cache.get(manifest) for manifest in manifests]
    assert cache.get(manifests[-1]) is assets[-1]
    assert cache.get(manifests[0]) is not assets[0]


def test_loaded_mesh_is_its_original_and_says_that_clipping_is_to_come(store):
    stages = stored(store).stages
    original = stages[0].model_copy(update={"stage": "load", "artifacts": {artifacts.MESH.file: "sha"}})
    original.report["capabilities"] = {"clip": {"available": True}}
    original.report["frame"] = {"centre": [0.0, 0.0, 0.0], "scale": 1.0}
    asset = load_asset(store, loaded_manifest(MESH_ID, original))
    assert np.array_equal(asset.positions, clippable("torus").positions)
    assert (asset.clippable, asset.clip.reason) == (False, NOT_ENDED)
    assert (asset.hull, asset.maps, asset.tree, asset.hulls, asset.levels) == (None, None, None, (), ())


def with_hulls(store, manifest, which=(0, 1)):
    """The manifest with a record of the stage hulls: the torus' own hull and, with the same maps, its other way round."""
    made, names = clippable("torus"), {}
    for k in which:
        for layout, tensors in ((artifacts.OTHER_HULLS[k], made.hull), (artifacts.OTHER_MAPS[k], made.maps)):
            names[layout.file] = write_artifact(store, manifest.id, layout, tensors, identity_of(manifest.id, "hulls"))
    record = StageRecord(stage="hulls", outcome="done", seconds=0.0, artifacts=names)
    return manifest.model_copy(update={"stages": [*manifest.stages, record]})


def with_ladder(manifest, report):
    return manifest.model_copy(
        update={"stages": [*manifest.stages, StageRecord(stage="measure", outcome="done", seconds=0.0, report=report)]}
    )


@pytest.mark.parametrize("which", [(0, 1), (0,), (1,), ()])
def test_other_hulls_are_numbered_behind_the_drawn_one(store, which):
    asset = load_asset(store, with_hulls(store, stored(store), which))
    assert len(asset.hulls) == 1 + len(which)
    assert asset.hulls[0].hull is asset.hull
    assert all(np.array_equal(one.hull["faces"], asset.hull["faces"]) and one.facts.texels[0] for one in asset.hulls)


def test_ladder_is_what_the_stage_measure_reported(store):
    ladder = small_ladder()
    asset = load_asset(store, with_ladder(stored(store), ladder.model_dump(mode="json")))
    assert asset.ladder == ladder
    assert load_asset(store, stored(store)).ladder is None


def test_ladder_of_another_version_is_none(store):
    assert load_asset(store, with_ladder(stored(store), {"device": "llvmpipe"})).ladder is None


def test_cached_asset_gives_way_as_later_stages_end_and_keeps_what_stays(store):
    ready, cache = stored(store), AssetCache(store, 64)
    hulls = with_hulls(store, ready)
    measured = with_ladder(hulls, small_ladder().model_dump(mode="json"))
    assets = [cache.get(manifest) for manifest in (ready, hulls, measured)]
    assert [len(asset.hulls) for asset in assets] == [1, 3, 3]
    assert [asset.ladder is not None for asset in assets] == [False, False, True]
    assert all(asset.tree is assets[0].tree and asset.positions is assets[0].positions for asset in assets)
    assert cache.get(measured) is assets[-1]
    assert len({state_of(manifest) for manifest in (ready, hulls, measured)}) == 3


def test_cached_original_gives_way_to_the_ready_mesh_and_back_when_it_is_taken_anew(store):
    ready, cache = stored(store), AssetCache(store, 64)
    load = ready.stages[0].model_copy(update={"artifacts": {artifacts.MESH.file: "sha"}})
    loaded = ready.model_copy(update={"status": "loaded", "stages": [load], "capabilities": {}})
    assert [cache.get(manifest).clippable for manifest in (loaded, ready, loaded, ready)] == [False, True, False, True]


def test_a_failed_later_stage_is_not_part_of_the_state(store):
    ready = stored(store)
    failed = StageRecord(stage="hulls", outcome="failed", seconds=0.0)
    assert state_of(ready.model_copy(update={"stages": [*ready.stages, failed]})) == state_of(ready)
