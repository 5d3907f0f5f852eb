"""Copies that an earlier run of `fix` wrote: from which input, and whether they are what is asked for now."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ..core.source import Source
from ..errors import InputError, UsageError
from ..option import flag, options_in
from ..report.extras import chosen
from ..report.inputs import replaced_inputs
from ..report.stored import read_json
from ..requests import EstimateRequest, FixRequest
from ..system.outputs import ELSEWHERE, REPLACE
from ..system.signatures import ours, was_changed
from .fix import report_paths
from .opening import source_of

SAME_COPY = ("overwrite", "workers", "scheduler", "cache")  # options that do not change the copy
PERMITTING = ("force", "override")  # options that may permit a copy, but do not change it


def report_of(out: Path) -> dict[str, Any] | None:
    """The report of the copy at `out`; None if there is none that can be read."""
    try:
        return read_json(_place(out))
    except InputError:
        return None


def _place(out: Path) -> Path:
    return report_paths(out, out.is_dir(), "json")["json"]


def input_of(report: Mapping[str, Any]) -> Path:
    """The input of which a report's copy was made, with all links resolved, whether or not it still exists."""
    return Path(os.path.realpath(Path(report["input"]["folder"]) / report["input"]["path"]))


def finished(path: Path, out: Path, request: FixRequest) -> tuple[dict[str, Any], Source] | None:
    """The report of the copy at `out`, and the opened input at `path`, if an earlier run did what `request` asks.

    None if `request` says to overwrite, or if no report at `out` says how it was made. Raises UsageError for a copy
    that was made from another input or with other options, and what opening the input raises.
    """
    report = None if request.overwrite or not out.exists() else report_of(out)
    if report is None:
        return None
    source = source_of(path, request, to_measure=False)
    if why := _otherwise(source, out, request, report):
        raise UsageError(f"{out} already exists, and {why}", REPLACE if ours(out) else ELSEWHERE)
    return report, source


def is_finished(path: Path, out: Path, request: EstimateRequest) -> bool:
    """Whether `fix` would leave the copy at `out` as it is; raises what `finished` raises."""
    return isinstance(request, FixRequest) and finished(path, out, request) is not None


def _otherwise(source: Source, out: Path, request: FixRequest, report: Mapping[str, Any]) -> str:
    """Why the copy is not what is asked for, as the end of a sentence; '' if it is."""
    if os.path.realpath(source.path) != str(input_of(report)):
        return f"is the copy of {input_of(report)}"
    if other := _other_options(request, report["settings"]):
        return f"was made with other options ({', '.join(other)})"
    if source.content_hash() != report["input"]["sha256"]:
        return f"{source.path}{', or the dense cloud of its ground,' * (source.posed is not None)} has changed since"
    if why := replaced_inputs(report, source, request.inputs):
        return f"its {why}"
    if was_changed(out) if out.is_dir() else not ours(out):
        return f"{out} has changed since it was made"
    written = _place(out).stat().st_mtime
    if out.is_dir() and (part := _later(_copied(out), written)) is not None:
        return f"{part} has changed since it was made"
    beside = [file for file in source.files if file != source.path] if source.plan is not None else []
    if (file := _later([*beside, *request.inputs], written)) is not None:  # of which the report has no hash
        return f"{file} has changed since"
    missing = (part for part in _beside_copy(out, request) if not part.exists())
    return next((f"{part} is missing" for part in missing), "")


def _copied(out: Path) -> list[Path]:
    """The files of a model's copy. The report's JSON is written after them, its page and picture after that."""
    of_report = report_paths(out, True, "html").values()
    return [path for path in out.iterdir() if path.is_file() and path.name[0] != "." and path not in of_report]


def _beside_copy(out: Path, request: FixRequest) -> list[Path]:
    """The parts of the report, and the other files that `request` wants beside the copy."""
    extras = [extra.place(out) for extra in chosen(request.also)]
    return [*report_paths(out, out.is_dir(), request.report).values(), *extras]


def _later(files: Iterable[Path], written: float) -> Path | None:
    """The first of `files` that was changed after the time `written` [s since 1970]; None where none was."""
    return next((file for file in files if file.exists() and file.stat().st_mtime > written), None)


def _other_options(request: FixRequest, settings: Mapping[str, Any]) -> list[str]:
    """Names of the options that differ between `request` and `settings`, those of a report."""
    asked = json.loads(json.dumps(request.with_absolute_paths().settings()))
    return [
        flag(each)
        for each in options_in(request)
        if each.name not in SAME_COPY
        and asked.get(each.name) != settings.get(each.name)
        and not (each.name in PERMITTING and asked.get(each.name))
    ]
