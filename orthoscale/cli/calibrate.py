"""`orthoscale calibrate`: a detector's ruler, from an orthophoto of known scale."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from ..actions.requests import VehicleRequest
from .options import EXIT_CODES, PATH, options_of, overwrite_option, progress_bars, say

# The scale is known, and the boxes are looked for at three zooms: what says otherwise is not asked for.
NOT_HERE = ("fleet", "detections", "calibration", "zoom", "gsd_hint")


@click.command(
    epilog="\b\nExamples:\n  orthoscale calibrate survey.tif --fleet DE --out ruler.json\n"
    "  orthoscale calibrate ortho.jpg --gsd 0.0967 --fleet PH --detector yolo11n-obb.onnx --out yolo.json\n"
    "  orthoscale fix other.tif --calibration ruler.json --fleet DE --out scaled.tif\n\n" + EXIT_CODES
)
@click.argument("path", metavar="ORTHO", type=PATH)
@click.option("--gsd", type=float, metavar="M", help="Metres per pixel; by default what the georeferencing says.")
@click.option("--fleet", default="world", show_default=True, help="Country code (US, DE, JP ...) or fleet.json.")
@click.option("--local-fleet", is_flag=True, help="Also fit the sizes of the vehicles that stand here.")
@options_of(VehicleRequest, leave=NOT_HERE)
@click.option("--out", type=PATH, help="Calibration file (.json) to write.")
@overwrite_option
@click.option("--json", "as_json", is_flag=True, help="Print the calibration as JSON on standard output.")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def calibrate(path: Path, out: Path | None, overwrite: bool, as_json: bool, debug: bool, **options: Any) -> None:
    """Measure how much a detector's boxes exceed vehicles, on an orthophoto whose scale is known.

    The file is for `fix --calibration` and `estimate --calibration` with the same detector. It helps most for detectors
    of others, whose boxes nobody has measured. With --local-fleet it also holds the sizes of the vehicles that stand
    here, for other pictures of the same place.
    """
    from ..actions.calibrate import calibrate as measure
    from ..formats.calibration import calibration_values, save_calibration
    from ..system.outputs import Outputs

    with Outputs(overwrite, (path, options)) as outputs:
        partial = None if out is None else outputs.file(out)
        with progress_bars() as progress:
            calibration = measure(path, progress=progress, **options)
        if partial is not None:
            save_calibration(calibration, partial)
    if as_json:
        click.echo(json.dumps(calibration_values(calibration)))
        return
    ruler, made = calibration.ruler, calibration.made_from
    lines = [f"detector   {calibration.detector}"]
    for k, axis in enumerate(("length", "width ")):
        lines.append(
            f"{axis}     vehicle {made['size_m'][k]:.2f} +- {made['size_sd_m'][k]:.2f} m, "
            f"box {ruler.margin[k]:+.1f} +- {ruler.margin_sd[k]:.1f} detector px, noise {ruler.noise[k]:.1f} px"
        )
    lines.append(f"vehicles   {made['vehicles']}, at {made['gsd_m']:.4g} m/px, against fleet {made['fleet']}")
    lines += [f"note       {note}" for note in made["notes"]]
    if out is not None:
        lines.append(f"written    {out}")
    say("\n".join(lines))
