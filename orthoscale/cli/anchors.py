"""`orthoscale anchors`: lists and draws the objects of standard size in an orthophoto or a model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..requests import EstimateRequest
from .options import (
    MEASURING,
    PATH,
    command,
    debug_option,
    json_option,
    option,
    options_of,
    overwrite_option,
    progress_bars,
    refuse_idle_overwrite,
    say,
    say_json,
)


@command(
    epilog="\b\nExamples:\n  orthoscale anchors ortho.tif --fleet DE\n"
    "  orthoscale anchors ortho.tif --fleet DE --out anchors.png\n"
    "  orthoscale anchors ortho.tif --scale 0.1 --anchors tennis-court --out found/\n\n" + MEASURING
)
@click.argument("path", metavar="INPUT", type=PATH)
@options_of(EstimateRequest)
@option(
    "--scale",
    type=float,
    metavar="M",
    group="Input",
    help="Rough metres per pixel, or per model unit, instead of measuring the vehicles.",
)
@option(
    "--out",
    type=PATH,
    group="Main",
    help="What to write: a picture (.png), a list (.json), a layer (.gpkg), or a folder for all of them.",
)
@overwrite_option
@json_option("the anchors")
@debug_option
def anchors(path: Path, scale: float | None, out: Path | None, overwrite: bool, as_json: bool, **options: Any) -> None:
    """List and draw the objects of standard size in INPUT.

    Courts, pitches, lane dashes, crossings, parking bays ...: all of them, with the lines that were fitted. They are
    looked for at the scale that the vehicles give, or at --scale.
    """
    from ..actions.list_anchors import list_anchors, one_file
    from ..report.anchors import size_of
    from ..system.outputs import Outputs

    request = EstimateRequest.of(options)
    refuse_idle_overwrite(overwrite, out)
    with Outputs(overwrite, (path, request.inputs)) as outputs, progress_bars() as progress:
        single = out is not None and one_file(out)
        place = None if out is None else outputs.file(out) if single else outputs.folder(out)
        found = list_anchors(path, request, scale, progress)
        outputs.protect(*found.source.files)
        if place is not None:
            (found.write_one if single else found.write)(place)
    told = found.document()
    if as_json:
        say_json(told)
        return
    by = "as told"
    if found.scale is not None:
        by = f"{'by the vehicles' if found.scale.vehicles_used else 'without vehicles'}, {found.scale.within}"
    lines = [f"scale      {told['scale']:.5g} {told['unit']} ({by})"]
    for a in told["anchors"]:
        where = ",".join(f"{v:.0f}" for v in a["place_px"])
        seen = f" and {a['views'] - 1} more" if a["views"] > 1 else ""
        lines += [
            f"{a['kind']}: {size_of(a)}, at {where} in {a['picture']}{seen}",
            f"           alone {a['scale']:.5g} {told['unit']} ({100 * (a['scale'] / told['scale'] - 1):+z.1f} %), "
            f"+- {100 * a['relative_sd']:.2f} % (1 sigma); lines off by {a['residual_cm']:.1f} cm",
        ]
    if not told["anchors"]:
        lines.append("anchors    none")
    lines += [f"note       {note}" for note in told["notes"]]
    if out is not None:
        lines.append(f"written    {out}")
    say(*lines)
