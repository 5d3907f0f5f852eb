"""Painted courts in metres: their strokes at the centres of the paint.

Rules measure courts to an edge of the paint, tennis to the outer one, FIBA to the inner one, but pictures show its
centre. The 5 cm of a line are 0.2 to 0.5 % of a court. x runs along the court, y across, the origin is in its middle.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..core.anchors import Standard
from ..core.angles import quarter_turn, unit_vector

NETS = (2.1, 3.0, 4.0)  # [m] beside strokes, where grids of joints and parking bays have their next line
FINE_PIECE = 0.3  # [m] of the pieces of paint from which blanks keep their distance
PARALLEL_STROKES = 0.1  # sine of the angle up to which pieces and strokes count as parallel
BEYOND_END = 2.4  # [m] for which a stroke must not continue beyond its end


@dataclass(frozen=True)
class Stroke:
    """A painted line from `start` to `end` [m], or, with a `radius` [m], an arc about `start` between the two angles
    [rad] in `end`. `weight` : per metre; less for what is often left out. `ends` : whether the paint stops at each
    end."""

    start: tuple[float, float]
    end: tuple[float, float]
    radius: float = 0.0
    weight: float = 1.0
    ends: tuple[bool, bool] = (True, True)

    @property
    def length(self) -> float:
        """Length of the paint [m]."""
        if self.radius:
            return self.radius * abs(self.end[1] - self.end[0])
        return float(np.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1]))

    def at(self, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (N, 2) [m] at `along` [m] from its start, and its directions (N,) [rad] there."""
        if self.radius:
            turn = self.end[0] + np.sign(self.end[1] - self.end[0]) * along / self.radius
            return np.array(self.start) + self.radius * unit_vector(turn), turn + np.pi / 2
        start, step = np.array(self.start), np.subtract(self.end, self.start) / self.length
        return start + along[:, None] * step, np.full(len(along), np.arctan2(step[1], step[0]))


@dataclass(frozen=True)
class Pieces:
    """Short pieces of strokes: middle (N, 2) [m], direction [rad], length [m], weight (of the whole piece) and index of
    the stroke (N,), which is -1 where nothing is painted."""

    middle: np.ndarray
    direction: np.ndarray
    length: np.ndarray
    weight: np.ndarray
    stroke: np.ndarray


@dataclass(frozen=True)
class Court:
    """strokes : what is painted. standard : the rule, and the length by which a court built to it is known.
    symmetric : under half a turn. beside : how far [m] beside strokes the paint must be missing (blanks). bare :
    evidence lost if ridges cross all of the blanks; more where few strokes must distinguish a court from a grid of
    lines."""

    strokes: tuple[Stroke, ...]
    standard: Standard
    symmetric: bool = True
    beside: tuple[float, ...] = (2.1,)
    bare: float = 1.0

    @cached_property
    def extent(self) -> float:
        """Diameter of all that is painted [m]."""
        points = self.pieces(1.0).middle
        return float(2 * np.hypot(*(points - points.mean(0)).T).max() + 1.0)

    @cached_property
    def groups(self) -> tuple[np.ndarray, ...]:
        """Indices of the straight strokes, grouped by direction, and of the arcs that are always painted."""
        found: dict[float, list[int]] = {}
        for number, stroke in enumerate(self.strokes):
            if not stroke.radius:
                found.setdefault(round(float(stroke.at(np.zeros(1))[1][0]) % np.pi, 6), []).append(number)
            elif stroke.weight == 1.0:
                found.setdefault(np.inf, []).append(number)
        return tuple(np.array(numbers) for numbers in found.values())

    @cached_property
    def size(self) -> np.ndarray:
        """(2,) extents of the paint along and across the court [m]."""
        return np.ptp(self.pieces(1.0).middle, axis=0)

    def pieces(self, length: float) -> Pieces:
        """Every stroke cut into equal pieces of about `length` [m]."""
        parts: list[tuple[np.ndarray, ...]] = []
        for number, stroke in enumerate(self.strokes):
            count = max(1, round(stroke.length / length))
            own = stroke.length / count
            middle, direction = stroke.at((np.arange(count) + 0.5) * own)
            same = np.ones(count)
            parts.append((middle, direction, same * own, same * own * stroke.weight, same * number))
        middle, direction, own_length, weight, number_ = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Pieces(middle, direction, own_length, weight, number_.astype(int))

    def blanks(self, length: float, free: float) -> Pieces:
        """Where nothing is painted: beside the strokes and beyond their ends, in pieces of `length` [m] that are at
        least `free` [m] from all paint."""
        painted, fine = self.pieces(length), self.pieces(FINE_PIECE).middle
        normal = quarter_turn(unit_vector(painted.direction))
        middles, directions = [], []
        for away in self.beside:
            for first, side in enumerate((away, -away)):  # every other piece to each side is enough
                middles.append((painted.middle + side * normal)[first::2])
                directions.append(painted.direction[first::2])
        for stroke in self.strokes:
            if stroke.radius:
                continue
            for end, stops in enumerate(stroke.ends):
                if stops:
                    beyond = np.arange(free + length / 2, BEYOND_END, length)
                    place, direction = stroke.at(stroke.length + beyond if end else -beyond)
                    middles.append(place)
                    directions.append(direction)
        middle, direction = np.concatenate(middles), np.concatenate(directions)
        step = unit_vector(direction) * length / 2
        blank = np.ones(len(middle), bool)
        for share in (-1, -0.5, 0, 0.5, 1):
            gap = middle[:, None] + share * step[:, None] - fine
            blank &= (gap**2).sum(-1).min(1) > free**2
        middle, direction = middle[blank], direction[blank]
        same = np.full(len(middle), length)
        return Pieces(middle, direction, same, same, np.full(len(middle), -1))

    def drawing(self) -> np.ndarray:
        """(N, 2, 2) all strokes as straight lines from end to end [m]."""
        lines = []
        for stroke in self.strokes:
            count = 1 if not stroke.radius else max(4, int(stroke.length))
            points, _ = stroke.at(np.linspace(0, stroke.length, count + 1))
            lines.append(np.stack([points[:-1], points[1:]], 1))
        return np.concatenate(lines)


