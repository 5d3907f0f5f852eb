"""Many results as one table: CSV, JSON, points for a GIS, or a page."""

from __future__ import annotations

import csv
import html
import json
import os
import re
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from ..core.claims import NO_UNIT
from ..core.scale import decimals
from ..errors import UsageError
from ..formats.csv_table import write_csv
from ..formats.degrees import WGS_84
from ..formats.names import in_utf8, write_json
from ..formats.vector import write_layer
from ..system.paths import titles_of
from ..system.signatures import is_signed
from ..system.untouched import inside
from .page import template

SUMMARY_FORMAT = "orthoscale summary 1"
SUMMARY_LAYER = "orthoscale"

# The columns of a summary, with their meaning; values are None where unknown. Intervals are 90 %.
COLUMNS = {
    "input": "its path",
    "exit_code": "what the command would have returned for it alone",
    "scale": "metres per pixel, or per unit of a model",
    "unit": "m/px or m/model-unit",
    "low90": "lower end of the interval",
    "high90": "upper end of it",
    "verdict": "good, fair, poor or unusable",
    "vehicles_used": "the scale rests on these",
    "fleet": "code of the fleet",
    "claimed": "scale that the input claims [m/px, m per unit of a model, or of no unit]",
    "claim": "agrees, doubtful, disagrees or has no unit; or that orthoscale itself gave what agrees",
    "output": "where the scaled copy is",
    "longitude": "of its middle [degrees, WGS 84]",
    "latitude": "of its middle [degrees, WGS 84]",
    "seconds": "wall time",
    "error": "why there is no scale, or no copy",
    "hint": "what to do about it",
}

Row = dict[str, Any]
"""An input, by COLUMNS."""


def check_summary(path: Path, copies: Sequence[Path] = ()) -> None:
    """Raise UsageError unless `path` has an ending of a summary, and where it would lie in one of the `copies` that the
    same command writes, or be named as if it belonged to one, as its report does."""
    if path.suffix.lower() not in SUMMARY_FORMS:
        raise UsageError(f"{path}: a summary ends in {', '.join(SUMMARY_FORMS)}", "Choose one of them.")
    for copy in copies:
        beside = copy.suffix == ".tif" and path.name.lower().startswith(f"{copy.name.lower()}.")
        if inside(path, copy) or beside and inside(path, copy.parent):
            raise UsageError(f"{path} would be taken for a part of the copy {copy}", "Choose another name.")


def is_summary(path: Path) -> bool:
    """Whether `path` is a summary that orthoscale wrote in the format of its ending, and not another output of it, such
    as the report of a copy."""
    return is_signed(path) and SUMMARY_FORMS[path.suffix.lower()].mark.encode() in path.read_bytes()


def inputs_in(path: Path) -> set[str] | None:
    """The inputs in the summary `path`, as `in_utf8` writes them; None if it is damaged or no file."""
    if not path.is_file():  # a pipe would be waited for
        return None
    try:
        return set(map(in_utf8, SUMMARY_FORMS[path.suffix.lower()].inputs(path)))
    except (OSError, ValueError, KeyError, TypeError, RecursionError, csv.Error, sqlite3.Error):
        return None


def _in_csv(path: Path) -> list[str]:
    with path.open(newline="", encoding="utf-8", errors="backslashreplace") as file:
        return [row["input"] for row in csv.DictReader(file)]


def _in_json(path: Path) -> list[str]:
    return [row["input"] for row in json.loads(path.read_text(encoding="utf-8"))["inputs"]]


def _in_points(path: Path) -> list[str]:
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as layer:
        return [name for (name,) in layer.execute(f"SELECT input FROM {SUMMARY_LAYER}")]


def _in_page(path: Path) -> list[str]:
    names = re.findall(r'<td class="name" title="(.*?)">', path.read_text(encoding="utf-8", errors="backslashreplace"))
    return [html.unescape(name) for name in names]


def write_summary(rows: Sequence[Row], path: Path, place: Path) -> None:
    """Write `rows` to `path`, in the format of its ending. Links are relative to `place`, the file's final path. Raises
    OSError."""
    SUMMARY_FORMS[path.suffix.lower()].write(rows, path, place)


def _write_csv(rows: Sequence[Row], path: Path, place: Path) -> None:
    write_csv(path, list(COLUMNS), rows)


def _write_json(rows: Sequence[Row], path: Path, place: Path) -> None:
    write_json({"format": SUMMARY_FORMAT, "inputs": rows}, path)


def _write_points(rows: Sequence[Row], path: Path, place: Path) -> None:
    """A point in the middle of each input with a known place; the others as rows without a geometry."""
    import shapely

    points = [
        None if row["longitude"] is None else shapely.Point(row["longitude"], row["latitude"])  # x, y
        for row in rows
    ]
    write_layer(path, SUMMARY_LAYER, points, rows, "Point", WGS_84)


def _write_page(rows: Sequence[Row], path: Path, place: Path) -> None:
    lines = [
        {**row, "name": name, **_shown(row), "said_claim": claimed(row), "page": _page_of(row, place)}
        for row, name in zip(rows, titles_of([row["input"] for row in rows]), strict=True)
    ]
    good = sum(row["exit_code"] == 0 for row in rows)
    text = template("summary.html").render(lines=lines, good=good, format=SUMMARY_FORMAT)
    path.write_bytes(text.encode("utf-8", "backslashreplace"))  # file names need not be text


def claimed(row: Mapping[str, Any]) -> str:
    """The scale that a row's input claims, with its unit; '' if it claims none."""
    if not row["claim"]:
        return ""
    return f"{row['claimed']:.4g} {'per pixel' if row['claim'] == NO_UNIT else row['unit']}"


def _shown(row: Mapping[str, Any]) -> dict[str, Any]:
    if row["scale"] is None:
        return {"value": "", "low": "", "high": "", "half": None}
    half = (row["high90"] - row["low90"]) / 2
    places = decimals(half)
    numbers = {"value": row["scale"], "low": row["low90"], "high": row["high90"]}
    return {name: f"{value:.{places}f}" for name, value in numbers.items()} | {"half": 100 * half / row["scale"]}


def _page_of(row: Mapping[str, Any], place: Path) -> str:
    """The relative link from `place` to the page of a row's report; '' if there is none."""
    if row["output"] is None:
        return ""
    out = Path(row["output"])
    page = out / "report.html" if out.is_dir() else out.with_name(f"{out.name}.html")
    return quote(os.fsencode(os.path.relpath(page, place.absolute().parent))) if page.is_file() else ""


class SummaryForm(NamedTuple):
    """mark : a text that no other output has. inputs : gives those in a summary. write : as `write_summary`."""

    mark: str
    inputs: Callable[[Path], list[str]]
    write: Callable[[Sequence[Row], Path, Path], None]


SUMMARY_FORMS = {
    ".csv": SummaryForm("input,exit_code,", _in_csv, _write_csv),
    ".json": SummaryForm(SUMMARY_FORMAT, _in_json, _write_json),
    ".gpkg": SummaryForm('"exit_code"', _in_points, _write_points),
    ".html": SummaryForm(SUMMARY_FORMAT, _in_page, _write_page),
}
