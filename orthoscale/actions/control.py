"""Distances and control points given by the user: reading them, and locating them in the source."""

from __future__ import annotations

import math
import shlex
from pathlib import Path

import numpy as np

from ..core.evidence import LEVEL_SD, Evidence, ground_control, known_distance
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
    "POINT is X,Y (pixels of an orthophoto), X,Y,Z, id:123 or NAME@X,Y (of a model, which wants UP where the ground "
    "is not level). Lines from # on do not count."
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
    """Ground control from the file at `path`, its points in `source`. Raises InputError, UsageError.

    Distances are compared that both sides have: in an orthophoto they are horizontal, whatever UP says; in a model they
    are those in space, or without UP horizontal ones. What is level there is not known: the ground's plane stands for
    it.
    """
    units: list[np.ndarray] = []
    read_sd: list[float] = []
    metres: list[list[float]] = []
    level_sd, dims = 0.0, 3 if source.plan is None else 2
    for row, line in enumerate(read_text(path, CONTROL_HINT).splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            point, *words = shlex.split(line)
            if len(words) not in (2, 3):
                raise ValueError(f"{len(words)} coordinates in metres")
            place, known = source.locate(point), [number(word) for word in words][:dims]
            if metres and len(known) != len(metres[0]):
                raise ValueError(f"{len(words)} coordinates in metres, but {len(metres[0])} above")
            if len(known) == 2:
                place = source.from_above(place[None])[0]
                level_sd = LEVEL_SD if source.plan is None else 0.0
            units.append(place)
            read_sd.append(source.reading_sd(point))
            metres.append(known)
        except (ValueError, OverflowError) as error:
            raise InputError(f"{path}, line {row}: {reason(error)}", CONTROL_HINT) from error
    try:
        return ground_control(np.array(units), np.array(metres), np.array(read_sd), level_sd)
    except ValueError as error:
        raise InputError(f"{path}: {error}", CONTROL_HINT) from error