def _along(y: float, start: float, end: float, ends: tuple[bool, bool] = (True, True)) -> Stroke:
    return Stroke((start, y), (end, y), ends=ends)


def _across(x: float, start: float, end: float, weight: float = 1.0, ends: tuple[bool, bool] = (True, True)) -> Stroke:
    return Stroke((x, start), (x, end), weight=weight, ends=ends)


def _arc(x: float, y: float, radius: float, start: float, end: float, weight: float = 0.5) -> Stroke:
    """Angles in degrees."""
    return Stroke((x, y), (float(np.radians(start)), float(np.radians(end))), radius, weight)


def _box(x: float, y: float) -> list[Stroke]:
    """The outline of a court, 2 x long and 2 y wide."""
    return [_along(side * y, -x, x) for side in (-1, 1)] + [_across(side * x, -y, y) for side in (-1, 1)]


def _tennis() -> Court:
    # [m] line widths: 2.5 to 5 cm by the rules, up to 10 cm for the base line. On 100 chips the ridges of base lines
    # are 1.05 to 1.08 times as strong as those of service lines, and courts get their true size with these widths:
    paint, base = 0.05, 0.0625
    x, y = 23.77 / 2 - base / 2, 10.97 / 2 - paint / 2
    single, service = 8.23 / 2 - paint / 2, 6.40 - paint / 2
    lines = [_along(side * at, -x, x) for at in (y, single) for side in (-1, 1)]
    lines += [_across(side * x, -y, y) for side in (-1, 1)]
    lines += [_across(side * service, -single, single) for side in (-1, 1)]
    lines += [_along(0.0, -service, service)]
    rule = Standard(
        "ITF tennis court",
        23.77,
        0.002,
        "ITF Rules of Tennis 2024, rule 1: 23.77 x 10.97 m to the outside of the lines, singles 8.23 m, service lines "
        "6.40 m from the net; the spread is ours, for how exactly they are painted",
    )
    return Court(tuple(lines), rule)


def _volleyball() -> Court:
    half = 0.025  # [m] of the paint's width
    x, y, attack = 9.0 - half, 4.5 - half, 3.0 - half
    lines = _box(x, y) + [_across(side * attack, -y, y, ends=(False, False)) for side in (-1, 1)]
    lines += [_across(0.0, -y, y, weight=0.3)]  # under the net, often left out
    rule = Standard(
        "FIVB volleyball court",
        18.0,
        0.004,
        "FIVB Official Volleyball Rules, rule 1: 18 x 9 m to the outside of the lines of 5 cm, attack lines' rear "
        "edges 3 m from the middle of the centre line; the spread is ours",
    )
    return Court(tuple(lines), rule, beside=NETS, bare=2.0)


def _basketball(length: float, width: float, key: float, depth: float, name: str, source: str) -> Court:
    """length x width [m] to the inside of the lines; the key is `key` [m] wide to its outside, and its far edge is
    `depth` [m] from the end line's inner edge."""
    half = 0.025
    x, y, k, free = length / 2 + half, width / 2 + half, key / 2 - half, length / 2 - depth + half
    lines = [*_box(x, y), _across(0.0, -y, y), _arc(0, 0, 1.8 - half, 0, 360)]
    for side in (-1, 1):
        lines += [_across(side * free, -k, k)]
        low, high = sorted((side * free, side * x))
        lines += [_along(at, low, high, ends=(side > 0, side < 0)) for at in (-k, k)]
        lines += [_arc(side * free, 0, 1.8 - half, 90 if side > 0 else -90, 270 if side > 0 else 90)]
    return Court(tuple(lines), Standard(name, length, 0.006, source), beside=NETS, bare=2.0)


