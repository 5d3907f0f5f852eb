"""Options, exit codes and progress bars that the commands share."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Collection
from contextlib import contextmanager, suppress
from dataclasses import Field
from functools import partial
from pathlib import Path
from typing import Any

import click

from ..errors import UsageError, shown
from ..formats.names import json_in_utf8
from ..option import GROUPS, Option, flag, options_in
from ..system.printing import echo

EXIT_CODES = """\b
Exit codes: 0 done; 2 usage; 3 too little evidence (nothing written);
4 evidence disagrees (`fix` writes nothing without --force);
5 input unreadable or damaged; 6 output could not be written."""
"""Those of `fix`, and of the commands together."""

MEASURING = """\b
Exit codes: 0 done; 2 usage; 3 too little evidence; 4 evidence disagrees;
5 input unreadable or damaged; 6 output could not be written."""
"""Those of other commands that measure vehicles."""

CONVERTING = """\b
Exit codes: 0 done; 2 usage; 5 input unreadable or damaged;
6 output could not be written."""
"""Those of commands that measure nothing."""


class GroupedOption(click.Option):
    """An option with the heading under which the help lists it, one of `GROUPS`."""

    def __init__(self, *arguments: Any, group: str, **more: Any) -> None:
        assert group in GROUPS, group
        super().__init__(*arguments, **more)
        self.group = group


class GroupedCommand(click.Command):
    """A command whose help lists its options under headings."""

    def format_options(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options under the headings of their groups, in the order of GROUPS, required ones first."""
        groups: dict[str, list[tuple[str, str]]] = {group: [] for group in GROUPS}
        for each in sorted(self.get_params(context), key=lambda one: not one.required):
            if isinstance(each, click.Option) and (record := each.get_help_record(context)) is not None:
                groups[getattr(each, "group", GROUPS[-1])].append(record)
        for group, records in groups.items():
            if records:
                with formatter.section(group):
                    formatter.write_dl(records)


command = partial(click.command, cls=GroupedCommand)
option = partial(click.option, cls=GroupedOption)


class AnyPath(click.Path):
    """A path that click does not check: the code that opens it does, so that each fault gets its own exit code. An
    empty path, as from an unset variable of a script, is refused: it would mean the current folder."""

    def __init__(self) -> None:
        super().__init__(path_type=Path, readable=False)

    def convert(self, value: Any, param: click.Parameter | None, context: click.Context | None) -> Any:
        """`value` as a Path; an empty text is a usage error."""
        if not str(value):
            self.fail("an empty name is not a path", param, context)
        return Path(value)


PATH = AnyPath()


def say(*lines: str, err: bool = False) -> None:
    """Print `lines`, which may contain names from files: control characters in them are escaped, line breaks too.

    err : on standard error, where what cannot be printed is lost: nobody can be told of it, and no work may end for it.
    Else raises what `printing` raises.
    """
    text = "\n".join(shown(line, 20_000) for line in lines)
    if not err:
        echo(text)
        return
    with suppress(OSError):
        click.echo(text, err=True)


def say_json(values: Any) -> None:
    """Print plain `values` as JSON. Raises what `printing` raises."""
    echo(json_in_utf8(values))


overwrite_option = option(
    "--overwrite", is_flag=True, group="Output", help="Replace what orthoscale wrote there before."
)


def refuse_idle_overwrite(overwrite: bool, *outputs: object) -> None:
    """Raise UsageError for --overwrite if none of the `outputs` is asked for."""
    if overwrite and not any(outputs):
        raise UsageError("--overwrite does nothing here: nothing is written", "Remove it, or name a file to write.")


save_option = option(
    "--save-detections",
    type=PATH,
    group="Output",
    help="Save the boxes, even if the scale is refused: .json, .coco.json, .txt (DOTA), .geojson or .gpkg.",
)


def options_of(request: type, leave: Collection[str] = ()) -> Callable[[Callable], Callable]:
    """Adds the options of a command that makes a `request`: one for each of its fields, except those in `leave`."""

    def decorated(function: Callable) -> Callable:
        of = [each for each in options_in(request) if each.name not in leave]
        if any(each.name == "detector" for each in of):
            function = memory_option(function)
        for each in reversed(of):
            function = _option(each)(function)
        return function

    return decorated


def _allow_memory(context: click.Context, option: click.Parameter, value: str | None) -> None:
    if value is not None:
        from ..system.budget import allow

        allow(value)


memory_option = option(
    "--memory",
    metavar="SIZE",
    group="Advanced",
    envvar="ORTHOSCALE_MEMORY",
    callback=_allow_memory,
    expose_value=False,
    help="Memory for pictures, boxes and other detectors, such as 2G; by default 1G.",
)


def _option(of: Field) -> Callable[[Callable], Callable]:
    about: Option = of.metadata["option"]
    several = isinstance(of.default, tuple)
    more: dict[str, Any] = {"help": about.help, "group": about.group, "default": of.default}
    if about.kind is bool:
        more |= {"is_flag": True, "flag_value": not of.default}
    else:
        more |= {"type": _type(about), "metavar": about.metavar, "multiple": several}
        more["show_default"] = not several and of.default not in (None, 0)
    return option(flag(of), of.name, **more)


def _type(about: Option) -> Any:
    if about.choices:
        return click.Choice(about.choices)
    return PATH if about.kind is Path else about.kind


def json_option(what: str = "the report") -> Callable[[Callable], Callable]:
    """The option that makes a command print `what` as JSON."""
    return option("--json", "as_json", is_flag=True, group="Output", help=f"Print {what} as JSON on standard output.")


dry_run_option = option(
    "--dry-run",
    is_flag=True,
    group="Advanced",
    help="Check inputs and options and print what would be done; do nothing.",
)

debug_option = option(  # `main` looks for it itself
    "--debug", is_flag=True, expose_value=False, group="Advanced", help="Show the traceback of an error."
)


def set_verbosity(louder: int, quiet: bool) -> None:
    """Set what is logged to standard error: warnings (errors if `quiet`), with -v the steps, with -vv everything."""
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
