"""`orthoscale report`: draws a report's page or picture again from its JSON."""

from __future__ import annotations

import json
from pathlib import Path

import click

from ..system.printing import echo
from .options import CONVERTING, PATH, command, debug_option, memory_option, option, overwrite_option, say


def _print_schema(context: click.Context, parameter: click.Parameter, asked: bool) -> None:
    if asked:
        from ..report.schema import report_schema

        echo(json.dumps(report_schema(), indent=1))
        context.exit()


@command(
    epilog="\b\nExamples:\n  orthoscale report scaled.tif.json\n"
    "  orthoscale estimate ortho.tif --fleet DE --json > estimate.json\n  orthoscale report estimate.json\n\n"
    + CONVERTING
)
@click.argument("path", metavar="REPORT.json", type=PATH)
@option(
    "--schema",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_schema,
    group="Output",
    help="Print the JSON Schema of a report, and do nothing else.",
)
@option("--images", type=PATH, group="Input", help="Folder with the model's frames.")
@option("--out", type=PATH, group="Main", help="Page (.html) or picture (.png) to write  [default: REPORT.html]")
@overwrite_option
@memory_option
@debug_option
def report(path: Path, out: Path | None, images: Path | None, overwrite: bool) -> None:
    """Make the page or the picture of a report, from its JSON.

    REPORT.json is what `fix` wrote, or what `estimate --json` printed. The page is one HTML file that needs nothing
    else. Its pictures come from the input that the report names, if that is there and unchanged; without it the page
    has charts only.
    """
    from ..report.files import redraw

    out = path.with_suffix(".html") if out is None else out
    why = redraw(path, out, images, overwrite)
    if why:
        say(f"without pictures: {why}", err=True)
    say(str(out))
