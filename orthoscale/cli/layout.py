"""`orthoscale layout`: standard facilities on an orthophoto that has its metres."""

from __future__ import annotations

import json
from pathlib import Path

import click

from .options import EXIT_CODES, PATH, memory_option, overwrite_option, say


@click.command(
    epilog="\b\nExamples:\n"
    "  orthoscale layout scaled.tif --lot lot.geojson --facility basketball --facility tennis:2 --out layout/\n"
    "  orthoscale layout scaled.tif --lot lot.gpkg --facility parking-DE:24 --avoid trees.geojson --out layout/\n"
    "  orthoscale layout scaled.tif --lot lot.geojson --facility pool25@120,80,90 --out layout/\n"
    "  orthoscale layout --list\n\n" + EXIT_CODES
)
@click.argument("path", metavar="SCALED.tif", required=False, type=PATH)
@click.option("--lot", type=PATH, help="Polygon to build on: GeoJSON, GeoPackage, Shapefile ...")
@click.option(
    "--facility", "facilities", multiple=True, metavar="CODE", help="CODE, CODE:COUNT or CODE@X,Y,BEARING; repeat it."
)
@click.option("--out", type=PATH, help="Folder to write.")
@click.option("--avoid", type=PATH, help="Polygons to keep free: trees, buildings, water.")
@click.option("--clearance", type=float, default=1.0, show_default=True, metavar="M", help="Between neighbours.")
@click.option("--catalogue", type=PATH, help="Facilities of your own (JSON).")
@click.option("--lot-pixels", is_flag=True, help="Coordinates are columns and rows of the picture.")
@click.option("--scale-error", type=float, metavar="PERCENT", help="Half of the scale's 90 % interval, if no report.")
@click.option("--list", "list_them", is_flag=True, help="List the facilities with their sources, and stop.")
@overwrite_option
@memory_option
@click.option("--json", "as_json", is_flag=True, help="Print the layout as JSON on standard output.")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
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
    debug: bool,
) -> None:
    """Place standard facilities in a lot on SCALED.tif, an orthophoto in metres.

    They lie inside the lot, clear of each other, courts and pitches north to south where that fits. What does not fit
    is told, and by how much. OUT gets the layout as GeoPackage, GeoJSON, DXF and JSON; a mask and a line drawing on the
    orthophoto's own grid, as the conditioning image of a generative renderer, with a prompt; and a picture.
    """
    from ..errors import UsageError
    from ..layout import export
    from ..layout import plan as planning
    from ..layout.terminal import catalogue_table, summary
    from ..system.outputs import Outputs

    if list_them:
        click.echo(catalogue_table(catalogue))
        return
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
            raise UsageError(
                "nothing fits: " + "; ".join(dict.fromkeys(m.sentence() for m in made.missing)),
                "Nothing was written. Give a larger lot, smaller facilities, or less --clearance.",
            )
        outputs.protect(*made.ground.source.files)
        if folder is not None:
            export.write(made, folder)
    click.echo(json.dumps(planning.document(made))) if as_json else say(summary(made, out))
