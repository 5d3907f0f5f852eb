"""Distances and control points given by the user: reading them, and locating them in the source."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath

import numpy as np

from ..core.control import (
    LEVEL_SD,
    READING_SD,
    ground_control,
    ground_shares,
    known_distance,
    meeting_point,
    missed_by,
    on_ground,
    widest_angle,
)
from ..core.evidence import Evidence
from ..core.measuring.footing import BY_POINTS, Footing
from ..core.source import Located, OffGround, Source
from ..errors import InputError, UsageError, shown
from ..formats.control_points import CONTROL_HINT, in_line, read_control_file
from ..formats.names import composed
from ..formats.points import number
from ..formats.reading import reason

DISTANCE_HINT = (
    "Expected two points, the metres between them and, if known, their sigma: '120,80 560,80 23.77 0.05'. "
    "A point is X,Y (pixels of an orthophoto), X,Y,Z (a model's own coordinates), id:123 (a 3D point of the model) "
    "or NAME@X,Y (a pixel on the ground in one of its frames), in double quotes where the name has spaces or "
    "backslashes."
)
# With a smaller angle between the rays to a point, its distance is less certain than from the ground, which is known to
# 1 % of the cameras' height: pixels are read to half a pixel, and poses are no better.
PARALLAX = math.radians(3)
# [px] A mark farther than this from where the rays of its point meet belongs to another point: errors of poses and of
# people are some pixels at most.
MISSED = 20.0


def read_distance(text: str, source: Source, footing: Footing = BY_POINTS) -> Evidence:
    """The known distance described by `text`, between two points of `source`; `footing` is its ground. Raises
    UsageError."""
    try:
        words = shlex.split(text)
        if len(words) not in (3, 4):
            raise ValueError(f"{len(words)} words, not 3 or 4")
        *ends, metres = words[:3]
        points = [_Footed.on(footing, source.locate(word)) for word in ends]
        place = np.array([point.place for point in points])
        read_sd = math.hypot(*(point.read_sd for point in points))
        sd = number(words[3]) if len(words) == 4 else None
        found = known_distance(place, number(metres), sd, f" between {ends[0]} and {ends[1]}", read_sd)
        return _with_ground(found, points, footing)
    except (ValueError, OverflowError) as error:
        raise UsageError(f"--known-distance {shown(text)!r}: {reason(error)}", DISTANCE_HINT) from error


def read_control(path: Path, source: Source, footing: Footing = BY_POINTS) -> Evidence:
    """Ground control from the file at `path` (`read_control_file`), with its points located in `source`; `footing` is
    the ground of `source`. Raises InputError, UsageError.

    The distances that are compared are horizontal in an orthophoto, whatever UP says; in a model they are spatial, or
    horizontal without UP. A model does not say what is horizontal: the plane of its ground is taken. A point marked in
    several pictures lies where their rays meet, one marked in a single picture lies on the ground.
    """
    file = read_control_file(path)
    if file.of_project and source.posed is None:
        raise UsageError(
            f"{path}: it marks points in a project's pictures, and {source.path} is an orthophoto",
            "Give lines X,Y EAST NORTH, X,Y pixels of the orthophoto.",
        )
    points: list[_Footed] = []
    metres: list[tuple[float, ...]] = []
    level_sd, dims = 0.0, 3 if source.plan is None else 2
    named = _by_file_name(source.picture_names)
    for control in file.points:
        with in_line(path, control.row):
            marks = _in_model(control.marks, named) if file.of_project else control.marks
            if not marks:
                continue
            point, known = _control_point(marks, source, footing), control.metres[:dims]
            if metres and len(known) != len(metres[0]):
                raise ValueError(f"{len(control.metres)} coordinates in metres, but {len(metres[0])} above")
            if len(known) == 2 and source.posed is not None:
                point, level_sd = point.from_above(source), LEVEL_SD
            points.append(point)
            metres.append(known)
    how = []
    if met := sum(point.met for point in points):
        how.append(f"{met} of them from intersecting rays")
    if left_out := len(file.points) - len(points):
        how.append(f"{left_out} more in no picture of the model")
    try:
        place, read_sd = np.array([point.place for point in points]), np.array([point.read_sd for point in points])
        return _with_ground(ground_control(place, np.array(metres), read_sd, level_sd, how), points, footing)
    except ValueError as error:
        raise InputError(f"{path}: {reason(error)}", CONTROL_HINT) from error


def _by_file_name(names: Iterable[str]) -> dict[str, list[str]]:
    """The names of a model's pictures, which may include folders, by their bare file names."""
    named: dict[str, list[str]] = {}
    for name in names:
        named.setdefault(_bare(name), []).append(name)
    return named


