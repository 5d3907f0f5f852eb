"""`orthoscale evaluate`: the method against known altitudes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from ..actions.requests import PhotoRequest
from .options import (
    EXIT_CODES,
    PATH,
    command,
    debug_option,
    json_option,
    option,
    options_of,
    overwrite_option,
    progress_bars,
    refuse_idle_overwrite,
    save_option,
    say,
)


@command(
    epilog="\b\nExamples:\n  orthoscale evaluate DenseUAV/test/query_drone --fleet CN\n"
    "  orthoscale evaluate UAVVisLoc_plus/ --fleet CN --ablations --out visloc.json\n"
    "  orthoscale evaluate photos.csv --fleet DE --detections b.json --out e.csv\n"
    "  orthoscale evaluate photos.csv --depth-folder depth/ --depth-factor da3\n\n" + EXIT_CODES
)
@click.argument("path", metavar="DATASET", type=PATH)
@option(
    "--form",
    type=click.Choice(["denseuav", "visloc", "csv"]),
    group="Input",
    help="Form of the data set; by default recognised.",
)
@option("--focal-px", type=float, metavar="PX", group="Input", help="Focal length, instead of the data set's.")
@option("--lens", "lens_file", type=PATH, group="Input", help="Camera calibration, instead of the data set's.")
@options_of(PhotoRequest, leave=("depth",))
@option(
    "--depth-folder",
    "--depth",
    "depth",
    type=PATH,
    group="Evidence",
    help="Metric depth to compare with: a folder of .npy, .tif or .png named as the photos are, or a network (.onnx).",
)
@save_option
@option("--max-pitch", type=float, metavar="DEG", group="Input", help="Skip photos with a flatter view (paper: -60).")
@option("--ablations", is_flag=True, group="Advanced", help="Also vary the score threshold and the number of vehicles.")
@option("--sensitivity", is_flag=True, group="Advanced", help="Also with wrong pitch and wrong focal length.")
@option(
    "--out",
    "outputs",
    multiple=True,
    type=PATH,
    group="Output",
    help="File to write: .json (everything) or .csv (a line per photo); repeatable.",
)
@overwrite_option
@json_option("everything")
@debug_option
def evaluate(
    path: Path,
    form: str | None,
    focal_px: float | None,
    lens_file: Path | None,
    save_detections: Path | None,
    max_pitch: float | None,
    ablations: bool,
    sensitivity: bool,
    outputs: tuple[Path, ...],
    overwrite: bool,
    as_json: bool,
    debug: bool,
    **looking: Any,
) -> None:
    """Compare altitudes by vehicles with true ones, on a data set.

    Prints the paper's tables for your data. DATASET is a folder of photos named by their altitude (DenseUAV:
    000001/H80.JPG), a folder of regions with drone/, reference.txt, camera.xml and a *_dsm.tif (UAV-VisLoc+), or a
    CSV with the columns image, altitude_m and, where wanted, region, focal_px, pitch_deg, roll_deg. Three methods
    side by side: `exact` is this program's, `paper` the paper's formula, `program` what its authors' program
    computes.
    """
    from ..evaluate import report
    from ..formats.detections import check_name
    from ..photos import looking as boxes
    from ..photos.depth.maps import Depths
    from ..photos.tables import check_ending
    from ..system.outputs import Outputs

    refuse_idle_overwrite(overwrite, outputs, save_detections)
    how = boxes.Looking.of(looking)
    with Outputs(overwrite, (path, lens_file, looking)) as files, progress_bars() as progress:
        for output in outputs:
            check_ending(output, (".json", ".csv"))
        partials = [files.file(output, report.known(output)) for output in outputs]
        if save_detections is not None:
            check_name(save_detections)
            saved = files.file(save_detections)
        samples, notes = report.samples_of(path, form, lens_file, focal_px, max_pitch)
        photos = [sample.photo for sample in samples]
        depths = Depths.asked(how, several=len(photos) > 1)
        ruler, why = how.ruler_fleet([photo.path for photo in photos])
        notes = [*notes, *why]
        found = boxes.boxes_of(photos, how, progress)
        if save_detections is not None:  # worth a look above all where they are too few
            boxes.save_boxes(found, saved, photos)
            files.deliver(saved)
        text = report.document(samples, found, ruler, notes, ablations, sensitivity, progress, depths)
        for partial in partials:
            report.write(text, partial)
    click.echo(json.dumps(text)) if as_json else say(report.tables(text, outputs))
