"""Options, output lines and summary that `estimate`, `fix` and `check` share for several inputs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from ..errors import LONGEST_MESSAGE, UsageError
from ..errors import shown as printable
from ..formats.names import in_utf8
from ..system.paths import absolute
from .dry_run import rehearse, rehearse_in_new_folder
from .options import PATH, option, progress_bars, say, say_json

if TYPE_CHECKING:
    from ..actions.inputs import Named
    from ..report.summary import Row
    from ..requests import EstimateRequest

inputs_argument = click.argument("paths", metavar="INPUT...", type=PATH, nargs=-1, required=True)


@dataclass(frozen=True)
class Many:
    """The options for several inputs: what names them, paths of the summaries, and how many to process at once."""

    named: Named
    summaries: tuple[Path, ...]
    jobs: int | None


def inputs(function: Callable) -> Callable:
    """Adds the argument and the options of a command that takes several inputs. The command gets `path` for one input
    without a summary, and `many` otherwise; the other one is None."""

    @inputs_argument
    @option(
        "--summary",
        type=PATH,
        multiple=True,
        group="Output",
        help="Write one line for each INPUT: .csv, .json, .gpkg (points) or .html (page); repeatable.",
    )
    @option("--jobs", type=click.IntRange(min=1), group="Advanced", help="Number of inputs at once.  [default: 1]")
    @wraps(function)
    def decorated(paths: tuple[Path, ...], summary: tuple[Path, ...], jobs: int | None, **options: Any) -> Any:
        from ..actions.inputs import Named

        named = Named(paths)
        if not summary and not named.many:
            if jobs is not None:
                raise UsageError("--jobs does nothing here: there is one input", "Remove --jobs.")
            return function(path=paths[0], many=None, **options)
        return function(path=None, many=Many(named, summary, jobs), **options)

    return decorated


def run(
    action: str,
    many: Many,
    request: EstimateRequest,
    as_json: bool,
    overwrite: bool,
    out: Path | None = None,
    dry_run: bool = False,
) -> NoReturn:
    """Do `action` for all inputs, print a line for each, write the summaries and exit with the worst exit code.

    Raises UsageError, InputError before anything is done, if the request makes no sense for all of them.
    """
    from ..actions.finished import is_finished
    from ..actions.inputs import outputs_of
    from ..actions.many import check_folder, run_many, worst
    from ..report.summary import SUMMARY_FORMAT, check_summary, is_summary, write_summary
    from ..system.outputs import Outputs

    found = many.named.inputs
    for told in many.named.not_looked_into:
        say(told, err=True)
    places = None if out is None else outputs_of(found, out)
    request.check_for_many()
    if out is not None:
        check_folder(out)
    there = [place for place in places or () if place.exists()]
    replaces = overwrite or (places is not None and _loses_nothing(many.summaries, found, places, request))
    with Outputs(replaces, (found, request.inputs)) as outputs, progress_bars() as progress:
        for summary in many.summaries:
            check_summary(summary, places or ())
        partials = [outputs.file(summary, is_summary) for summary in many.summaries]
        if dry_run and out is not None and not out.exists():
            rehearse_in_new_folder(found, request, out, lambda folder: outputs_of(found, folder), as_json)
        if dry_run:
            leave = partial(is_finished, request=request)
            rehearse(found, request, places, leave=leave, needs_claim=action == "check", as_json=as_json)
        done: list[Row] = []

        def on_row(row: Row) -> None:
            done.append(row)
            if progress:
                progress("Inputs", len(done), len(found))
            if not as_json:
                say(line(row))

        rows = run_many(action, found, request, out, many.jobs or 1, on_row, places)
        for place, summary in zip(partials, many.summaries, strict=True):
            write_summary(rows, place, summary)
    if as_json:
        say_json({"format": SUMMARY_FORMAT, "inputs": rows})
    _tell(rows, set() if overwrite else {str(absolute(place)) for place in there})
    sys.exit(worst(rows))


def _loses_nothing(
    summaries: Sequence[Path], found: Sequence[Path], places: Sequence[Path], request: EstimateRequest
) -> bool:
    """Whether the `summaries` of a former run can be replaced: each has no other inputs than `found`, and every
    existing copy would be left as it is, so that its row is written again. Raises what `finished` raises for a
    different copy."""
    from ..actions.finished import is_finished
    from ..report.summary import inputs_in

    former = [inputs_in(summary) for summary in summaries if summary.exists()]
    if not former or not all(told is not None and told <= {in_utf8(str(path)) for path in found} for told in former):
        return False
    there = [(path, place) for path, place in zip(found, places, strict=True) if place.exists()]
    return all(is_finished(path, place, request) for path, place in there)


def _tell(rows: Sequence[Row], former: set[str]) -> None:
    """Print how many copies existed already (`former`), and what failed."""
    if left := sum(row["output"] in former for row in rows):
        say(f"{left} of {len(rows)} were there already, made from the same input with the same options: kept", err=True)
    failed = [row for row in rows if row["exit_code"]]
    if failed:
        say(f"{len(failed)} of {len(rows)} failed:", err=True)
    for row in failed:
        named = "" if row["error"].startswith(printable(row["input"], LONGEST_MESSAGE)) else f"{row['input']}: "
        say(f"  {named}{row['error']} (exit code {row['exit_code']})", err=True)
        if row["hint"]:
            say(*(f"    {text}" for text in row["hint"].split("\n")), err=True)


def line(row: Row) -> str:
    """A row as text: the scale with its uncertainty, or that there is none."""
    if row["scale"] is None:
        return f"{row['input']}: no scale (exit code {row['exit_code']})"
    from ..core.scale import decimals, interval_about
    from ..report.summary import claimed

    half = (row["high90"] - row["low90"]) / 2
    within = interval_about(row["scale"], row["low90"], row["high90"])
    text = (
        f"{row['input']}: {row['scale']:.{decimals(half)}f} {row['unit']}, {row['verdict']} "
        f"(90 % within {within}), {row['vehicles_used']} vehicles of fleet {row['fleet']}"
    )
    if row["claim"]:
        text += f"; its claim of {claimed(row)} {row['claim']}"
    return text + (f" (exit code {row['exit_code']})" if row["exit_code"] else "")
