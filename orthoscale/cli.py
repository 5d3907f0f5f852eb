"""The command line: parse, call, print."""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from . import __version__
from .errors import OrthoscaleError

EXIT_CODES = """\b
Exit codes: 0 done; 2 usage; 3 too little evidence (nothing written);
4 evidence disagrees (nothing written without --force);
5 input unreadable or damaged; 6 output could not be written."""


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Start with: orthoscale estimate ORTHO.tif --fleet DE\n\n" + EXIT_CODES,
)
@click.version_option(__version__, prog_name="orthoscale")
def cli() -> None:
    """Give metres back to an orthophoto or a COLMAP model: vehicles are the ruler."""


def _evidence_options(command: Callable) -> Callable:
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
            click.option("--json", "as_json", is_flag=True, help="Print the report as JSON on standard output."),
            click.option("--debug", is_flag=True, help="Show the traceback of an error."),
        ]
    ):
        command = option(command)
    return command


@cli.command(
    epilog="\b\nExamples:\n  orthoscale estimate ortho.tif --fleet DE\n"
    "  orthoscale estimate sparse/0 --images frames/ --fleet US --json\n\n" + EXIT_CODES
)
@_evidence_options
def estimate(path: Path, as_json: bool, debug: bool, save_detections: Path | None, **options: Any) -> None:
    """Print the scale of INPUT, an orthophoto or the folder of a COLMAP model, and write nothing."""
    from . import pipeline

    with _progress() as progress:
        result = pipeline.estimate(path, progress=progress, **options)
    _finish(result, as_json, save_detections)


@cli.command(
    epilog="\b\nExamples:\n  orthoscale fix ortho.tif --out scaled.tif --fleet PH\n"
    "  orthoscale fix model/ --out scaled/ --fleet US\n"
    "  orthoscale fix model/ --out scaled/ --detections boxes.json\n\n" + EXIT_CODES
)
@_evidence_options
@click.option("--out", required=True, type=click.Path(path_type=Path), help="GeoTIFF or folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace what is at --out.")
@click.option("--override", is_flag=True, help="Rescale although INPUT says that it is in metres.")
@click.option("--force", is_flag=True, help="Write although the evidence is poor or disagrees.")
def fix(path: Path, out: Path, as_json: bool, debug: bool, save_detections: Path | None, **options: Any) -> None:
    """Write a copy of INPUT in metres: an orthophoto with its GSD, or a COLMAP model rescaled.

    An orthophoto's pixels are copied as they are; OUT.json and OUT.png come with it. A model is scaled about its own
    origin; sim3.txt, report.json and vehicles.png come with it. INPUT is never touched.
    """
    from . import pipeline

    with _progress() as progress:
        result = pipeline.fix(path, out, progress=progress, **options)
    _finish(result, as_json, save_detections, out)


@cli.command()
@click.option("--json", "as_json", is_flag=True)
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def fleets(as_json: bool, debug: bool) -> None:
    """List the built-in fleets: sizes, how well they are known, and their sources."""
    from .fleet import Fleet, codes

    table = [Fleet.load(code) for code in codes()]
    if as_json:
        rows = [
            {
                "code": f.code,
                "name": f.name,
                "mean": f.mean.tolist(),
                "sd": f.sd.tolist(),
                "mean_sd": f.mean_sd.tolist(),
                "year": f.year,
                "source": f.source,
            }
            for f in table
        ]
        click.echo(json.dumps(rows, indent=1, ensure_ascii=False))
        return
    for f in table:
        sizes = " x ".join(f"{m:.2f}" for m in f.mean)
        click.echo(f"{f.code:10s} {sizes} m  (mean length known to {100 * f.mean_sd[0] / f.mean[0]:.1f} %)  {f.name}")


def _finish(result: Any, as_json: bool, save_detections: Path | None, out: Path | None = None) -> None:
    if save_detections is not None:
        from .atomic import new_file

        with new_file(save_detections, overwrite=True) as partial:
            result.detections.save(partial)
    if as_json:
        from .report.document import document

        click.echo(json.dumps(document(result)))
    else:
        from .report.terminal import summary

        click.echo(summary(result, out))


@contextmanager
def _progress():
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


def main() -> None:
    """Entry point: errors become one message and an exit code; `--debug` shows the traceback as well."""
    debug = "--debug" in sys.argv
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
