"""`orthoscale photo`: scale, altitude, GSD and footprint of single photos."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from .options import EXIT_CODES, PATH, overwrite_option, progress_bars, save_option, say, vehicle_options
from .photo_options import lens_options


@click.command(
    epilog="\b\nExamples:\n  orthoscale photo DJI_0021.JPG --fleet DE\n"
    "  orthoscale photo flight/ --fleet US --out flight.csv --out flight.gpkg\n"
    "  orthoscale photo frame.png --focal-px 1080 --pitch -60 --json\n"
    "  orthoscale photo flight/ --together       one altitude from all photos of a level flight\n\n" + EXIT_CODES
)
@click.argument("paths", metavar="IMAGE...", nargs=-1, required=True, type=PATH)
@vehicle_options
@lens_options
@click.option("--together", is_flag=True, help="Also one scale of all photos: one lens, one altitude.")
@save_option
@click.option("--out", "outputs", multiple=True, type=PATH, help="Table to write: .csv, .json or .gpkg.")
@overwrite_option
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
    from ..exchange import check_name
    from ..outputs import Outputs
    from ..photo import looking as boxes
    from ..photo import survey, tables
    from ..photo.measure import find_photos

    how = boxes.Looking(**looking)
    ruler = how.ruler_fleet()
    lens = {"lens_file": lens_file, "focal_px": focal_px, "pitch": pitch, "roll": roll}
    with Outputs(overwrite, (paths, lens_file, looking)) as files, progress_bars() as progress:
        for path in outputs:
            tables.check_ending(path)
        partials = [files.file(path, tables.known(path)) for path in outputs]
        if save_detections is not None:
            check_name(save_detections)
            saved = files.file(save_detections)
        photos, problems = survey.open_photos(find_photos(paths), decode=how.detections is None, **lens)
        found = boxes.boxes_of(photos, how, progress)
        if save_detections is not None:  # worth a look above all where they are too few
            boxes.save_boxes(found, saved, photos)
            files.deliver(saved)
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
        for partial in partials:
            tables.write(outcomes, text, partial)
    if as_json:
        click.echo(json.dumps(text))
    else:
        from ..photo.terminal import summary

        say(summary(outcomes, text, pooled, outputs))
