"""`orthoscale calibrate`: measures a detector's ruler on an orthophoto of known scale."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..requests import VehicleRequest
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

# Options that contradict a known scale, or the detection at three resampling factors; `fleet` has its own option.
NOT_HERE = ("fleet", "detections", "calibration", "zoom", "gsd_hint")

NO_MEASURER = (
    "with this file the built-in detector's own boxes count, without the measurer: "
    "at other places the scale is usually less certain with this file than without it"
)


@command(
    epilog="\b\nExamples:\n  orthoscale calibrate survey.tif --fleet DE --out ruler.json\n"
    "  orthoscale calibrate ortho.jpg --gsd 0.0967 --fleet PH \\\n      --detector yolo11n-obb.onnx --out yolo.json\n"
    "  orthoscale fix other.tif --calibration ruler.json --fleet DE --out new.tif\n\n" + MEASURING
)
@click.argument("path", metavar="ORTHO", type=PATH)
@option("--gsd", type=float, metavar="M", group="Input", help="True GSD in m/px; by default the georeferencing's.")
@option(
    "--fleet",
    default="world",
    show_default=True,
    group="Main",
    help="Country of the vehicles, by code or name (US, DE, Japan ...), or a fleet.json.",
)
@option("--local-fleet", is_flag=True, group="Evidence", help="Also fit the mean size of the vehicles here.")
@options_of(VehicleRequest, leave=NOT_HERE)
@option("--out", type=PATH, group="Main", help="Calibration file (.json) to write.")
@overwrite_option
@json_option("the calibration")
@debug_option
def calibrate(path: Path, out: Path | None, overwrite: bool, as_json: bool, **options: Any) -> None:
    """Measure a detector's ruler on an orthophoto of known scale.

    The ruler says how far the detector's boxes exceed vehicles (margin) and how they scatter. Pass the file to `fix` or
    `estimate` with --calibration and the same detector. It helps most for detectors of others. With --local-fleet the
    file also holds the mean size of the vehicles here, for other pictures of the same place.
    """
    from ..actions.calibrate import calibrate as measure
    from ..formats.calibration import calibration_values, save_calibration
    from ..system.outputs import Outputs

    refuse_idle_overwrite(overwrite, out)
    given = VehicleRequest(fleet=options["fleet"], detector=options["detector"]).inputs
    with Outputs(overwrite, (path, given)) as outputs:
        partial = None if out is None else outputs.file(out)
        with progress_bars() as progress:
            calibration = measure(path, progress=progress, **options)
        if partial is not None:
            save_calibration(calibration, partial)
    if as_json:
        say_json(calibration_values(calibration))
        return
    ruler, made = calibration.ruler, calibration.made_from
    lines = [f"detector   {calibration.detector}"]
    for k, axis in enumerate(("length", "width ")):
        lines.append(
            f"{axis}     vehicle {made['size_m'][k]:.2f} +- {made['size_sd_m'][k]:.2f} m, "
            f"box {ruler.margin[k]:+.1f} +- {ruler.margin_sd[k]:.1f} detector px, "
            f"noise {ruler.noise[k]:.1f} px (1 sigma)"
        )
    lines.append(f"vehicles   {made['vehicles']}, at {made['gsd_m']:.4g} m/px, against fleet {made['fleet']}")
    lines += [f"note       {note}" for note in made["notes"]]
    if options["detector"] is None:
        lines.append(f"note       {NO_MEASURER}")
    if out is not None:
        lines.append(f"written    {out}")
    say(*lines)
