"""A report that is read again from its file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import InputError, shown
from ..formats.names import each_text, out_of_utf8
from ..formats.reading import LARGE, checked, read_plain

FORMAT = "orthoscale report 2"
ORTHOPHOTO, RECONSTRUCTION = "orthophoto", "reconstruction"  # kinds of inputs


def of_plan(report: Mapping[str, Any]) -> bool:
    """Whether the report is of an orthophoto, not of a reconstruction."""
    return report["input"]["kind"] == ORTHOPHOTO


def pixel_size(report: Mapping[str, Any]) -> tuple[float, float]:
    """Width and height of an orthophoto's pixel on the ground [m]; the scale is the side of a square of equal area."""
    wide = math.sqrt(report["pixel_aspect"])
    return report["scale"] * wide, report["scale"] / wide


def read_json(path: Path) -> dict[str, Any]:
    """Read a report that `names.write_json` wrote, its escaped names restored. Raises InputError for anything else."""
    from ..formats.schemas.report import Report

    hint = "Give the report.json or OUT.tif.json that `orthoscale fix` wrote, or make it again."
    report = read_plain(path, "a report", hint, LARGE)
    found = report.get("format") if isinstance(report, dict) else None
    if not found:
        raise InputError(f"{path}: not a report of a scale (it does not name its format, {FORMAT!r})", hint)
    if found != FORMAT:
        told = f"format {shown(str(found))!r}"
        raise InputError(f"{path}: a report of another kind or version ({told}, expected {FORMAT!r})", hint)
    checked(report, Report, str(path), "a report", hint)
    return each_text(report, out_of_utf8)
