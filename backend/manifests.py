"""From stage records to the manifest that ends a mesh's preprocessing."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from pydantic import ValidationError

from backend import records
from backend.store import Store
from schemas.errors import CorruptArtifactError, NotReadyError
from schemas.jobs import LATER_STAGES, STAGES
from schemas.manifest import FrameRecord, Manifest, StageRecord
from schemas.mesh import Capability, HullInfo, MeshStats, Problem

NOT_YET = "the preprocessing has not ended; the original is drawn until then"
LEVEL_STAGES = ("levels", "inner")
"""Stages that measure hulls of several sizes; each is the name of a capability, too."""


def build_manifest(mesh_id: str, records: Mapping[str, StageRecord | None]) -> Manifest:
    """The manifest for the records of all stages, or of those that ended when one of them failed.

    Reports that it reads: `frame`, `stats`, `repairs` of load, `faces`, `volume_excess` of hull, `levels` of levels and inner, and
    `capabilities` of any stage, where a later stage overrides an earlier one. Raises CorruptArtifactError when a report cannot be read.
    """
    ended = [record for stage in STAGES if (record := records.get(stage)) is not None]
    failed = next((record for record in ended if record.outcome == "failed"), None)
    reports = {record.stage: record.report for record in ended if record.outcome == "done"}
    load, capabilities = reports.get("load", {}), _capabilities(ended)
    return Manifest(
        id=mesh_id,
        status="failed" if failed else "ready",
        frame=_model(FrameRecord, load.get("frame")),
        stats=_model(MeshStats, load.get("stats")),
        capabilities=capabilities,
        hull=_hull(reports, capabilities),
        repairs=load.get("repairs"),
        stages=ended,
        error=failed.error if failed else None,
        finished=datetime.now(UTC),
    )


def read_drawable(store: Store, mesh_id: str) -> Manifest:
    """What there is to draw of a mesh: its manifest, with the records of later stages that are done; before it has one, a manifest of the
    stage load alone, of status `loaded`.

    A failed mesh's manifest is returned as it is. Raises NotReadyError when nothing is loaded yet, CorruptArtifactError.
    """
    manifest = records.read_manifest(store, mesh_id)
    if manifest is None:
        return _loaded(store, mesh_id)
    if manifest.status == "failed":
        return manifest
    later = [record for stage in LATER_STAGES if (record := records.read_stage(store, mesh_id, stage)) and record.outcome == "done"]
    return manifest.model_copy(update={"stages": [*manifest.stages, *later]}) if later else manifest


def _loaded(store: Store, mesh_id: str) -> Manifest:
    record = records.read_stage(store, mesh_id, "load")
    if record is None or record.outcome != "done":
        raise NotReadyError("The mesh is accepted, but it has not been read yet.", mesh=mesh_id)
    manifest = build_manifest(mesh_id, {"load": record})
    nothing = {name: Capability(available=False, reason=NOT_YET) for name in ("clip", *LEVEL_STAGES)}
    return manifest.model_copy(update={"status": "loaded", "capabilities": nothing})


def failed_record(stage: str, seconds: float, error: Problem) -> StageRecord:
    """The record of a stage that failed for good."""
    return StageRecord(stage=stage, outcome="failed", seconds=seconds, error=error)


def _hull(reports: Mapping[str, dict[str, Any]], capabilities: Mapping[str, Capability]) -> HullInfo | None:
    """The drawn hull, with those levels that passed their checks."""
    if "hull" not in reports:
        return None
    passed = [name for name in LEVEL_STAGES if name in capabilities and capabilities[name].available]
    levels = [level for name in passed for level in reports.get(name, {}).get("levels", [])]
    info: HullInfo = _model(HullInfo, {**reports["hull"], "levels": levels})
    return info


def _capabilities(records: list[StageRecord]) -> dict[str, Capability]:
    merged: dict[str, Capability] = {}
    for record in records:
        merged |= {name: _model(Capability, value) for name, value in record.report.get("capabilities", {}).items()}
    return merged


def _model(model: type[Any], value: Any) -> Any:
    try:
        return None if value is None else model.model_validate(value)
    except ValidationError as error:
        raise CorruptArtifactError("a stage's report is damaged") from error
