"""`orthoscale explain`: explains a report's uncertainty in plain words."""

from __future__ import annotations

from pathlib import Path

import click

from .options import CONVERTING, PATH, command, debug_option, json_option, say, say_json


@command(
    epilog="\b\nExamples:\n  orthoscale explain scaled.tif.json\n"
    "  orthoscale estimate ortho.tif --fleet DE --json > report.json\n  orthoscale explain report.json\n\n" + CONVERTING
)
@click.argument("report", metavar="REPORT", type=PATH)
@json_option("the explanation")
@debug_option
def explain(report: Path, as_json: bool) -> None:
    """Explain the uncertainty of a scale, and what would halve it.

    REPORT is the report.json (or OUT.json) that `fix` wrote, or what `estimate --json` printed.
    """
    from ..report import explanation
    from ..report.stored import read_json

    found = explanation.explain(read_json(report))
    say_json(found) if as_json else say(*explanation.in_words(found))
