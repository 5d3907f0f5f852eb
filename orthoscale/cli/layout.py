"""`orthoscale layout`: places standard facilities on an orthophoto of known scale."""

from __future__ import annotations

import json
from pathlib import Path

import click

from ..system.printing import echo
from .options import (
    PATH,
    command,
    debug_option,
    json_option,
    memory_option,
    option,
    overwrite_option,
    refuse_idle_overwrite,
    say,
    say_json,
)

PLACING = """\b
Exit codes: 0 done; 2 usage; 3 not all facilities fit (the others are placed);
5 input unreadable or damaged; 6 output could not be written."""


@command(
    epilog="\b\nExamples:\n"
    "  orthoscale layout scaled.tif --lot lot.gpkg --facility tennis:2 --out plan/\n"
    "  orthoscale layout scaled.tif --lot lot.gpkg --avoid trees.gpkg \\\n"
    "      --facility parking-DE:24 --facility basketball --out layout/\n"
    "  orthoscale layout scaled.tif --lot lot.gpkg --facility pool25@120,80,90 \\\n      --out layout/\n"
    "  orthoscale layout --list\n\n" + PLACING
)
@click.argument("path", metavar="SCALED.tif", required=False, type=PATH)
@option("--lot", type=PATH, group="Input", help="Polygon to build on: GeoJSON, GeoPackage, Shapefile ...")
@option("--lot-pixels", is_flag=True, group="Input", help="Coordinates, X and Y too, are columns and rows.")
@option(
    "--facility",
    "facilities",
    multiple=True,
    metavar="CODE",
    group="Input",
    help="CODE, CODE:COUNT or CODE@X,Y,BEARING, with X and Y in the orthophoto's coordinates; repeatable.",
)
@option("--avoid", type=PATH, group="Input", help="Polygons to keep free: trees, buildings, water.")
@option("--catalogue", type=PATH, group="Input", help="More facilities, from a JSON file.")
@option(
    "--clearance",
    type=float,
    default=1.0,
    show_default=True,
    metavar="M",
    group="Input",
    help="Distance to neighbours, to the lot's edge and to --avoid.",
)
@option(
    "--scale-error",
    type=float,
    metavar="PERCENT",
    group="Input",
    help="Half of the scale's 90 % interval, instead of the report's.",
)
@option("--out", type=PATH, group="Main", help="Folder to write.")
@option("--list", "list_them", is_flag=True, group="Output", help="List the facilities with their sources, and stop.")
@overwrite_option
@memory_option
@json_option("the layout")
@debug_option
def layout(
    path: Path | None,
    lot: Path | None,
    facilities: tuple[str, ...],
    out: Path | None,
    avoid: Path | None,
    clearance: float,
    catalogue: Path | None,
    lot_pixels: bool,
    scale_error: float | None,
    list_them: bool,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Place courts, pitches and parking on an orthophoto in metres.

    Facilities lie inside the lot and clear of each other, courts and pitches north to south where possible. What
    does not fit is reported with the missing metres, and the exit code is 3. OUT gets the layout as GeoPackage,
    GeoJSON, DXF and JSON; a mask and a line drawing on the orthophoto's own grid, as the conditioning image of a
    generative renderer, with a prompt; and a picture.
    """
    from ..errors import TooLittleRoom, UsageError
    from ..layout import export
    from ..layout import plan as planning
    from ..layout.terminal import catalogue_table, catalogue_values, summary
    from ..system.outputs import Outputs

    if list_them:
        if any((path, lot, facilities, out, avoid, lot_pixels, scale_error is not None, overwrite)):
            raise UsageError("--list only lists the facilities", "Remove the other options, or --list.")
        echo(json.dumps(catalogue_values(catalogue)) if as_json else catalogue_table(catalogue))
        return
    refuse_idle_overwrite(overwrite, out)
    for what, given in (("SCALED.tif", path), ("--lot", lot), ("--facility", facilities)):
        if not given:
            raise click.UsageError(f"{what} is missing")
    assert path is not None and lot is not None
    with Outputs(overwrite, (path, lot, avoid, catalogue)) as outputs:
        folder = None if out is None else outputs.folder(out)
        made = planning.plan(
            path,
            lot,
            facilities,
            catalogue=catalogue,
            avoid=avoid,
            clearance=clearance,
            scale_error=None if scale_error is None else scale_error / 100,
            lot_pixels=lot_pixels,
        )
        if not made.placed:
            raise TooLittleRoom(
                "nothing fits: " + "; ".join(dict.fromkeys(m.sentence() for m in made.missing)),
                "Nothing was written. Give a larger lot, smaller facilities, or less --clearance.",
            )
        outputs.protect(*made.ground.source.files)
        if folder is not None:
            export.write(made, folder)
    say_json(planning.document(made)) if as_json else say(*summary(made, out))
    if made.missing:  # after the layout is written and printed; the exit code keeps scripts from taking it for complete
        count, names = len(made.missing), ", ".join(dict.fromkeys(m.facility.code for m in made.missing))
        raise TooLittleRoom(
            f"{count} of {count + len(made.placed)} facilities {'does' if count == 1 else 'do'} not fit: {names}",
            "Only the others are placed. Give a larger lot, fewer or smaller facilities, or less --clearance.",
        )
