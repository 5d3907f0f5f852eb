"""`orthoscale photo`: measures scale, altitude, GSD and footprint of single photos."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..requests import PhotoRequest
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
    save_option,
    say,
    say_json,
)
from .photo_options import lens_options

if TYPE_CHECKING:
    from ..photos.photo import GivenCamera


@command(
    epilog="\b\nExamples:\n  orthoscale photo DJI_0021.JPG --fleet DE\n"
    "  orthoscale photo flight/ --fleet US --out flight.csv --out flight.gpkg\n"
    "  orthoscale photo frame.png --focal-px 1080 --pitch -60 --json\n"
    "  orthoscale photo flight/ --together       one altitude from all photos\n"
    "  orthoscale photo DJI_0021.JPG --depth DJI_0021.npy --depth-factor da3\n\n" + MEASURING
)
@click.argument("paths", metavar="IMAGE...", nargs=-1, required=True, type=PATH)
@options_of(PhotoRequest)
@lens_options
@option("--together", is_flag=True, group="Evidence", help="Also give one altitude for all photos of a level flight.")
@save_option
@option(
    "--out",
    "outputs",
    multiple=True,
    type=PATH,
    group="Main",
    help="Table to write: .csv, .json or .gpkg; repeatable.",
)
@overwrite_option
@json_option("the table")
@debug_option
def photo(
    paths: tuple[Path, ...],
    lens: GivenCamera,
    together: bool,
    save_detections: Path | None,
    outputs: tuple[Path, ...],
    overwrite: bool,
    as_json: bool,
    **looking: Any,
) -> None:
    """Measure drone photos: altitude, GSD and footprint.

    IMAGE is a photo or a folder of photos. The focal length comes from EXIF or XMP (or --focal-px, --lens), pitch and
    roll from XMP (or --pitch, --roll; nadir if unknown). Every photo with at least 5 vehicles gets the scale of its
    nadir view, its altitude above the ground where the vehicles stand, the mean ground sampling distance and the
    footprint, each with a 90 % interval. The ground is assumed level.
    """
    from ..actions.kept_boxes import KeptBoxes
    from ..photos import survey, tables
    from ..photos.looking import Looking
    from ..system.outputs import Outputs

    refuse_idle_overwrite(overwrite, outputs, save_detections)
    how = Looking.of(looking)
    with Outputs(overwrite, (paths, lens["lens_file"], how.inputs)) as files, progress_bars() as progress:
        for path in outputs:
            tables.check_ending(path)
        partials = [files.file(path) for path in outputs]
        boxes = KeptBoxes(files, save_detections)
        with boxes.telling():
            made = survey.surveyed(paths, how, together, progress, boxes.keep, boxes.check, **lens)
        outcomes, pooled = made.outcomes, made.together
        text = made.to_dict()
        for partial in partials:
            tables.write(outcomes, text, partial)
    if as_json:
        say_json(text)
    else:
        from ..photos.terminal import summary

        written = outputs if save_detections is None else (*outputs, save_detections)
        say(*summary(outcomes, text, pooled, written))
