"""`orthoscale crop`: cuts satellite crops at the scale of a photo."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    say,
    say_json,
)
from .photo_options import LENS_FLAGS, lens_options

if TYPE_CHECKING:
    from ..photos.photo import GivenCamera


@command(
    epilog="\b\nExamples:\n"
    "  orthoscale crop a.jpg --satellite sat.tif --at 8.54,47.38 \\\n      --radius 400 --out crops/\n"
    "  orthoscale crop a.jpg --satellite sat.tif --square --size 384 --out crops/\n"
    "  orthoscale crop a.jpg --satellite sat.tif --gsd 0.08 \\\n      --at 8.54,47.38 --out crops/\n\n" + MEASURING
)
@click.argument("path", metavar="PHOTO", type=PATH)
@option("--satellite", required=True, type=PATH, group="Main", help="Georeferenced satellite picture.")
@option("--at", metavar="LON,LAT", group="Input", help="Centre of the search area; the whole picture by default.")
@option("--radius", type=float, metavar="M", group="Input", help="Half the side of the search area; else one crop.")
@option("--gsd", type=float, metavar="M", group="Input", help="GSD of the photo in m/px; then nothing is measured.")
@option("--out", required=True, type=PATH, group="Main", help="Folder to write.")
@option("--square", is_flag=True, group="Output", help="Square crops, as large as the photo's shorter side.")
@option("--stride", type=float, group="Output", help="Shift between crops, in crop sizes  [default: 0.5]")
@option(
    "--size",
    type=click.IntRange(16, 8192),
    metavar="PX",
    group="Output",
    help="Longer side of the crops; by default the photo's.",
)
@options_of(VehicleRequest)
@lens_options
@overwrite_option
@json_option("the list of crops")
@debug_option
def crop(
    path: Path,
    satellite: Path,
    out: Path,
    at: str | None,
    radius: float | None,
    square: bool,
    stride: float | None,
    size: int | None,
    gsd: float | None,
    overwrite: bool,
    as_json: bool,
    lens: GivenCamera,
    **looking: Any,
) -> None:
    """Cut satellite crops with the footprint of a photo.

    The footprint comes from the photo's vehicles, as in `orthoscale photo`, or from --gsd. Windows of that size are
    cut over the search area, each shifted by --stride, and resampled to the photo's size. OUT gets query.jpg,
    gallery/, manifest.csv (a line per crop: file, longitude, latitude, pixels) and crop.json: a gallery for any
    retrieval network.
    """
    from ..core.scale import with_interval
    from ..errors import UsageError
    from ..photos import crop as cropping
    from ..photos.footprint import footprint_of
    from ..photos.looking import WITH_GSD, Looking
    from ..system.outputs import Outputs

    how = Looking.of(looking)
    if gsd is not None:
        how.refuse_others((), WITH_GSD)
        for told in (LENS_FLAGS[name] for name, value in lens.items() if value is not None):
            raise UsageError(f"{told} does nothing here: {WITH_GSD}", f"Remove {told}.")
    place = _place(at)
    with Outputs(overwrite, (path, satellite, lens["lens_file"], how.inputs)) as outputs, progress_bars() as progress:
        folder = outputs.folder(out)
        sky = cropping.Satellite.open(satellite)
        outputs.protect(*sky.source.files)
        shown = footprint_of(path, gsd, how, progress, **lens)
        whole = shown.picture.width, shown.picture.height
        crops = cropping.plan_crops(sky, shown.gsd, whole, place, radius, square, stride, size)
        cropping.write_crops(crops, shown.picture, shown.told, folder, progress)
    text = cropping.document(crops, shown.told)
    if as_json:
        say_json(text)
        return
    low, high = shown.told.get("gsd_interval90", (None, None))
    gsd_cm = 100 * shown.gsd
    known = with_interval(gsd_cm, 100 * low, 100 * high, "cm/px") if low else f"{gsd_cm:.4g} cm/px (given)"
    metres = f"{crops.size[0]:.1f} x {crops.size[1]:.1f} m"
    pixels = f"{crops.windows[0, 2]} x {crops.windows[0, 3]} px"
    lines = [
        f"crops      {len(crops.windows)} of {metres}, resampled to {crops.out[0]} x {crops.out[1]} px",
        f"photo      {known}",
        f"satellite  {crops.pixel[0]:.4g} x {crops.pixel[1]:.4g} m/px, {pixels} a crop",
        *(f"note       {note}" for note in shown.told.get("notes", ())),
        f"written    {out}: query.jpg, gallery/, manifest.csv, crop.json",
    ]
    say(*lines)


def _place(at: str | None) -> tuple[float, float] | None:
    if at is None:
        return None
    try:
        lon, lat = (float(v) for v in at.split(","))
    except ValueError:
        raise click.BadParameter(f"{at!r} is not LON,LAT in degrees", param_hint="--at") from None
    if not (abs(lon) <= 180 and abs(lat) <= 90):
        raise click.BadParameter(f"{at} is not a longitude and a latitude", param_hint="--at")
    return lon, lat
