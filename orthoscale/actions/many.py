"""Many inputs in one command: each is processed independently, and the failure of one does not affect the others.

An input becomes a job, a dict of plain values. Jobs are sent to processes on this machine or to a Dask cluster, and
each comes back as a row of one table.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from ..core.claims import own_claim
from ..core.source import Source
from ..detect.foreign_worker import receive, send
from ..detect.workers import MOST_THREADS, cluster, cores
from ..errors import LONGEST_MESSAGE, Incomplete, OrthoscaleError, UsageError, shown
from ..report.result import Result
from ..report.summary import COLUMNS, Row
from ..requests import EstimateRequest, FixRequest
from ..sources.location import location_of
from ..system import stopping
from ..system.budget import allow, memory
from ..system.paths import absolute
from ..system.threads import Threads
from .check import checked
from .estimate import measured, noted
from .finished import finished
from .fix import written
from .inputs import outputs_of

BUG = 1
"""Exit code of an input that met a bug of orthoscale, or whose process died."""

Job = dict[str, Any]
"""action, input, out (None unless it is `fix`), settings: those of the request, alone: whether it is the only job."""


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
        out.mkdir(exist_ok=True)
    rows: list[Row] = [{}] * len(todo)
    work = on_cluster(todo, request.scheduler) if request.scheduler is not None else _in_processes(todo, jobs)
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
    """A job for each of `inputs`; the arguments are those of `run_many`. All paths but the inputs' are absolute."""
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
        row |= {"claimed": claim.claimed, "claim": claim.verdict}
    outcome.require_agreement()


def _fill(row: Row, report: Mapping[str, Any], source: Source) -> None:
    """Fill the columns that a `report` of `source` has values for."""
    place, claim = location_of(source), report["claim"]
    row |= {name: report[name] for name in ("scale", "unit", "verdict", "vehicles_used", "fleet", "seconds")}
    row |= {
        "low90": report["interval90"][0],
        "high90": report["interval90"][1],
        "claimed": claim and claim["claimed"],
        "claim": claim and claim["verdict"],
        "longitude": place and place.longitude,
        "latitude": place and place.latitude,
    }


def _fill_by_result(row: Row, result: Result) -> None:
    """As `_fill`, from the few parts of a report that a row shows; a whole one would need the hash of the input."""
    scale = result.scale
    claim = own_claim(result.source, scale)
    report = {
        "scale": scale.value,
        "unit": scale.unit,
        "interval90": scale.interval90,
        "verdict": scale.verdict,
        "vehicles_used": scale.vehicles_used,
        "fleet": scale.fleet,
        "claim": claim and claim.document(),
        "seconds": round(result.seconds, 2),
    }
    _fill(row, report, result.source)


def check_folder(out: Path) -> None:
    """Raise UsageError if `out` is no folder and cannot be made one."""
    if out.is_file():
        raise UsageError(f"{out} is a file; several inputs need a folder", "Choose another place.")
    if not out.absolute().parent.is_dir():
        raise UsageError(f"{out.absolute().parent} is not a folder", "Create it first, or choose another place.")


# --- Who does them ---------------------------------------------------------------------------------------------------


def _in_processes(todo: Sequence[Job], jobs: int) -> Iterator[tuple[int, Row]]:
    free: SimpleQueue[_Child] = SimpleQueue()
    children = [_Child() for _ in range(min(jobs, len(todo)))]
    for child in children:
        free.put(child)

    def give(job: Job) -> Row:
        child = free.get()
        try:
            return child.do(job)
        finally:
            free.put(child)

    with Threads(len(children)) as pool:
        try:
            futures = {pool.submit(give, job): k for k, job in enumerate(todo)}
            for future in as_completed(futures):
                yield futures.pop(future), future.result()
        finally:
            with stopping.held():  # a second signal must not leave any of them running
                for child in children:
                    child.end()
                # A copy that was in place before its process ended is there: the user is told so.
                outputs = [future.result()["output"] for future in futures]
                stopping.written.extend(output for output in outputs if output is not None)
                for child in children:
                    child.close()


class _Child:
    """A process that does jobs, one at a time; one that dies takes only its own job with it."""

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None
        self._over = False

    def do(self, job: Job) -> Row:
        if self._process is None or self._process.poll() is not None:
            if self._over:
                return _died(job, "was stopped")
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C reaches only the parent, which passes it on
            )
        assert self._process.stdin is not None and self._process.stdout is not None  # pipes were asked for
        level = logging.getLogger("orthoscale").level
        try:
            send(self._process.stdin, {"job": job, "memory": memory(), "log": level})
            return receive(self._process.stdout)[0]
        except (EOFError, OSError, ValueError):
            return _died(job, f"ended with {self._process.wait()}")

    def end(self) -> None:
        """Stop the process; it removes what it was writing."""
        self._over = True
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            self._process.wait()

    def close(self) -> None:
        """Close the pipes of a process that has ended, after its last answer was read."""
        for pipe in (self._process.stdin, self._process.stdout) if self._process is not None else ():
            with suppress(OSError):
                pipe.close()  # type: ignore[union-attr]


def _died(job: Job, how: str) -> Row:
    error = {"error": f"its process {how}", "hint": "Run it alone; if memory ran out, allow less by --memory."}
    return {**dict.fromkeys(COLUMNS), "input": job["input"], "exit_code": BUG, **error}


def on_cluster(todo: Sequence[Job], address: str) -> Iterator[tuple[int, Row]]:
    """Do the jobs `todo` on the Dask cluster at `address`; yields the number and row of each as soon as it is done.

    Raises UsageError if no scheduler answers.
    """
    from distributed import as_completed as as_done

    with cluster(address) as client:
        elsewhere = [{**job, "input": str(absolute(job["input"]))} for job in todo]
        futures = {client.submit(_one_within, memory(), job, pure=False): k for k, job in enumerate(elsewhere)}
        try:
            for future in as_done(futures, loop=client.loop):
                k = futures[future]
                # The job of a lost worker goes to another; the cluster gives a job up only if it kills every worker.
                lost = future.exception()
                row = (
                    future.result() if lost is None else _died(todo[k], f"was lost with the cluster's workers ({lost})")
                )
                yield k, {**row, "input": todo[k]["input"]}
        finally:
            client.cancel([future for future in futures if not future.done()])


def _one_within(budget: int, job: Job) -> Row:
    """`one` in a process of its own, with a memory `budget` [byte]."""
    allow(budget)
    return one(job)


def serve() -> None:
    """Do the jobs that come on standard input, until it ends; rows go to standard output."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not mix with the answers
    talk = logging.StreamHandler()
    talk.setFormatter(logging.Formatter("%(levelname)s %(message)s"))
    logging.captureWarnings(True)
    logging.getLogger().addHandler(logging.NullHandler())
    logging.getLogger("orthoscale").addHandler(talk)
    with suppress(EOFError, OSError, KeyboardInterrupt), stopping.listening():
        while True:
            head, _ = receive(requests)
            logging.getLogger("orthoscale").setLevel(head["log"])
            try:
                row = _one_within(head["memory"], job := head["job"])
                stopping.check()  # a library may have swallowed it, and the next job would never come
            except KeyboardInterrupt:
                there = job["out"] if job["out"] in stopping.written else None
                send(answers, {**_died(job, "was stopped"), "output": there})
                raise
            send(answers, row)


if __name__ == "__main__":
    serve()
