"""A CSV table with a box per line, and named columns.

``cx,cy,length,width`` [px] and ``angle`` [rad] or ``angle_deg`` are needed, as in orthoscale's own JSON; ``score``, the
picture and the class are optional, under the same names as GeoJSON's properties.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...core.boxes import Boxes
from ...errors import InputError
from ..reading import Table, read_table, refuse_repeated
from .items import CLASS, PICTURE, SCORE_NAMES, Item, first

FARTHEST_TURNED = 1000.0  # [rad] as in orthoscale's own JSON; of a larger number the angle is chance
NUMBERS = ("cx", "cy", "length", "width")
TABLE_HINT = "Columns: cx, cy, length, width, angle (rad) or angle_deg; where wanted score, picture, class."


def read(path: Path) -> list[Item]:
    """The boxes of a table. Raises InputError."""
    try:
        table = read_table(path, "Give a detections file.")
        names = table.fieldnames or ()
        missing = [name for name in NUMBERS if name not in names]
        missing += ["angle"] if not {"angle", "angle_deg"} & set(names) else []
        if missing:
            raise InputError(f"{path}: no column {' and '.join(missing)}", TABLE_HINT)
        refuse_repeated(path, table, (*NUMBERS, "angle", "angle_deg", *SCORE_NAMES, *CLASS, *PICTURE), TABLE_HINT)
        rows = [_row(row, table) for row in table]
    except csv.Error as error:
        raise InputError(f"{path}: not a CSV table ({error})", TABLE_HINT) from error
    corners = Boxes(np.array([row[0] for row in rows], float).reshape(-1, 5), np.ones(len(rows))).corners
    return [Item(c, score, label, picture) for c, (_, score, label, picture) in zip(corners, rows, strict=True)]


def _row(row: Mapping[str, str], table: Table) -> tuple[list[float], float, str | None, str | None]:
    """A line's box, score, class and picture."""

    def number(name: str, default: float | None = None) -> float:
        value = table.number(row, name, TABLE_HINT)
        value = default if value is None else value
        if value is None:
            raise InputError(f"{table.path}, line {table.line_num}: {name} is '', not a number", TABLE_HINT)
        return value

    box = [*map(number, NUMBERS), number("angle") if "angle" in row else math.radians(number("angle_deg"))]
    if not (min(box[2:4]) > 0 and abs(box[4]) <= FARTHEST_TURNED):
        what = "length and width must be positive, and the angle within 1000 rad"
        raise InputError(f"{table.path}, line {table.line_num}: {what}", TABLE_HINT)
    score = next((name for name in SCORE_NAMES if name in row), "score")
    label, picture = first(row, CLASS), first(row, PICTURE)
    return box, number(score, 1.0), label or None, picture or None
