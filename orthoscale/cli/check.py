"""`orthoscale check`: does the claimed ground sampling distance of an orthophoto agree with its vehicles?"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import EvidenceDisagrees, UsageError
from ..requests import EstimateRequest
from .dry_run import rehearse, tell_rehearsals
from .many import Many, inputs, run
from .options import (
    PATH,
    command,
    debug_option,
    dry_run_option,
    json_option,
    option,
    options_of,
    overwrite_option,
    progress_bars,
    refuse_idle_overwrite,
    save_option,
    say,
    say_json,
)

if TYPE_CHECKING:
    from ..actions.check import Checked


@command(
    epilog="\b\nExamples:\n  orthoscale check ortho.tif --fleet DE\n  orthoscale check ortho.tif --fleet US --json\n"
    "  orthoscale check archive/ --summary claims.csv --jobs 2\n"
    "  orthoscale check ortho.tif --model sparse/0 --images frames/ --fleet US\n\n"
    "\b\nExit codes: 0 agrees, or too close to call; 2 usage, or INPUT claims no scale;\n"
    "3 too little evidence; 4 disagrees by more than three sigma (--model: 2.6),\n"
    "or the evidence contradicts itself; 5 input unreadable or damaged;\n"
    "6 output could not be written."
)
@inputs
@options_of(EstimateRequest)
@save_option
@option(
    "--model",
    type=PATH,
    group="Input",
    help="Compare with the reconstruction that the orthophoto was made from.",
)
@option("--model-detections", type=PATH, group="Input", help="Take the boxes in the frames of --model from this file.")
@overwrite_option
@json_option()
@dry_run_option
@debug_option
def check(
    path: Path,
    many: Many | None,
    as_json: bool,
    dry_run: bool,
    save_detections: Path | None,
    overwrite: bool,
    model: Path | None,
    model_detections: Path | None,
    **options: Any,
) -> None:
    """Compare the scale that INPUT claims with that of its vehicles.

    A reconstruction claims a metre per unit if orthoscale, a map's coordinates or GPS made it metric, or if its unit
    is within a tenth of one.
    The claim is converted to metres on the ellipsoid at the image's centre, so feet, degrees
    and stretched projections such as EPSG:3857 are handled.

    With --model the orthophoto is compared with the reconstruction it was made from (--images: its frames), by the
    vehicles that both show.
    """
    from ..actions.check import checked
    from ..actions.kept_boxes import KeptBoxes
    from ..actions.opening import source_of
    from ..system.outputs import Outputs

    refuse_idle_overwrite(overwrite, save_detections, many is not None and many.summaries)
    request = EstimateRequest.of(options)
    if many is not None:
        of_one = {"save-detections": save_detections, "model": model, "model-detections": model_detections}
        for name, value in of_one.items():
            if value is not None:
                raise UsageError(f"--{name} is for one input, without --summary", f"Remove --{name}.")
        run("check", many, request, as_json, overwrite, dry_run=dry_run)
    if model is not None:
        if save_detections is not None:
            raise UsageError("--save-detections keeps the boxes of one input", "Remove it, or remove --model.")
        _against_model(path, as_json, model, model_detections, request, dry_run)
        return
    if model_detections is not None:
        raise UsageError("--model-detections are boxes of a --model, and none is named", "Name it: --model FOLDER.")
    if dry_run:
        rehearse(
            [path], request, save_detections=save_detections, overwrite=overwrite, needs_claim=True, as_json=as_json
        )
    with Outputs(overwrite, (path, request.inputs)) as outputs, progress_bars() as progress:
        boxes = KeptBoxes(outputs, save_detections)
        source = source_of(path, request, progress)
        outputs.protect(*source.files)
        boxes.check(source)
        with boxes.also_without_scale():
            outcome = checked(source, request, progress, boxes.take)
        boxes.take(outcome.result.detections, source)
        boxes.save()
    if as_json:
        say_json(outcome.to_dict())
    else:
        _show(outcome)
        if save_detections is not None:
            say(f"boxes      {save_detections}")
    if outcome.disagrees:  # the output above says so
        sys.exit(EvidenceDisagrees.exit_code)
    with boxes.telling():
        outcome.require_agreement()


def _show(outcome: Checked) -> None:
    result = outcome.result
    low, high = result.scale.interval90
    say(
        f"vehicles   {result.scale.text()}, 90 % {result.scale.text(low, high)}, "
        f"{result.scale.vehicles_used} of fleet {result.scale.fleet}"
    )
    for comparison in outcome.comparisons:
        say(f"claim      {comparison.stated()}")
        say(f"           {comparison.sentence()}")
        # For a reconstruction without a claim, the line above says why it is compared with a metre.
        if comparison.unit_known and not comparison.believed and result.source.plan is not None:
            say("           the claim itself is not tied to the ground")
    for remark in result.remarks:
        say(f"{remark.label:10s} {remark.text}")


# Options that apply to only one of the two inputs: to the orthophoto's pixels, or to the model's frames.
OF_ORTHOPHOTO = ("zoom", "gsd_hint", "fast", "target", "known_distance", "ground_control")
OF_MODEL = ("images", "ground_cloud", "mode", "projection", "gps")


def _against_model(
    path: Path, as_json: bool, model: Path, model_detections: Path | None, request: EstimateRequest, dry_run: bool
) -> None:
    from ..actions.cross_check import check_against_model, plan_and_posed
    from ..actions.estimate import measured
    from ..actions.opening import source_of
    from ..actions.rehearsal import rehearsal

    not_of_model = {*OF_ORTHOPHOTO, *(request.of_detector if model_detections is not None else ())}
    if model_detections is not None or request.wanted_mode == "oblique":
        not_of_model.add("measurer")
    of_ortho, of_model = request.without(OF_MODEL), request.without(not_of_model, detections=model_detections)
    with progress_bars() as progress:
        plan = source_of(path, of_ortho)
        posed = source_of(model, of_model, progress)
        plan_and_posed(plan, posed)
        if dry_run:
            tell_rehearsals([rehearsal(path, of_ortho), rehearsal(model, of_model)], as_json)
            return
        ortho, frames = measured(plan, of_ortho, progress), measured(posed, of_model, progress)
    checked = check_against_model(ortho, frames)
    if as_json:
        say_json(checked.document())
    else:
        low, high = checked.interval90_by_model
        say(f"orthophoto {checked.by_ortho:.5g} m/px by the vehicles in it")
        say(f"model      {checked.by_model:.5g} m/px, 90 % {low:.5g} to {high:.5g}")
        for evidence in frames.scale.evidence:
            say(f"also       {evidence.value:.5g} {frames.scale.unit} from {evidence.says}")
        say(f"tied by    {checked.common} vehicles seen in both")
        say(f"           {checked.agreement.sentence()}")
    for result in (ortho, frames):
        if (disagreement := result.disagreement) is not None:
            raise disagreement
    if checked.agreement.contradicts:
        sys.exit(EvidenceDisagrees.exit_code)
