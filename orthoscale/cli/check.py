"""`orthoscale check`: is the ground sampling distance that an orthophoto claims the one that its vehicles show?"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from ..errors import EvidenceDisagrees, UsageError
from .options import evidence_options, progress_bars


@click.command(
    epilog="\b\nExamples:\n  orthoscale check ortho.tif --fleet DE\n  orthoscale check ortho.tif --fleet US --json\n\n"
    "\b\nExit codes: 0 agrees, or too close to call; 2 usage, or INPUT claims no scale;\n"
    "3 too little evidence; 4 disagrees by more than three sigma; 5 input unreadable or damaged."
)
@evidence_options
def check(path: Path, as_json: bool, debug: bool, save_detections: Path | None, **options: Any) -> None:
    """Compare the scale that INPUT claims with the scale of the vehicles in it. Nothing is written.

    The claim is measured on the ellipsoid at the image's centre: feet, degrees and stretched projections such as
    EPSG:3857 come out in true metres.
    """
    from .. import pipeline
    from ..check import comparisons

    source = pipeline.open_source(path, options.pop("images"), need_images=options["detections"] is None)
    claimed = getattr(source, "claimed", None)
    if claimed is None or claimed.gsd_m is None:
        why = "" if claimed is None else f": {claimed.why}"
        raise UsageError(f"{path} claims no scale{why}", "Find it by `orthoscale estimate`.")
    with progress_bars() as progress:
        result = pipeline.estimate(source, progress=progress, **options)
    if save_detections is not None:
        from ..atomic import new_file

        with new_file(save_detections, overwrite=True) as partial:
            result.detections.save(partial)
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
            click.echo(f"claim      {comparison.claimed:.5g} {result.scale.unit}: {claimed.why}")
            click.echo(f"           {comparison.sentence()}")
            if not comparison.believed:
                click.echo("           the claim itself is not tied to the ground; it is compared as if it were metres")
        for remark in (*result.scale.remarks, *result.source.notes):
            click.echo(f"note       {remark}")
    if any(c.verdict == "disagrees" for c in found):
        sys.exit(EvidenceDisagrees.exit_code)
