"""The command line: parse, call, print. A command's module is loaded when it is called."""

from __future__ import annotations

import errno
import io
import logging
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from importlib import import_module
from typing import Any

import click

from ..errors import LONGEST_MESSAGE, InputError, OrthoscaleError, OutputError, out_of_memory_told, shown
from ..system import quiet, stopping
from ..version import __version__
from .options import EXIT_CODES, say, set_verbosity

COMMANDS = {  # command: module of this package that has the function of that name
    "estimate": "scale",
    "fix": "scale",
    "explain": "explain",
    "check": "check",
    "anchors": "anchors",
    "apply": "apply",
    "photo": "photo",
    "crop": "crop",
    "locate": "locate",
    "layout": "layout",
    "evaluate": "evaluate",
    "report": "report",
    "fleets": "fleets",
    "calibrate": "calibrate",
}

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # errors that only writing can raise
UNREAD = 141  # 128 plus the number of SIGPIPE, as shells count


class Commands(click.Group):
    """Commands by name, in the order in which a newcomer meets them."""

    def list_commands(self, context: click.Context) -> list[str]:
        """The names in the order of COMMANDS, as in the help; nothing is imported."""
        return list(COMMANDS)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        """The command `name`, whose module is imported only now; None if there is none."""
        if name not in COMMANDS:
            return None
        return getattr(import_module(f".{COMMANDS[name]}", __package__), name)

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        """Parse the words before the command's name; prints the help or the version."""
        with _read():
            return super().make_context(*args, **extra)

    def invoke(self, context: click.Context) -> Any:
        """Run the command."""
        with _read():
            return super().invoke(context)


@contextmanager
def _read() -> Iterator[None]:
    """A block that ends the program with UNREAD if nobody reads what it prints any more. click itself would end it with
    1, the exit code of a bug."""
    try:
        yield
    except BrokenPipeError:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - Python flushes it when it ends
        sys.exit(UNREAD)


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Start with: orthoscale estimate ORTHO.tif --fleet DE\n\n" + EXIT_CODES,
)
@click.version_option(__version__, prog_name="orthoscale")
@click.option("-v", "--verbose", count=True, help="Log the steps; -vv: log everything.")
@click.option("-q", "--quiet", is_flag=True, help="Log no warnings.")
def cli(verbose: int, quiet: bool) -> None:
    """Metres for orthophotos and COLMAP models, from the vehicles in them."""
    set_verbosity(verbose, quiet)


def main() -> None:
    """Entry point: errors become one message and an exit code; `--debug` also shows the traceback and what libraries
    print."""
    debug = "--debug" in sys.argv
    # Warnings of GDAL and NumPy are for developers; users get notes and errors.
    logging.captureWarnings(True)
    logging.getLogger().addHandler(logging.StreamHandler() if debug else logging.NullHandler())
    try:
        with stopping.listening(), nullcontext() if debug else quiet.unheard(), _read(), out_of_memory_told():
            result = cli.main(standalone_mode=False) or 0
            stopping.check()
        sys.exit(result)
    except OrthoscaleError as error:
        _complain(error.message, error.hint, debug)
        sys.exit(error.exit_code)
    except click.ClickException as error:
        text = io.StringIO()
        error.show(text)
        say(*text.getvalue().rstrip("\n").split("\n"), err=True)
        if isinstance(error, click.NoSuchOption) and any(error.option_name in each.opts for each in cli.params):
            say(f"It goes before the command: orthoscale {error.option_name} COMMAND ...", err=True)
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        stopping.say(partial(click.echo, err=True))
        sys.exit(stopping.exit_code())
    except OSError as error:  # those of outputs have become OutputErrors already
        if error.errno in NO_ROOM:
            place = "standard output, or a temporary file," if error.filename is None else str(error.filename)
            message = shown(f"{place} cannot be written ({error.strerror})", LONGEST_MESSAGE)
            _complain(message, "Make room on that disk (temporary files: TMPDIR), and run again.", debug)
            sys.exit(OutputError.exit_code)
        place = "" if error.filename is None else f"{error.filename}: "
        message = shown(f"{place}cannot be read ({error.strerror or error})", LONGEST_MESSAGE)
        _complain(message, "Check the file and its permissions.", debug)
        sys.exit(InputError.exit_code)
    except Exception as error:  # a bug of ours; even so, users see no traceback
        _complain(shown(error, LONGEST_MESSAGE), "", debug)
        if not debug:
            click.echo("This is a bug in orthoscale. Run again with --debug and report what it shows.", err=True)
        sys.exit(1)


def _complain(message: str, hint: str, debug: bool) -> None:
    if debug:
        traceback.print_exc()
    say(f"error: {message}", err=True)
    try:
        os.getcwd()
    except OSError:  # then no relative path leads anywhere
        hint = "The current folder has been removed: enter one that exists (cd), and run again."
    if hint:
        say(*hint.split("\n"), err=True)
