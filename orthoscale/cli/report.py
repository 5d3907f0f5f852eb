"""`orthoscale report`: a report's page, drawn again from its JSON."""

from __future__ import annotations

from pathlib import Path

import click

from .options import EXIT_CODES, PATH, memory_option, overwrite_option, say


@click.command(
    epilog="\b\nExamples:\n  orthoscale report scaled.tif.json\n"
    "  orthoscale estimate ortho.tif --fleet DE --json > estimate.json && orthoscale report estimate.json\n\n"
    + EXIT_CODES
)
@click.argument("path", metavar="REPORT.json", type=PATH)
@click.option("--out", type=PATH, help="Page (or .png: the picture) to write  [default: REPORT.html]")
@click.option("--images", type=PATH, help="Folder of the model's frames.")
@overwrite_option
@memory_option
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def report(path: Path, out: Path | None, images: Path | None, overwrite: bool, debug: bool) -> None:
    """Draw the page of a report for people: one HTML file that needs nothing else.

    REPORT.json is what `fix` wrote, or what `estimate --json` printed. The pictures come from the input it names, as
    long as that is there and unchanged; without them there are the charts only.
    """
    from ..report.files import redraw

    out = path.with_suffix(".html") if out is None else out
    why = redraw(path, out, images, overwrite)
    if why:
        say(f"without pictures: {why}", err=True)
    say(str(out))
