"""Distances and control points given by the user: reading them, and locating them in the source."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..core.control import LEVEL_SD, ground_control, ground_shares, known_distance, on_ground
from ..core.evidence import Evidence
from ..core.measuring.footing import BY_POINTS, Footing
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


def read_distance(text: str, source: Source, footing: Footing = BY_POINTS) -> Evidence:
    """The known distance described by `text`, between two points of `source`, whose ground is that of `footing`. Raises
    UsageError."""
    try:
        words = shlex.split(text)
        if len(words) not in (3, 4):
            raise ValueError(f"{len(words)} words")
        *ends, metres = words[:3]
        points = [_located(word, source, footing) for word in ends]
        place = np.array([point.place for point in points])
        read_sd = math.hypot(*(point.read_sd for point in points))
        sd = number(words[3]) if len(words) == 4 else None
        found = known_distance(place, number(metres), sd, f" between {ends[0]} and {ends[1]}", read_sd)
        return _with_ground(found, points, footing)
    except (ValueError, OverflowError) as error:
        raise UsageError(f"--known-distance {shown(text)!r}: {reason(error)}", DISTANCE_HINT) from error


def read_control(path: Path, source: Source, footing: Footing = BY_POINTS) -> Evidence:
    """Ground control from the file at `path`, its points in `source`, whose ground is that of `footing`. Raises
    InputError, UsageError.

    Distances are compared that both sides have: in an orthophoto they are horizontal, whatever UP says; in a model they
    are those in space, or without UP horizontal ones. What is level there is not known: the ground's plane stands for
    it.
    """
    points: list[_ControlPoint] = []
    metres: list[list[float]] = []
    level_sd, dims = 0.0, 3 if source.plan is None else 2
    for row, line in enumerate(read_text(path, CONTROL_HINT).splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            name, *words = shlex.split(line)
            if len(words) not in (2, 3):
                raise ValueError(f"{len(words)} coordinates in metres")
            point, known = _located(name, source, footing), [number(word) for word in words][:dims]
            if metres and len(known) != len(metres[0]):
                raise ValueError(f"{len(words)} coordinates in metres, but {len(metres[0])} above")
            if len(known) == 2 and source.posed is not None:
                point, level_sd = point.from_above(source.posed), LEVEL_SD
            points.append(point)
            metres.append(known)
        except (ValueError, OverflowError) as error:
            raise InputError(f"{path}, line {row}: {reason(error)}", CONTROL_HINT) from error
    try:
        place, read_sd = np.array([point.place for point in points]), np.array([point.read_sd for point in points])
        return _with_ground(ground_control(place, np.array(metres), read_sd, level_sd), points, footing)
    except ValueError as error:
        raise InputError(f"{path}: {error}", CONTROL_HINT) from error


@dataclass(frozen=True)
class _ControlPoint:
    """A point of a source. place, ray : (D,) where it lies, and `core.source.Source.ray` to it [units]. read_sd : one
    sigma of how well it is read [units]. seen : (D,) its place where it was seen [units, world]."""

    place: np.ndarray
    ray: np.ndarray
    read_sd: float
    seen: np.ndarray

    def from_above(self, source: Source) -> _ControlPoint:
        """The same on the plan of `source`."""
        near, far = source.from_above(np.array([self.place - self.ray, self.place]))
        return replace(self, place=far, ray=far - near)


def _located(word: str, source: Source, footing: Footing) -> _ControlPoint:
    """The point of `source` that a user calls `word`, on the ground of `footing` if it was seen on a ground."""
    seen, ray = source.locate(word), source.ray(word)
    lower = float(footing.at(seen[None])[0][0]) if ray.any() else 0.0
    return _ControlPoint(seen + lower * ray, (1 + lower) * ray, source.reading_sd(word), seen)


def _with_ground(found: Evidence, points: list[_ControlPoint], footing: Footing) -> Evidence:
    """What `points` gave, with the error of the ground on which they were seen."""
    rays = np.array([point.ray for point in points])
    if not rays.any():
        return found
    shares = ground_shares(np.array([point.place for point in points]), rays)
    return on_ground(found, shares, footing.covariance(np.array([point.seen for point in points])), footing.shared)
