"""`orthoscale locate`: finds where on a map photos were taken."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..requests import LOCATE_METHODS, VehicleRequest
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
from .photo_options import lens_options

if TYPE_CHECKING:
    from ..photos.photo import GivenCamera


@command(
    epilog="\b\nExamples:\n"
    "  orthoscale locate a.jpg --satellite city.tif --fleet DE --out found/\n"
    "  orthoscale locate flight/ --satellite city.tif --gsd 0.08 --out found/ \\\n"
    "      --prior 8.54,47.38,1500\n"
    "  orthoscale locate a.jpg --satellite city.tif --heading search --out found/\n\n"
    + MEASURING.replace("too little evidence", "not located").replace("evidence disagrees", "two places fit")
)
@click.argument("paths", metavar="PHOTO...", nargs=-1, required=True, type=PATH)
@option("--satellite", required=True, type=PATH, group="Main", help="Georeferenced map: satellite or orthophoto.")
@option(
    "--prior",
    metavar="PLACE",
    group="Input",
    help="LON,LAT,RADIUS, or X,Y,RADIUS in the map's own coordinates; radius in metres. The whole map by default.",
)
@option(
    "--heading",
    metavar="DEG",
    group="Input",
    help="Heading of the photo's top, clockwise from north, or `search` to try all; by default XMP's, else all.",
)
@option("--gsd", type=float, metavar="M", group="Input", help="GSD of the photos in m/px; then nothing is measured.")
@option(
    "--method",
    type=click.Choice(LOCATE_METHODS),
    default=LOCATE_METHODS[0],
    show_default=True,
    group="Input",
    help="How photo and map are compared",
)
@option("--embedding", type=PATH, group="Input", help="Your network for retrieval, ONNX.")
@option("--embedding-map", type=PATH, group="Input", help="The one for the map, if it is another.")
@option("--top", type=click.IntRange(1, 20), default=5, group="Output", help="Candidates to list  [default: 5]")
@option("--out", required=True, type=PATH, group="Main", help="Folder to write.")
@options_of(VehicleRequest)
@lens_options
@overwrite_option
@json_option("what was found")
@debug_option
def locate(
    paths: tuple[Path, ...],
    satellite: Path,
    prior: str | None,
    heading: str | None,
    gsd: float | None,
    method: str,
    embedding: Path | None,
    embedding_map: Path | None,
    top: int,
    out: Path,
    overwrite: bool,
    as_json: bool,
    lens: GivenCamera,
    **looking: Any,
) -> None:
    """Find where on a map photos were taken.

    PHOTO is a photo or a folder of photos. Its ground, as large as its vehicles say (or --gsd), is looked for on the
    map and verified by local matches. OUT gets located.json, candidates.csv, located.gpkg and matches.jpg. If a
    photo is not located (exit code 3), or fits two places (4), its candidates are written all the same.
    """
    from ..actions.locate import LocateRequest
    from ..actions.locate import locate as located
    from ..locate.outcome import all_failed
    from ..photos.looking import Looking
    from ..sources.satellite import Satellite
    from ..system.outputs import Outputs

    request = LocateRequest(
        prior=prior,
        heading=heading,
        gsd=gsd,
        method=method,
        embedding=embedding,
        embedding_map=embedding_map,
        top=top,
        lens=lens,
        looking=Looking.of(looking),
    )
    inputs = (paths, satellite, embedding, embedding_map, lens["lens_file"], request.looking.inputs)
    with Outputs(overwrite, inputs) as outputs, progress_bars() as progress:
        folder = outputs.folder(out)
        sky = Satellite.open(satellite)
        outputs.protect(*sky.source.files)
        found = located(paths, sky, request, progress)
        found.write(folder)
    if as_json:
        say_json(found.to_dict())
    else:
        from ..locate.terminal import summary

        say(*summary(found.to_dict(), out))
    failure = all_failed(found.outcomes)
    if failure is not None:
        raise failure
