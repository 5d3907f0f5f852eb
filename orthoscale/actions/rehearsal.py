"""Says what a command would do (`--dry-run`): everything is opened and checked, nothing is measured."""

from __future__ import annotations

from pathlib import Path

from ..core.claims import METRIC, NOT_TOLD, figure, metric_reason
from ..core.source import Source
from ..formats.detections import load as load_detections
from ..requests import EstimateRequest, FixRequest
from ..system.outputs import Outputs
from .boxes import detector_of
from .check import require_claim
from .find import measurer_of
from .fix import rehearsed
from .kept_boxes import KeptBoxes
from .opening import opened


def rehearsal(
    path: Path,
    request: EstimateRequest,
    out: Path | None = None,
    save_detections: Path | None = None,
    overwrite: bool = False,
    needs_claim: bool = False,
) -> list[tuple[str, str]]:
    """What would be done with the input at `path`, and what `fix` would write at `out`: labels and texts.

    save_detections : the file that would keep the boxes; overwrite : whether it may be replaced (for `fix`, the request
    says so). needs_claim : whether it is for `check`, which compares the input's claim.
    Raises what the command raises before it measures.
    """
    asked = opened(path, request)
    source = asked.source
    if needs_claim:
        require_claim(source)
    rows = [("input", f"{path}: {_kind(source)}"), ("fleet", f"{asked.fleet.code} ({asked.fleet.name})")]
    rows += [("why", why) for why in asked.why]
    if request.detections is not None:
        boxes = load_detections(Path(request.detections), source, request.vehicle_classes, request.alone)
        rows.append(("boxes", f"{len(boxes)} from {request.detections}"))
    else:
        rows.append(("detector", detector_of(asked, request).name))
    measurer_of(request)  # raises if its file is no network
    rows += [("also", evidence.says) for evidence in asked.given]
    claim = source.claimed
    if claim is not None and claim.gsd_m is not None:
        rows.append(("claim", figure(claim.gsd_m, claim.unit_known, claim.why)))
    if needs_claim and source.posed is not None:
        why = source.metric_already
        unsaid = f"none: {NOT_TOLD}; compared with a metre if its unit turns out to be nearly one"
        rows.append(("claim", figure(METRIC, True, metric_reason(why), source.unit) if why else unsaid))
    if isinstance(request, FixRequest) and out is not None:
        places = rehearsed(path, out, request, save_detections)
    else:
        with Outputs(overwrite, (path, request.inputs), dry_run=True) as outputs:
            KeptBoxes(outputs, save_detections).check(source)
            outputs.protect(*source.files)
        places = outputs.places
    rows += [("to write", str(place)) for place in places]
    rows += [(note.label, note.text) for note in source.notes]
    return rows


def _kind(source: Source) -> str:
    if source.plan is not None:
        return f"an orthophoto of {source.width} x {source.height} px"
    return f"a model with {len(source.pictures)} frames"