def _handball() -> Court:
    half, post = 0.025, 1.5  # [m] half widths of the paint and of the goal
    x, y, area = 20.0 - half, 10.0 - half, 6.0 - half
    goal = 20.0  # [m] to the goal line's outer edge, from which the area is measured
    lines = [*_box(x, y), _across(0.0, -y, y)]
    for side in (-1, 1):
        lines += [_across(side * (goal - area), -post, post, ends=(False, False))]
        for to in (-1, 1):
            end = {(1, 1): (90, 180), (1, -1): (180, 270), (-1, 1): (0, 90), (-1, -1): (270, 360)}[side, to]
            lines += [_arc(side * goal, to * post, area, *end, weight=1.0)]
    rule = Standard(
        "IHF handball court",
        40.0,
        0.005,
        "IHF Rules of the Game, rule 1: 40 x 20 m to the outside of the lines of 5 cm, goal areas of 6 m from the rear "
        "edge of the goal line, about the posts of a goal of 3 m; futsal (FIFA) is marked alike; the spread is ours",
    )
    return Court(tuple(lines), rule, beside=NETS, bare=2.0)


def _penalty_area() -> Court:
    half = 0.05  # [m] half the width of lines of 10 cm; 12 at most
    outer = 8.25  # [m] from the middle of the area to the goal line's outer edge
    goal, front, near = outer - half, outer - 16.5 + half, outer - 5.5 + half
    wide, goal_wide = 40.32 / 2 - half, 18.32 / 2 - half
    lines = [_across(goal, -wide, wide, ends=(False, False)), _across(front, -wide, wide)]
    lines += [_across(near, -goal_wide, goal_wide)]
    lines += [_along(at, front, goal, ends=(True, False)) for at in (-wide, wide)]
    lines += [_along(at, near, goal, ends=(True, False)) for at in (-goal_wide, goal_wide)]
    spot, radius = outer - 11.0, 9.15 - half
    reach = float(np.degrees(np.arccos((16.5 - 11.0) / 9.15)))
    lines += [_arc(spot, 0, radius, 180 - reach, 180 + reach)]
    rule = Standard(
        "IFAB penalty area",
        40.32,
        0.006,
        "IFAB Laws of the Game, law 1: 16.5 m into the field and beyond the posts of a goal of 7.32 m, goal area "
        "5.5 m, arc of 9.15 m about the mark at 11 m, to the outside of lines of at most 12 cm; the spread is ours",
    )
    return Court(tuple(lines), rule, symmetric=False, beside=NETS, bare=2.0)


def _centre_circle() -> Court:
    half, radius, reach = 0.05, 9.15, 22.5  # [m] half a line of 10 cm; to its outside; least half of halfway line
    lines = [_along(0.0, -reach, reach, ends=(False, False)), _arc(0, 0, radius - half, 0, 360, weight=1.0)]
    rule = Standard(
        "IFAB centre circle",
        2 * radius,
        0.006,
        "IFAB Laws of the Game, law 1: a circle of 9.15 m about the middle of the halfway line, which is 45 to 90 m "
        "long; the spread is ours",
    )
    return Court(tuple(lines), rule, beside=NETS, bare=2.0)


def _padel() -> Court:
    # [m] The rules do not say to which edge of the 5 cm of paint the 6.95 m go: its centre is assumed.
    service, width, beyond = 6.95, 10.0, 0.2
    lines = [_across(side * service, -width / 2, width / 2, ends=(False, False)) for side in (-1, 1)]
    lines += [_along(0.0, -service - beyond, service + beyond)]
    rule = Standard(
        "FIP padel court, service line to service line",
        2 * service,
        0.004,
        "FIP Rules of Padel: 20 x 10 m inside its walls, to 0.5 %, service lines of 5 cm at 6.95 m from the net, the "
        "central one 20 cm longer; the spread is ours: the tolerance, and to which edge of the paint 6.95 m go",
    )
    return Court(tuple(lines), rule, beside=(1.3, 1.7))


TENNIS_COURT = _tennis()
PADEL_COURT = _padel()
VOLLEYBALL_COURT = _volleyball()
HANDBALL_COURT = _handball()
PENALTY_AREA = _penalty_area()
CENTRE_CIRCLE = _centre_circle()
_AMERICAN = "to the inside of the lines, key 12 ft wide, free-throw line 19 ft from the end line; the spread is ours"
BASKETBALL_COURTS = (
    _basketball(
        28.0, 15.0, 4.9, 5.8, "FIBA basketball court",
        "FIBA Official Basketball Rules, art. 2: 28 x 15 m to the inside of the lines of 5 cm, key 4.9 x 5.8 m, "
        "circles of 1.8 m; the spread is ours",
    ),
    _basketball(
        28.651, 15.24, 3.66, 5.79, "US college basketball court",
        f"NCAA Basketball Rules, rule 1: 94 x 50 ft {_AMERICAN}",
    ),
    _basketball(
        25.603, 15.24, 3.66, 5.79, "US high school basketball court",
        f"NFHS Basketball Rules, rule 1: 84 x 50 ft {_AMERICAN}",
    ),
)  # fmt: skip
