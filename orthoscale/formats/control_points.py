"""Ground control files: one point per line, or OpenDroneMap's list of marks in pictures (``gcp_list.txt``)."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from ..core.remarks import amount
from ..errors import InputError, shown
from .points import WITH_COMMA, decimal_commas, number
from .reading import read_text, reason

CONTROL_HINT = (
    "Expected one point a line, and its place in metres: POINT EAST NORTH [UP], separated by blanks or semicolons. "
    "POINT is X,Y (pixels of an orthophoto), X,Y,Z, id:123 or NAME@X,Y (of a model, which needs UP where the ground "
    "is not level), in double quotes where the name has spaces or backslashes. Lines that begin with # are ignored. Or "
    "OpenDroneMap's gcp_list.txt."
)
EARTH = "EPSG:4978"  # geocentric coordinates [m]
UTM = re.compile(r"WGS84\s+UTM\s+(\d{1,2})\s*([NS])", re.IGNORECASE)
QUOTED = re.compile(r'"[^"]*"')
SYSTEM = re.compile(rf"\s*({UTM.pattern}|EPSG:\d+|.*\+proj=.*)\s*", re.IGNORECASE)


@dataclass(frozen=True)
class ControlPoint:
    """A ground control point.

    row : its (first) line in the file. metres : 2 or 3 coordinates, along axes of any direction. marks : the point in
    the source, as in a POINT column (``NAME@X,Y`` for a picture's pixel); several if several pictures were marked.
    """

    row: int
    metres: tuple[float, ...]
    marks: tuple[str, ...]


@dataclass(frozen=True)
class ControlFile:
    """points : in the file's order. of_project : the marks lie in a project's pictures, which are named by their files
    and need not all be in a model."""

    points: tuple[ControlPoint, ...]
    of_project: bool = False


def read_control_file(path: Path) -> ControlFile:
    """The points of a ground control file. Lines with equal coordinates mark one point in several pictures and are
    joined. Raises InputError.

    A first line that names a coordinate reference system makes it OpenDroneMap's: ``EPSG:32632``, ``WGS84 UTM 32N`` or
    a PROJ string, then lines ``X Y Z COLUMN ROW PICTURE [NAME ...]``. Their coordinates are converted to geocentric
    metres (`EARTH`), so that distances are spatial, whatever the map's units and its scale at that place.

    Columns are separated by blanks or, if all lines have some, by semicolons; in the latter case numbers may have
    decimal commas, if none has a point. Empty cells at the end of a line do not count.
    """
    lines = [
        (row, text)
        for row, line in enumerate(read_text(path, CONTROL_HINT).splitlines(), 1)
        if (text := line.strip().rstrip("; \t")) and not text.startswith("#")
    ]
    if lines and SYSTEM.fullmatch(lines[0][1]):
        return ControlFile(_joined(_of_project(path, lines[0], lines[1:])), of_project=True)
    return ControlFile(_joined(_of_points(path, lines)))


@contextmanager
def in_line(path: Path, row: int) -> Iterator[None]:
    """Turns a ValueError or OverflowError into an InputError that names the line `row` of a ground control file."""
    try:
        yield
    except (ValueError, OverflowError) as error:
        raise InputError(f"{path}, line {row}: {reason(error)}", CONTROL_HINT) from error


def _columns(
    path: Path, lines: Sequence[tuple[int, str]], by_blanks: Callable[[str], list[str]], numbers: slice
) -> list[tuple[int, list[str]]]:
    """The row and the columns of each line: split at semicolons if each line has two or more outside of quotes (three
    columns), else by `by_blanks`. numbers : the columns with numbers; their decimal commas become points."""
    semicolons = all(QUOTED.sub("", line).count(";") >= 2 for _, line in lines)
    rows = []
    for row, line in lines:
        with in_line(path, row):
            rows.append((row, [cell.strip(' \t"') for cell in line.split(";")] if semicolons else by_blanks(line)))
    if semicolons and decimal_commas((cell for _, cells in rows for cell in cells[numbers]), sure=True):
        for _, cells in rows:
            cells[numbers] = [c.replace(",", ".") if WITH_COMMA.fullmatch(c) else c for c in cells[numbers]]
    return rows


def _of_points(path: Path, lines: Sequence[tuple[int, str]]) -> Iterator[ControlPoint]:
    """The points of lines ``POINT EAST NORTH [UP]``."""
    for row, columns in _columns(path, lines, shlex.split, slice(1, None)):
        with in_line(path, row):
            name, *words = columns
            if len(words) not in (2, 3):
                raise ValueError(amount(len(words), "coordinates in metres"))
            yield ControlPoint(row, tuple(number(word) for word in words), (name,))


def _of_project(path: Path, head: tuple[int, str], lines: Sequence[tuple[int, str]]) -> Iterator[ControlPoint]:
    """The points of lines ``X Y Z COLUMN ROW PICTURE [NAME ...]``, in the coordinate reference system of `head`."""
    import pyproj

    row, name = head
    try:
        utm = UTM.fullmatch(name)
        zone = f"+proj=utm +zone={utm[1]} +datum=WGS84{' +south' * (utm[2] in 'Ss')}" if utm else name.strip("'\"")
        to_earth = pyproj.Transformer.from_crs(pyproj.CRS.from_user_input(zone).to_3d(), EARTH, always_xy=True)
    except pyproj.exceptions.ProjError as error:
        raise InputError(
            f"{path}, line {row}: {shown(name)!r} is not a coordinate reference system on Earth", CONTROL_HINT
        ) from error
    for row, words in _columns(path, lines, str.split, slice(5)):
        with in_line(path, row):
            if len(words) < 6:
                raise ValueError(f"{len(words)} words, but X Y Z COLUMN ROW PICTURE are six")
            x, y, z, *_ = map(number, words[:5])
            place = to_earth.transform(x, y, z)
            if not all(map(math.isfinite, place)):
                raise ValueError(f"{' '.join(words[:3])} is not a place in {name}")
            yield ControlPoint(row, place, (f"{words[5]}@{words[3]},{words[4]}",))


def _joined(points: Iterable[ControlPoint]) -> tuple[ControlPoint, ...]:
    """The points; those marked in pictures are joined where their coordinates are equal."""
    joined: dict[object, ControlPoint] = {}
    for point in points:
        key = point.metres if "@" in point.marks[0] else point
        before = joined.get(key)
        joined[key] = point if before is None else replace(before, marks=before.marks + point.marks)
    return tuple(joined.values())
