"""What the commands share: options, exit codes, progress bars."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Collection
from contextlib import contextmanager
from dataclasses import Field, fields
from pathlib import Path
from typing import Any

import click

from ..actions.requests import Option, flag
from ..errors import shown

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
        """A Path of what was given; an empty text is a usage error."""
        if not str(value):
            self.fail("an empty name is no path", param, context)
        return Path(value)


PATH = AnyPath()


def say(text: str, err: bool = False) -> None:
    """Print lines on a terminal that take names from files: nothing in them is a control character."""
    click.echo("\n".join(shown(line, 20_000) for line in text.split("\n")), err=err)


overwrite_option = click.option("--overwrite", is_flag=True, help="Replace what orthoscale wrote there before.")

save_option = click.option(
    "--save-detections",
    type=PATH,
    help="Keep the boxes found: .json, .coco.json, .txt (DOTA), .geojson or .gpkg.",
)


def options_of(request: type, leave: Collection[str] = ()) -> Callable[[Callable], Callable]:
    """The options of a command that makes a `request`: one for each of its fields, but for those to `leave`."""

    def decorated(command: Callable) -> Callable:
        of = [each for each in fields(request) if each.name not in leave]
        if any(each.name == "detector" for each in of):
            command = memory_option(command)
        for each in reversed(of):
            command = _option(each)(command)
        return command

    return decorated


def _allow_memory(context: click.Context, option: click.Parameter, value: str | None) -> None:
    if value is not None:
        from ..system.budget import allow

        allow(value)


memory_option = click.option(
    "--memory",
    metavar="SIZE",
    envvar="ORTHOSCALE_MEMORY",
    callback=_allow_memory,
    expose_value=False,
    help="Memory that pictures, boxes and other detectors may take, such as 2G; by default 1G.",
)


def _option(of: Field) -> Callable[[Callable], Callable]:
    about: Option = of.metadata["option"]
    several = isinstance(of.default, tuple)
    more: dict[str, Any] = {"help": about.help, "default": of.default}
    if about.kind is bool:
        more |= {"is_flag": True} if "/" not in flag(of) else {}
        if of.default is True and "/" not in flag(of):
            more["flag_value"] = False
    else:
        more |= {"type": _type(about), "metavar": about.metavar, "multiple": several}
        more["show_default"] = not several and of.default not in (None, 0)
    return click.option(flag(of), of.name, **more)


def _type(about: Option) -> Any:
    if about.choices:
        return click.Choice(about.choices)
    return PATH if about.kind is Path else about.kind


input_argument = click.argument("path", metavar="INPUT", type=PATH)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the report as JSON on standard output.")
debug_option = click.option("--debug", is_flag=True, help="Show the traceback of an error.")


def set_verbosity(louder: int, quiet: bool) -> None:
    """What the program tells of its work on standard error: warnings, with -v the steps, with -vv everything."""
    level = logging.ERROR if quiet else {0: logging.WARNING, 1: logging.INFO}.get(louder, logging.DEBUG)
    talk = logging.StreamHandler()
    talk.setFormatter(logging.Formatter("%(levelname)s %(message)s"))
    log = logging.getLogger("orthoscale")
    log.setLevel(level)
    log.handlers = [talk]


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
