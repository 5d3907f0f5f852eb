"""The command line: parse, call, print. A command's module is loaded when it is called."""

from __future__ import annotations

import logging
import signal
import sys
import traceback
from importlib import import_module

import click

from .. import __version__
from ..errors import OrthoscaleError
from .options import EXIT_CODES, set_verbosity

COMMANDS = {  # name: module of this package; the function in it has the command's name
    "estimate": "scale",
    "fix": "scale",
    "explain": "explain",
    "check": "check",
    "apply": "apply",
    "photo": "photo",
    "crop": "crop",
    "layout": "layout",
    "evaluate": "evaluate",
    "report": "report",
    "fleets": "fleets",
    "calibrate": "calibrate",
}


class Commands(click.Group):
    """Commands by name, in the order in which a newcomer meets them."""

    def list_commands(self, context: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        return getattr(import_module(f".{COMMANDS[name]}", __package__), name)


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Start with: orthoscale estimate ORTHO.tif --fleet DE\n\n" + EXIT_CODES,
)
@click.version_option(__version__, prog_name="orthoscale")
@click.option("-v", "--verbose", count=True, help="Tell the steps of the work; twice: everything.")
@click.option("-q", "--quiet", is_flag=True, help="No warnings.")
def cli(verbose: int, quiet: bool) -> None:
    """Give metres back to an orthophoto or a COLMAP model: vehicles are the ruler."""
    set_verbosity(verbose, quiet)


def main() -> None:
    """Entry point: errors become one message and an exit code; `--debug` shows the traceback as well."""
    debug = "--debug" in sys.argv
    # What GDAL and NumPy warn of is for developers; a user is told in notes and errors.
    logging.captureWarnings(True)
    logging.getLogger().addHandler(logging.StreamHandler() if debug else logging.NullHandler())
    # A polite kill cleans up as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        sys.exit(cli.main(standalone_mode=False) or 0)
    except OrthoscaleError as error:
        _complain(error, debug)
        sys.exit(error.exit_code)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("stopped; nothing was written", err=True)
        sys.exit(130)
    except BrokenPipeError:
        sys.exit(141)
    except Exception as error:  # a bug of ours: still no traceback in a user's face
        _complain(error, debug)
        if not debug:
            click.echo("This is a bug in orthoscale. Run again with --debug and report what it shows.", err=True)
        sys.exit(1)


def _complain(error: Exception, debug: bool) -> None:
    if debug:
        traceback.print_exc()
    click.echo(f"error: {error}", err=True)
