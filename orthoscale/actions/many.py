"""Many inputs in one command: each is processed independently, and the failure of one does not affect the others.

An input becomes a job, a dict of plain values. Jobs are done in processes on this machine or on a Dask cluster
(`processes`), and each comes back as a row of one table.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..core.claims import own_claim, verdict_on
from ..core.source import Source
from ..detect.workers import MOST_THREADS, cores
from ..errors import LONGEST_MESSAGE, Incomplete, OrthoscaleError, UsageError, out_of_memory_told, shown
from ..report.result import Result
from ..report.summary import COLUMNS, Row
from ..requests import EstimateRequest, FixRequest
from ..sources.location import location_of
from ..system import stopping
from ..system.paths import absolute
from ..system.reserved import writing
from .check import checked
from .estimate import measured, noted
from .finished import finished
from .fix import written
from .inputs import outputs_of
from .processes import BUG, Job, in_processes, on_cluster


def run_many(
    action: str,
    inputs: Sequence[Path],
    request: EstimateRequest,
    out: Path | None = None,
    jobs: int = 1,
    on_row: Callable[[Row], None] = lambda row: None,
    places: Sequence[Path] | None = None,
) -> list[Row]:
    """Do `action` (estimate, fix or check) for each of `inputs`; return a row of COLUMNS for each, in their order.

    out : folder for what `fix` writes, made if need be; an existing copy, made from the same input with the same
    options, is left and counts as made, unless `request` says to overwrite. jobs : how many inputs are processed at
    once, each in a process of its own with its own memory budget; the cores are shared among them. With a Dask
    scheduler in `request` each input is a task there instead, and every machine must see the files under the same
    paths.
    on_row : called with each row as soon as it is done. places : where the copies go, if known already (`outputs_of`).
    Raises UsageError for options that make no sense for many inputs.
    """
    request.check_for_many()
    todo = jobs_of(action, inputs, request, out, jobs, places)
    made = False
    if out is not None:
        made = not out.is_dir()
        check_folder(out)
        with writing(out):
            out.mkdir(exist_ok=True)
    rows: list[Row] = [{}] * len(todo)
    address = request.scheduler
    work = in_processes(todo, jobs, one) if address is None else on_cluster(todo, address, one)
    try:
        for k, row in work:
            rows[k] = row
            if row["output"] is not None:
                stopping.written.append(row["output"])
            on_row(row)
    finally:
        if made and out is not None:
            with suppress(OSError):
                out.rmdir()  # succeeds only if nothing was written
    return rows


def jobs_of(
    action: str,
    inputs: Sequence[Path],
    request: EstimateRequest,
    out: Path | None = None,
    jobs: int = 1,
    places: Sequence[Path] | None = None,
) -> list[Job]:
    """A job for each of `inputs`; the arguments are those of `run_many`. All paths but the inputs' are absolute.

    It has action, input, out (None unless it is `fix`), settings: those of the request, alone: whether it is the only
    job.
    """
    if out is not None and places is None:
        places = outputs_of(inputs, out)
    outs = [None] * len(inputs) if places is None else [str(absolute(place)) for place in places]
    settings = request.without(("scheduler", "workers")).with_absolute_paths().settings()
    if request.detections is None and request.workers is not None:
        settings["workers"] = request.workers
    elif request.detections is None and request.scheduler is None:  # a cluster's machines have cores of their own
        settings["workers"] = min(max(1, cores() // jobs), MOST_THREADS)
    return [
        {"action": action, "input": str(path), "out": place, "settings": settings, "alone": len(inputs) == 1}
        for path, place in zip(inputs, outs, strict=True)
    ]


def worst(rows: Sequence[Row]) -> int:
    """The exit code of the worst row: that of a bug, else the highest."""
    return max((row["exit_code"] for row in rows), key=lambda code: (code == BUG, code), default=0)


def one(job: Job) -> Row:
    """Do one job and return its row; raises only what stops the process."""
    row: Row = {**dict.fromkeys(COLUMNS), "input": job["input"], "exit_code": 0}
    path = absolute(job["input"])
    try:
        try:
            with out_of_memory_told():
                _do(job, path, row)
        except Incomplete as error:
            _fill_by_result(row, error.result)
            row["output"] = job["out"]
            raise
    except OrthoscaleError as error:
        said, named = shown(path, LONGEST_MESSAGE), shown(job["input"], LONGEST_MESSAGE)  # as the user named it
        message, hint = error.message.replace(said, named), error.hint.replace(said, named)
        row |= {"exit_code": error.exit_code, "error": message, "hint": hint}
    except Exception as error:
        logging.getLogger(__name__).exception("%s", path)
        row |= {"exit_code": BUG, "error": shown(f"{type(error).__name__}: {error}", 300)}
        row["hint"] = "This is a bug in orthoscale. Run it alone with --debug and report what it shows."
    return row


def _do(job: dict[str, Any], path: Path, row: Row) -> None:
    if job["action"] == "fix":
        out, asked = Path(job["out"]), replace(FixRequest.of(job["settings"]), alone=job["alone"])
        if (done := finished(path, out, asked)) is not None:
            _fill(row, *done)
        else:
            _fill_by_result(row, written(path, out, asked))
        row["output"] = job["out"]
        return
    request = replace(EstimateRequest.of(job["settings"]), alone=job["alone"])
    if job["action"] == "estimate":
        result = noted(measured(path, request))
        _fill_by_result(row, result)
        result.require_useful()
        return
    outcome = checked(path, request)
    _fill_by_result(row, outcome.result)
    for claim in outcome.comparisons:
        row |= {"claimed": claim.claimed, "claim": verdict_on(outcome.result.source, claim.verdict)}
    outcome.require_agreement()


def _fill(row: Row, report: Mapping[str, Any], source: Source) -> None:
    """Fill the columns that a `report` of `source` has values for."""
    place, claim = location_of(source), report["claim"]
    row |= {name: report[name] for name in ("scale", "unit", "verdict", "vehicles_used", "fleet", "seconds")}
    row |= {
        "low90": report["interval90"][0],
        "high90": report["interval90"][1],
        "claimed": claim and claim["claimed"],
        "claim": claim and verdict_on(source, claim["verdict"]),
        "longitude": place and place.longitude,
        "latitude": place and place.latitude,
    }


def _fill_by_result(row: Row, result: Result) -> None:
    """As `_fill`, from the few parts of a report that a row shows; a whole one would need the hash of the input."""
    scale = result.scale
    claim = own_claim(result.source, scale)
    rest = {"fleet": scale.fleet, "claim": claim and claim.document(), "seconds": round(result.seconds, 2)}
    _fill(row, scale.document() | rest, result.source)


def check_folder(out: Path) -> None:
    """Raise UsageError if `out` is no folder and cannot be made one."""
    if out.is_file():
        raise UsageError(f"{out} is a file; several inputs need a folder", "Choose another place.")
    if not out.absolute().parent.is_dir():
        raise UsageError(f"{out.absolute().parent} is not a folder", "Create it first, or choose another place.")
