"""What a command would do (`--dry-run`): everything is opened and checked, nothing is measured."""

from __future__ import annotations

from pathlib import Path

from ..core.source import Source
from ..formats.detections import load as load_detections
from ..requests import EstimateRequest, FixRequest
from .estimate import detector_of, opened
from .fix import rehearsed


def rehearsal(
    path: Path, request: EstimateRequest, out: Path | None = None, save_detections: Path | None = None
) -> list[tuple[str, str]]:
    """What would be done with the input at `path`, and what by `fix` be written at `out`: labels and texts.

    Raises what the command raises before it measures.
    """
    asked = opened(path, request)
    source = asked.source
    rows = [("input", f"{path}: {_kind(source)}"), ("fleet", f"{asked.fleet.code} ({asked.fleet.name})")]
    rows += [("why", why) for why in asked.why]
    if request.detections is not None:
        boxes = load_detections(Path(request.detections), source, request.vehicle_classes)
        rows.append(("boxes", f"{len(boxes)} from {request.detections}"))
    else:
        rows.append(("detector", detector_of(source, request).name))
    rows += [("also", evidence.says) for evidence in asked.given]
    if source.claimed is not None and source.claimed.gsd_m is not None:
        rows.append(("claim", f"{source.claimed.gsd_m:.4g} m/px: {source.claimed.why}"))
    if isinstance(request, FixRequest) and out is not None:
        rows += [("to write", str(place)) for place in rehearsed(path, out, request, save_detections)]
    rows += [(note.label, note.text) for note in source.notes]
    return rows


def _kind(source: Source) -> str:
    if source.plan is not None:
        return f"an orthophoto of {source.plan.width} x {source.plan.height} px"
    return f"a model with {len(source.pictures)} frames"
