"""Distances and control points given by the user: reading them, and locating them in the source."""

from __future__ import annotations

import math
import shlex
from pathlib import Path

import numpy as np

from ..core.evidence import Evidence, ground_control, known_distance
from ..core.source import Source
from ..errors import InputError, UsageError, shown
from ..formats.points import number
from ..formats.reading import read_text, reason

DISTANCE_HINT = (
    "Expected two points, the metres between them and, if known, their sigma: '120,80 560,80 23.77 0.05'. "
    "A point is X,Y (pixels of an orthophoto), X,Y,Z (a model's own coordinates), id:123 (a 3D point of the model) "
    "or NAME@X,Y (a pixel on the ground in one of its frames)."
)
CONTROL_HINT = (
    "Expected one point a line, and where it is in metres: POINT EAST NORTH [UP], separated by spaces. "
    "POINT is X,Y (pixels of an orthophoto), X,Y,Z, id:123 or NAME@X,Y (of a model). Lines from # on do not count."
)


def read_distance(text: str, source: Source) -> Evidence:
    """The known distance described by `text`, between two points of `source`. Raises UsageError."""
    try:
        words = shlex.split(text)
        if len(words) not in (3, 4):
            raise ValueError(f"{len(words)} words")
        first, second, metres, *sd = words
        points = [source.locate(word) for word in (first, second)]
        between = f" between {first} and {second}"
        read_sd = math.hypot(*(source.reading_sd(word) for word in (first, second)))
        return known_distance(np.array(points), number(metres), number(sd[0]) if sd else None, between, read_sd)
    except (ValueError, OverflowError) as error:
        raise UsageError(f"--known-distance {shown(text)!r}: {reason(error)}", DISTANCE_HINT) from error


def read_control(path: Path, source: Source) -> Evidence:
    """Ground control from the file at `path`, its points in `source`. Raises InputError, UsageError."""
    lines = read_text(path, CONTROL_HINT).splitlines()
    units: list[np.ndarray] = []
    read_sd: list[float] = []
    metres: list[list[float]] = []
    for row, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            point, *place = shlex.split(line)
            if len(place) not in (2, 3) or (metres and len(place) != len(metres[0])):
                raise ValueError(f"{len(place)} coordinates in metres")
            units.append(source.locate(point))
            read_sd.append(source.reading_sd(point))
            metres.append([number(word) for word in place])
        except (ValueError, OverflowError) as error:
            raise InputError(f"{path}, line {row}: {reason(error)}", CONTROL_HINT) from error
    try:
        return ground_control(np.array(units), np.array(metres), np.array(read_sd))
    except ValueError as error:
        raise InputError(f"{path}: {error}", CONTROL_HINT) from error
