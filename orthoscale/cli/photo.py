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
    from ..exchange import check_savable
    from ..photos import survey, tables
    from ..photos.looking import Looking, save_boxes

    how = Looking.of(looking)
    tables.check_outputs(outputs, overwrite)
    check_savable(save_detections)
    lens = {"lens_file": lens_file, "focal_px": focal_px, "pitch": pitch, "roll": roll}
    with progress_bars() as progress:
        made = survey.surveyed(paths, how, together, progress, **lens)
    if save_detections is not None:
        save_boxes(made.found, save_detections, made.photos)
    outcomes, pooled = made.outcomes, made.together
    text = tables.document(outcomes, made.fleet.code, made.found.detector, pooled)
    if outputs:
        tables.write(outcomes, text, outputs, overwrite)
    if as_json:
        click.echo(json.dumps(text))
    else:
        from ..photos.terminal import summary

        click.echo(summary(outcomes, text, pooled, outputs))
