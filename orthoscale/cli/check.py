"""`orthoscale check`: is the ground sampling distance that an orthophoto claims the one that its vehicles show?"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from ..errors import EvidenceDisagrees, UsageError
from .options import PATH, evidence_options, progress_bars, say


@click.command(
    epilog="\b\nExamples:\n  orthoscale check ortho.tif --fleet DE\n  orthoscale check ortho.tif --fleet US --json\n"
    "  orthoscale check ortho.tif --model sparse/0 --images frames/ --fleet US\n\n"
    "\b\nExit codes: 0 agrees, or too close to call; 2 usage, or INPUT claims no scale;\n"
    "3 too little evidence; 4 disagrees by more than three sigma; 5 input unreadable or damaged."
)
@evidence_options
@click.option(
    "--model",
    type=PATH,
    help="The reconstruction that an orthophoto was made from: check with it.",
)
@click.option("--model-detections", type=PATH, help="Boxes of its frames from this file.")
def check(
    path: Path,
    as_json: bool,
    debug: bool,
    save_detections: Path | None,
    overwrite: bool,
    model: Path | None,
    model_detections: Path | None,
    **options: Any,
) -> None:
    """Compare the scale that INPUT claims with the scale of the vehicles in it. Nothing is written.

    With --model the orthophoto is compared with its source frames instead (--images are theirs): the same vehicles,
    found in both, tie the one to the other, claim or no claim.

    The claim is measured on the ellipsoid at the image's centre: feet, degrees and stretched projections such as
    EPSG:3857 come out in true metres.
    """
    from .. import pipeline
    from ..check import comparisons
    from ..exchange import check_name, save
    from ..outputs import Outputs
    from ..sources.opening import open_source

    if model is not None:
        if save_detections is not None:
            raise UsageError("--save-detections keeps the boxes of one input", "Leave it or --model away.")
        _against_model(path, as_json, model, model_detections, options)
        return
    with Outputs(overwrite, (path, options)) as outputs, progress_bars() as progress:
        if save_detections is not None:
            check_name(save_detections)
            saved = outputs.file(save_detections)
        source = open_source(path, options.pop("images"), need_images=options["detections"] is None)
        outputs.protect(*source.files)
        claimed = getattr(source, "claimed", None)
        if claimed is None or claimed.gsd_m is None:
            why = "" if claimed is None else f": {claimed.why}"
            raise UsageError(f"{path} claims no scale{why}", "Find it by `orthoscale estimate`.")
        result = pipeline.estimate(source, progress=progress, **options)
        if save_detections is not None:
            save(result.detections, saved, source)
    found = comparisons(result)
    low, high = result.scale.interval90
    if as_json:
        report = {
            "comparisons": [c.document() for c in found],
            "scale": result.scale.value,
            "unit": result.scale.unit,
            "interval90": [low, high],
            "vehicles_used": result.scale.vehicles_used,
            "fleet": result.scale.fleet,
            "notes": result.source.notes,
        }
        click.echo(json.dumps(report))
    else:
        click.echo(
            f"vehicles   {result.scale.value:.5g} {result.scale.unit}, 90 % {low:.5g} to {high:.5g}, "
            f"{result.scale.vehicles_used} of fleet {result.scale.fleet}"
        )
        for comparison in found:
            say(f"claim      {comparison.claimed:.5g} {result.scale.unit}: {claimed.why}")
            say(f"           {comparison.sentence()}")
            if not comparison.believed:
                click.echo("           the claim itself is not tied to the ground; it is compared as if it were metres")
        for remark in (*result.scale.remarks, *result.source.notes):
            say(f"note       {remark}")
    if any(c.verdict == "disagrees" for c in found):
        sys.exit(EvidenceDisagrees.exit_code)


def _against_model(
    path: Path, as_json: bool, model: Path, model_detections: Path | None, options: dict[str, Any]
) -> None:
    from .. import pipeline
    from ..cross_check import check_against_model

    images = options.pop("images")
    mode = options.pop("mode")
    with progress_bars() as progress:
        ortho = pipeline.estimate(path, progress=progress, **options)
        options |= {"detections": model_detections, "zoom": None, "gsd_hint": None}
        frames = pipeline.estimate(model, images=images, progress=progress, mode=mode, **options)
    checked = check_against_model(ortho, frames)
    if as_json:
        click.echo(json.dumps(checked.document()))
    else:
        low, high = checked.interval90_by_model
        say(f"orthophoto {checked.by_ortho:.5g} m/px by the vehicles in it")
        say(f"model      {checked.by_model:.5g} m/px, 90 % {low:.5g} to {high:.5g}")
        say(f"tied by    {checked.common} vehicles seen in both")
        say(f"           {checked.agreement.sentence()}")
    if checked.agreement.contradicts:
        sys.exit(EvidenceDisagrees.exit_code)
