"""From stage records to the manifest that ends a mesh's preprocessing."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from pydantic import ValidationError

from backend import records
from backend.store import Store
from schemas.errors import CorruptArtifactError
from schemas.jobs import LATER_STAGES, STAGES
from schemas.manifest import FrameRecord, Manifest, StageRecord
from schemas.mesh import Capability, HullInfo, MeshStats, Problem

NOT_ENDED = "preprocessing has not ended; the original is drawn until then"
"""Why a mesh that will be clipped is not yet."""

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


def loaded_manifest(mesh_id: str, load: StageRecord) -> Manifest:
    """What can be drawn of a mesh whose stage load is done and whose preprocessing goes on: the original.

    Raises CorruptArtifactError when the report of load cannot be read.
    """
    report, capabilities = load.report, _capabilities([load])
    if "clip" in capabilities and capabilities["clip"].available:
        capabilities["clip"] = Capability(available=False, reason=NOT_ENDED)
    return Manifest(
        id=mesh_id,
        status="loaded",
        frame=_model(FrameRecord, report.get("frame")),
        stats=_model(MeshStats, report.get("stats")),
        capabilities=capabilities,
        repairs=report.get("repairs"),
        stages=[load],
    )


def with_later_stages(store: Store, manifest: Manifest) -> Manifest:
    """A ready mesh's manifest with the records of the later stages that have ended."""
    later = [record for stage in LATER_STAGES if (record := records.read_stage(store, manifest.id, stage))]
    return manifest.model_copy(update={"stages": [*manifest.stages, *later]})


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
