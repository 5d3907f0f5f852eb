"""What the commands share: options, exit codes, progress bars."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

EXIT_CODES = """\b
Exit codes: 0 done; 2 usage; 3 too little evidence (nothing written);
4 evidence disagrees (nothing written without --force);
5 input unreadable or damaged; 6 output could not be written."""


def evidence_options(command: Callable) -> Callable:
    """Options that say what to measure, and how; shared by `fix` and `estimate`."""
    for option in reversed(
        [
            click.argument("path", metavar="INPUT", type=click.Path(path_type=Path)),
            click.option(
                "--fleet", default="world", show_default=True, help="Country code (US, DE, JP ...) or fleet.json."
            ),
            click.option("--images", type=click.Path(path_type=Path), help="Folder of the model's frames."),
            click.option(
                "--detections",
                type=click.Path(path_type=Path),
                help="Boxes from this file; no detector, no frames needed.",
            ),
            click.option(
                "--save-detections", type=click.Path(path_type=Path), help="Keep the boxes found in this file."
            ),
            click.option("--detector", type=click.Path(path_type=Path), help="Another ONNX detector with a card."),
            click.option("--zoom", type=float, help="Detector pixels per picture pixel, instead of the search."),
            click.option("--gsd-hint", type=float, metavar="M", help="Rough metres per pixel, instead of the search."),
            click.option(
                "--mode",
                type=click.Choice(["both", "oblique", "planar"]),
                help="Measure a model in its frames (oblique), in frames warped onto the ground (planar), or both "
                "(the default, where it can be done).",
            ),
            click.option("--json", "as_json", is_flag=True, help="Print the report as JSON on standard output."),
            click.option("--debug", is_flag=True, help="Show the traceback of an error."),
        ]
    ):
        command = option(command)
    return command


@contextmanager
def progress_bars():
    """A callback (what, done, total) that draws bars on a terminal; None when standard error is piped."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, Any] = {}

        def update(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done, total=total)

        yield update
