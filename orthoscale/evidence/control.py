"""Distances and control points that the user knows, read and found in the source."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from ..core.evidence import Evidence, ground_control, known_distance
from ..errors import InputError, UsageError, shown
from ..formats.reading import read_text, reason

if TYPE_CHECKING:
    from ..sources.colmap import ColmapSource
    from ..sources.source import Source

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
    """The known distance that `text` tells of, between two points of `source`. Raises UsageError."""
    try:
        words = shlex.split(text)
        if len(words) not in (3, 4):
            raise ValueError(f"{len(words)} words")
        first, second, metres, *sd = words
        points = [locate(word, source) for word in (first, second)]
        between = f" between {first} and {second}"
        return known_distance(np.array(points), _number(metres), _number(sd[0]) if sd else None, between)
    except (ValueError, OverflowError) as error:
        raise UsageError(f"--known-distance {shown(text)!r}: {reason(error)}", DISTANCE_HINT) from error


def read_control(path: Path, source: Source) -> Evidence:
    """Ground control from the file at `path`, its points in `source`. Raises InputError, UsageError."""
    lines = read_text(path, CONTROL_HINT).splitlines()
    units: list[np.ndarray] = []
    metres: list[list[float]] = []
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            point, *place = shlex.split(line)
            if len(place) not in (2, 3) or (metres and len(place) != len(metres[0])):
                raise ValueError(f"{len(place)} coordinates in metres")
            units.append(locate(point, source))
            metres.append([_number(word) for word in place])
        except (ValueError, OverflowError) as error:
            raise InputError(f"{path}, line {number}: {reason(error)}", CONTROL_HINT) from error
    try:
        return ground_control(np.array(units), np.array(metres))
    except ValueError as error:
        raise InputError(f"{path}: {error}", CONTROL_HINT) from error


def locate(word: str, source: Source) -> np.ndarray:
    """(2,) or (3,) the point that `word` names, in units of `source`. Raises ValueError."""
    if source.unit == "m/px":
        place = _numbers(word)
        if len(place) != 2:
            raise ValueError(f"{word!r} is not a point of an orthophoto")
        return place
    model = cast("ColmapSource", source)
    if word.startswith("id:"):
        return model.point(int(_number(word[3:])))
    if "@" in word:
        name, _, pixel = word.rpartition("@")
        xy = _numbers(pixel)
        if len(xy) != 2:
            raise ValueError(f"{pixel!r} is not a pixel")
        _, place, ok = model.views(name, xy[None])
        if not ok[0]:
            raise ValueError(f"{word!r} does not see the model's ground")
        return place[0]
    place = _numbers(word)
    if len(place) != 3:
        raise ValueError(f"{word!r} is not a point of a model")
    return place


def _numbers(word: str) -> np.ndarray:
    return np.array([_number(part) for part in word.split(",")])


def _number(word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise ValueError(f"{shown(word)!r} is not a finite number")
    return value
