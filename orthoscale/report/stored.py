"""A report as a file: written, and read again, also one of an older version or without some parts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..core.remarks import CAUTION, INFO
from ..core.scale import PER_PIXEL
from ..core.verdicts import FIT
from ..errors import InputError, shown
from ..formats.names import each_text, json_in_utf8, out_of_utf8
from ..formats.reading import LARGE, checked, read_plain

FORMAT = "orthoscale report 2"
# In it remarks were bare sentences, `notes` listed those that only inform, and there were no judgements.
FIRST_FORMAT = "orthoscale report 1"

ORTHOPHOTO, RECONSTRUCTION = "orthophoto", "reconstruction"  # kinds of inputs

# Parts that a report may lack (an orthophoto has no frames, few views show no trend, an older version wrote less), by
# their place in the document, and their defaults, which are those of `formats.schemas.report.Report` for what that
# checks. Everything else is in every report.
OPTIONAL: dict[tuple[str, ...], Any] = {
    ("fleets",): {},
    ("fleet_source",): "",
    ("evidence",): [],
    ("anchors",): [],
    ("without_anchors",): None,
    ("remarks",): [],
    ("judgements",): [],
    ("sweep",): None,
    ("zoom_search",): None,
    ("claim",): None,
    ("agreement",): None,
    ("modes",): {},
    ("modes", "oblique"): None,
    ("modes", "planar"): None,
    ("drift",): None,
    ("drift", "cells"): [],
    ("drift", "frames"): {},
    ("drift", "odd_frames"): [],
    ("drift", "regions"): [],
    ("drift", "trend"): None,
    ("drift", "drifts"): None,
    ("calibration",): None,
    ("calibration", "views"): 0,
    ("calibration", "undercut"): {"card": (0.0, 0.0), "fitted": (0.0, 0.0)},
    ("calibration", "trends"): None,
    ("input", "folder"): "",
    ("input", "kind"): "",
    ("frame_bytes",): {},
    ("frame_crc32",): {},
    ("other_files",): {},
    ("pixel_aspect",): 1.0,
    ("versions",): {},
    ("created",): "",
    ("seconds",): 0.0,
}


def of_plan(report: Mapping[str, Any]) -> bool:
    """Whether the report is of an orthophoto, not of a reconstruction. In older reports only the unit tells."""
    kind = report["input"].get("kind")
    return kind == ORTHOPHOTO if kind else report["unit"] == PER_PIXEL


def pixel_size(report: Mapping[str, Any]) -> tuple[float, float]:
    """Width and height of an orthophoto's pixel on the ground [m]; the scale is the side of a square of equal area."""
    wide = math.sqrt(report["pixel_aspect"])
    return report["scale"] * wide, report["scale"] / wide


def upgraded(report: Any) -> Any:
    """`report` converted from the first format to this one; anything else as it is.

    The judgements that it lacks are not added: only the code that measures can judge.
    """
    if (
        not isinstance(report, dict)
        or report.get("format") != FIRST_FORMAT
        or not isinstance(report.get("remarks"), list)
    ):
        return report
    notes = report.get("notes") or []
    remarks = [{"severity": INFO if text in notes else CAUTION, "text": text} for text in report["remarks"]]
    return {**report, "format": FORMAT, "fit": FIT.get(report.get("verdict", ""), ""), "remarks": remarks}


def completed(report: Mapping[str, Any]) -> dict[str, Any]:
    """`report` with the defaults of OPTIONAL for parts that are absent or null, so that readers need not check."""
    full = dict(report)
    for (*above, name), default in OPTIONAL.items():
        part: Any = full
        for key in above:
            part = part[key]
        if not isinstance(part, dict):
            continue  # the whole part is absent
        if part.get(name) is None:
            part[name] = default
        if isinstance(part[name], Mapping):
            part[name] = dict(part[name])  # a copy, so that defaults are not added to the caller's report
    return full


def write_json(report: Mapping[str, Any], path: Path) -> None:
    """Write the report as UTF-8 to `path`, from where the caller moves it into place; `in_utf8` escapes names that are
    not UTF-8. Raises OSError."""
    path.write_text(json_in_utf8(report, indent=1) + "\n", encoding="utf-8")


def read_json(path: Path) -> dict[str, Any]:
    """Read a report that `write_json` wrote, its escaped names restored. Raises InputError for anything else."""
    from ..formats.schemas.report import Report

    hint = "Give the report.json or OUT.tif.json that `orthoscale fix` wrote, or make it again."
    report = upgraded(read_plain(path, "a report", hint, LARGE))
    found = report.get("format") if isinstance(report, dict) else None
    if found != FORMAT:
        told = f"format {shown(str(found))!r}" if found else "no format"
        raise InputError(f"{path}: a report of another version ({told}, expected {FORMAT!r})", hint)
    checked(report, Report, str(path), "a report", hint)
    return each_text(report, out_of_utf8)
