"""`orthoscale evaluate`: the method against known altitudes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from ..actions.requests import VehicleRequest
from .options import EXIT_CODES, PATH, options_of, overwrite_option, progress_bars, save_option, say


@click.command(
    epilog="\b\nExamples:\n  orthoscale evaluate DenseUAV/test/query_drone --fleet CN\n"
    "  orthoscale evaluate UAVVisLoc_plus/ --fleet CN --ablations --sensitivity --out visloc.json\n"
    "  orthoscale evaluate photos.csv --fleet DE --detections boxes.json --out errors.csv\n\n" + EXIT_CODES
)
@click.argument("path", metavar="DATASET", type=PATH)
@click.option("--form", type=click.Choice(["denseuav", "visloc", "csv"]), help="Of the data set; guessed by default.")
@click.option("--focal-px", type=float, metavar="PX", help="Focal length, instead of the data set's.")
@click.option("--lens", "lens_file", type=PATH, help="Calibration of the camera, instead of the data set's.")
@options_of(VehicleRequest)
@save_option
@click.option("--max-pitch", type=float, metavar="DEG", help="Leave out photos that look flatter (the paper: -60).")
@click.option("--ablations", is_flag=True, help="Also over score threshold and least number of vehicles.")
@click.option("--sensitivity", is_flag=True, help="Also with wrong pitch and wrong focal length.")
@click.option("--out", "outputs", multiple=True, type=PATH, help=".json for all of it, .csv for the photos.")
@overwrite_option
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON on standard output.")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
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
    """Compare altitudes by vehicles with true ones: the paper's tables on data of your own.

    DATASET is a folder of photos named by their altitude (DenseUAV: 000001/H80.JPG), a folder of regions with drone/,
    reference.txt, camera.xml and a *_dsm.tif (UAV-VisLoc+), or a CSV with the columns image, altitude_m and, where
    wanted, region, focal_px, pitch_deg, roll_deg. Three methods side by side: `exact` is this program's, `paper` the
    paper's formula, `program` what its authors' program computes.
    """
    from ..evaluate import report
    from ..formats.detections import check_name
    from ..photos import looking as boxes
    from ..photos.tables import check_ending
    from ..system.outputs import Outputs

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
        ruler, why = how.ruler_fleet([photo.path for photo in photos])
        notes = [*notes, *why]
        found = boxes.boxes_of(photos, how, progress)
        if save_detections is not None:  # worth a look above all where they are too few
            boxes.save_boxes(found, saved, photos)
            files.deliver(saved)
        text = report.document(samples, found, ruler, notes, ablations, sensitivity, progress)
        for partial in partials:
            report.write(text, partial)
    click.echo(json.dumps(text)) if as_json else say(report.tables(text, outputs))
