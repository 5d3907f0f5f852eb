"""What the commands share: options, exit codes, progress bars."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from ..errors import printable

EXIT_CODES = """\b
Exit codes: 0 done; 2 usage; 3 too little evidence (nothing written);
4 evidence disagrees (nothing written without --force);
5 input unreadable or damaged; 6 output could not be written."""


class AnyPath(click.Path):
    """A path that is looked at by those who open it, so that each fault of it has its exit code; an empty one, as an
    unset variable of a script leaves it, is refused: it would be the current folder."""

    def __init__(self) -> None:
        super().__init__(path_type=Path, readable=False)

    def convert(self, value: Any, param: click.Parameter | None, context: click.Context | None) -> Any:
        if not str(value):
            self.fail("an empty name is no path", param, context)
        return Path(value)


PATH = AnyPath()


def say(text: str, err: bool = False) -> None:
    """Print lines on a terminal that take names from files: nothing in them is a control character."""
    click.echo("\n".join(printable(line, longest=20_000) for line in text.split("\n")), err=err)


overwrite_option = click.option("--overwrite", is_flag=True, help="Replace what orthoscale wrote there before.")

save_option = click.option(
    "--save-detections",
    type=PATH,
    help="Keep the boxes found: .json, .coco.json, .txt (DOTA), .geojson or .gpkg.",
)


def detector_options(command: Callable) -> Callable:
    """Options that name a detector."""
    for option in reversed(
        [
            click.option("--detector", type=PATH, help="Another detector, an .onnx file."),
            click.option("--decoder", metavar="NAME", help="Its output layout, where the file does not tell it."),
            click.option(
                "--vehicle-class",
                "vehicle_classes",
                multiple=True,
                metavar="NAME",
                help="Class that counts, by name or number, instead of those called small vehicles; repeatable.",
            ),
        ]
    ):
        command = option(command)
    return command


def vehicle_options(command: Callable) -> Callable:
    """Options that say of which fleet the vehicles are, and where their boxes come from; shared by all that measure."""
    command = detector_options(command)
    for option in reversed(
        [
            click.option(
                "--fleet",
                help="Country code (US, DE, JP ...), 'auto' to find it by the vehicles' shapes, or a fleet.json; "
                "by default the calibration's own, else world.",
            ),
            click.option(
                "--detections",
                type=PATH,
                help="Boxes from this file (.json, .txt, .geojson, .gpkg) or folder; no detector needed.",
            ),
            click.option(
                "--calibration",
                type=PATH,
                help="The detector's ruler as `orthoscale calibrate` measured it.",
            ),
            click.option("--zoom", type=float, help="Detector pixels per picture pixel, instead of the search."),
            click.option("--gsd-hint", type=float, metavar="M", help="Rough metres per pixel, instead of the search."),
        ]
    ):
        command = option(command)
    return command


def evidence_options(command: Callable) -> Callable:
    """Options that say what to measure, and how; shared by `fix` and `estimate`."""
    for option in reversed(
        [
            click.argument("path", metavar="INPUT", type=PATH),
            click.option("--images", type=PATH, help="Folder of the model's frames."),
            save_option,
            overwrite_option,
            click.option(
                "--refine", is_flag=True, help="Look at every vehicle four times more: sharper boxes, for small inputs."
            ),
            click.option(
                "--mode",
                type=click.Choice(["both", "oblique", "planar"]),
                help="Measure a model in its frames (oblique), in frames warped onto the ground (planar), or both "
                "(the default, where it can be done).",
            ),
            click.option(
                "--target",
                type=click.FloatRange(min=0, min_open=True),
                default=0.005,
                show_default=True,
                help="Stop looking at an orthophoto when its sampling uncertainty (one sigma) is at most this.",
            ),
            click.option("--exhaustive", is_flag=True, help="Look at all of an orthophoto."),
            click.option("--seed", type=int, default=0, help="Of the order in which places are looked at."),
            click.option("--workers", type=int, help="Threads; by default one per core, eight at most."),
            click.option("--scheduler", metavar="URL", help="Look on a Dask cluster, such as tcp://host:8786."),
            click.option(
                "--no-cache",
                "cache",
                is_flag=True,
                default=True,
                flag_value=False,
                help="Keep no looks, and use none kept.",
            ),
            click.option(
                "--projection",
                type=click.Choice(["exact", "planar", "decoupled", "program", "naive"]),
                help="From boxes in frames to the ground; exact if not given. The others are for comparison.",
            ),
            click.option(
                "--estimator",
                type=click.Choice(["robust", "iqr"]),
                default="robust",
                show_default=True,
                help="From vehicles to the scale; iqr is the paper's.",
            ),
            click.option(
                "--known-distance",
                multiple=True,
                metavar="'A B M [SD]'",
                help="Two points, the metres between them, their sigma: '120,80 560,80 23.77'. Points are X,Y in an "
                "orthophoto; X,Y,Z, id:NUMBER or FRAME@X,Y in a model. May be given again.",
            ),
            click.option(
                "--ground-control",
                type=PATH,
                metavar="FILE",
                help="Lines of POINT EAST NORTH [UP] in metres; points as for --known-distance.",
            ),
            click.option(
                "--surroundings/--no-surroundings",
                default=True,
                help="Whether parking rows and objects of standard size count, where the boxes show them.",
            ),
            click.option("--json", "as_json", is_flag=True, help="Print the report as JSON on standard output."),
            click.option("--debug", is_flag=True, help="Show the traceback of an error."),
        ]
    ):
        command = option(command)
    return vehicle_options(command)


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