def _bare(name: str) -> str:
    """The name of a picture without its folders, which may be separated by backslashes."""
    return composed(PureWindowsPath(name).name)


def _in_model(marks: Sequence[str], named: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """The `marks` of a project that lie in the model's pictures, with the model's names for these. named : these names
    by bare file name."""
    found: list[str] = []
    for mark in marks:
        picture, _, place = mark.rpartition("@")
        names = named.get(_bare(picture), ())
        if len(names) > 1:
            names = [name for name in names if name == picture]
        found.extend(f"{name}@{place}" for name in names)
    return tuple(found)


@dataclass(frozen=True)
class _Footed:
    """A point of a source on its true ground. place, read_sd, ray : as in `core.source.Located`. seen : (D,) its place
    before it was moved to that ground [units, world]. met : it lies where several rays meet, whatever the ground."""

    place: np.ndarray
    read_sd: float
    ray: np.ndarray
    seen: np.ndarray
    met: bool = False

    @classmethod
    def on(cls, footing: Footing, point: Located) -> _Footed:
        """`point` moved to the ground of `footing`, if it was located by a ray that meets the ground."""
        lower = float(footing.at(point.place[None])[0][0]) if point.ray.any() else 0.0
        return cls(point.place + lower * point.ray, point.read_sd, (1 + lower) * point.ray, point.place)

    def from_above(self, source: Source) -> _Footed:
        """The same point projected onto the plan of `source`."""
        near, far = source.from_above(np.array([self.place - self.ray, self.place]))
        return replace(self, place=far, ray=far - near)


def _control_point(marks: Sequence[str], source: Source, footing: Footing) -> _Footed:
    """The point of `source` that all `marks` show: where their rays meet, if these differ by PARALLAX or more; else the
    point of the first mark. Marks near the horizon count only if there is no other. Raises ValueError if the rays do
    not meet."""
    seen: dict[str, Located] = {}
    for mark in marks:
        try:
            seen[mark] = source.locate(mark)
        except OffGround:
            if mark == marks[-1] and not seen:
                raise
    first, *others = seen.values()
    rays = np.array([point.ray for point in seen.values()])
    if others and widest_angle(rays) >= PARALLAX:
        centres = np.array([point.place for point in seen.values()]) - rays
        sds = np.array([point.read_sd for point in seen.values()])
        place, sd = meeting_point(centres, rays, sds)
        if (missed := missed_by(place, centres, rays) / sds * READING_SD).max() > MISSED:
            worst = int(np.argmax(missed))
            raise ValueError(
                f"the rays of its {len(seen)} marks do not meet: {list(seen)[worst]} lies {missed[worst]:.0f} px from "
                "where they nearly do; one marks another point"
            )
        return _Footed(place, sd, np.zeros(3), place, met=True)
    return _Footed.on(footing, first)


def _with_ground(found: Evidence, points: list[_Footed], footing: Footing) -> Evidence:
    """The evidence `found` from `points`, with the error of the ground on which they lie."""
    rays = np.array([point.ray for point in points])
    if not rays.any():
        return found
    shares = ground_shares(np.array([point.place for point in points]), rays)
    return on_ground(found, shares, footing.covariance(np.array([point.seen for point in points])), footing.shared)
