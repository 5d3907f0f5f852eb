"""`orthoscale photo`: scale, altitude, GSD and footprint of single photos."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from ..requests import VehicleRequest
from .options import EXIT_CODES, options_of, progress_bars, save_option
from .photo_options import lens_options


@click.command(
    epilog="\b\nExamples:\n  orthoscale photo DJI_0021.JPG --fleet DE\n"
    "  orthoscale photo flight/ --fleet US --out flight.csv --out flight.gpkg\n"
    "  orthoscale photo frame.png --focal-px 1080 --pitch -60 --json\n"
    "  orthoscale photo flight/ --together       one altitude from all photos of a level flight\n\n" + EXIT_CODES
)
@click.argument("paths", metavar="IMAGE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@options_of(VehicleRequest)
@lens_options
@click.option("--together", is_flag=True, help="Also one scale of all photos: one lens, one altitude.")
@save_option
@click.option(
    "--out", "outputs", multiple=True, type=click.Path(path_type=Path), help="Table to write: .csv, .json or .gpkg."
)
@click.option("--overwrite", is_flag=True, help="Replace what is at --out.")
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON on standard output.")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def photo(
    paths: tuple[Path, ...],
    focal_px: float | None,
    lens_file: Path | None,
    pitch: float | None,
    roll: float | None,
    together: bool,
    save_detections: Path | None,
    outputs: tuple[Path, ...],
    overwrite: bool,
    as_json: bool,
    debug: bool,
    **looking: Any,
) -> None:
    """Measure single photos from a drone: IMAGE is a photo or a folder of them.

    The focal length comes from EXIF or XMP (or --focal-px, --lens), pitch and roll from XMP (or --pitch, --roll;
    nadir where nothing tells them). For every photo with at least 5 vehicles: the scale of its nadir view, its altitude
    over the ground where the vehicles stand, the average ground sampling distance, the footprint, each with a 90 %
    interval. The ground is taken to be level.
    """
    from ..errors import TooLittleEvidence
    from ..exchange import check_savable
    from ..photo import looking as boxes
    from ..photo import survey, tables
    from ..photo.measure import find_photos

    how = boxes.Looking.of(looking)
    ruler = how.ruler_fleet()
    tables.check_outputs(outputs, overwrite)
    check_savable(save_detections)
    lens = {"lens_file": lens_file, "focal_px": focal_px, "pitch": pitch, "roll": roll}
    photos, problems = survey.open_photos(find_photos(paths), decode=how.detections is None, **lens)
    with progress_bars() as progress:
        found = boxes.boxes_of(photos, how, progress)
    if save_detections is not None:
        boxes.save_boxes(found, save_detections, photos)
    outcomes = survey.measure_each(photos, problems, found, ruler)
    pooled = survey.measure_together(photos, found, ruler) if together else None
    if pooled is None and not any(outcome.measured for outcome in outcomes):
        most = max(outcomes, key=lambda outcome: len(found.boxes.get(outcome.name, ())))
        raise TooLittleEvidence(
            f"none of {len(outcomes)} photos has enough vehicles; the best is {most.name}: {most.problem}"
            if len(outcomes) > 1
            else f"{most.name}: {most.problem}",
            "Give photos with more vehicles, or pool those of a level flight with --together.",
        )
    text = tables.document(outcomes, ruler.code, found.detector, pooled)
    if outputs:
        tables.write(outcomes, text, outputs, overwrite)
    if as_json:
        click.echo(json.dumps(text))
    else:
        from ..photo.terminal import summary

        click.echo(summary(outcomes, text, pooled, outputs))
