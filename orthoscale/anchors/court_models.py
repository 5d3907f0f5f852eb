"""Painted courts in metres: their strokes at the centres of the paint.

Rules measure courts to an edge of the paint, tennis to the outer one, FIBA to the inner one; a line of 5 cm makes 0.2
to 0.5 % of a court. Pictures show its centre. x runs along the court, y across, the origin is in its middle.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..core.anchors import Standard

NEXT_TO = 0.7  # [m] beside a stroke, where nothing else may be painted: half of the tramlines of tennis
BEYOND_END = 2.4  # [m] beyond the end of a stroke, up to where it may not go on


@dataclass(frozen=True)
class Stroke:
    """A painted line from `start` to `end`, or, with a `radius` [m], an arc about `start` between two angles [rad] that
    `end` holds. `weight` : of a metre of it; less for what is often left out. `ends` : whether it stops at its ends."""

    start: tuple[float, float]
    end: tuple[float, float]
    radius: float = 0.0
    weight: float = 1.0
    ends: tuple[bool, bool] = (True, True)

    @property
    def length(self) -> float:
        """Of the paint [m]."""
        if self.radius:
            return self.radius * abs(self.end[1] - self.end[0])
        return float(np.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1]))

    def at(self, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (N, 2) [m] at `along` [m] from its start, and the directions (N,) [rad] it has there."""
        if self.radius:
            turn = self.end[0] + np.sign(self.end[1] - self.end[0]) * along / self.radius
            return np.array(self.start) + self.radius * np.stack([np.cos(turn), np.sin(turn)], -1), turn + np.pi / 2
        start, step = np.array(self.start), np.subtract(self.end, self.start) / self.length
        return start + along[:, None] * step, np.full(len(along), np.arctan2(step[1], step[0]))


@dataclass(frozen=True)
class Pieces:
    """Short pieces of strokes: middle (N, 2) [m], direction, length [m], weight (of the whole piece) and number of the
    stroke (N,); -1 where nothing is painted."""

    middle: np.ndarray
    direction: np.ndarray
    length: np.ndarray
    weight: np.ndarray
    stroke: np.ndarray


@dataclass(frozen=True)
class Court:
    """kind : as people call it. strokes : what is painted. standards : the sizes of `reference` [m], a length between
    outer edges that the court is known by; metres of the first standard are those of the strokes.
    needed : share of the strokes that must be seen. lean : largest |ln| of the ratio of both pixel sizes."""

    kind: str
    strokes: tuple[Stroke, ...]
    standards: tuple[Standard, ...]
    symmetric: bool = True

    @cached_property
    def extent(self) -> float:
        """Diameter of all that is painted [m]."""
        points = self.pieces(1.0).middle
        return float(2 * np.hypot(*(points - points.mean(0)).T).max() + 1.0)

    @cached_property
    def groups(self) -> tuple[np.ndarray, ...]:
        """Numbers of the straight strokes, those of one direction together."""
        found: dict[float, list[int]] = {}
        for number, stroke in enumerate(self.strokes):
            if not stroke.radius:
                found.setdefault(round(float(stroke.at(np.zeros(1))[1][0]) % np.pi, 6), []).append(number)
        return tuple(np.array(numbers) for numbers in found.values())

    @cached_property
    def size(self) -> np.ndarray:
        """(2,) along and across all that is painted [m]."""
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
        painted, fine = self.pieces(length), self.pieces(0.3).middle
        normal = np.stack([-np.sin(painted.direction), np.cos(painted.direction)], -1)
        middles, directions = [], []
        for k, away in enumerate((NEXT_TO, -NEXT_TO, 3 * NEXT_TO, -3 * NEXT_TO)):
            # every other piece, by turns, is enough
            middles.append((painted.middle + away * normal)[k % 2 :: 2])
            directions.append(painted.direction[k % 2 :: 2])
        for stroke in self.strokes:
            if stroke.radius:
                continue
            for end, stops in enumerate(stroke.ends):
                if stops:
                    beyond = np.arange(max(NEXT_TO, free) + length / 2, BEYOND_END, length)
                    place, direction = stroke.at(stroke.length + beyond if end else -beyond)
                    middles.append(place)
                    directions.append(direction)
        middle, direction = np.concatenate(middles), np.concatenate(directions)
        step = np.stack([np.cos(direction), np.sin(direction)], -1) * length / 2
        free = np.ones(len(middle), bool)
        for share in (-1, -0.5, 0, 0.5, 1):
            gap = middle[:, None] + share * step[:, None] - fine
            free &= (gap**2).sum(-1).min(1) > free**2
        middle, direction = middle[free], direction[free]
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


def _along(y: float, start: float, end: float, weight: float = 1.0, ends: tuple[bool, bool] = (True, True)) -> Stroke:
    return Stroke((start, y), (end, y), 0.0, weight, ends)


def _across(x: float, start: float, end: float, weight: float = 1.0, ends: tuple[bool, bool] = (True, True)) -> Stroke:
    return Stroke((x, start), (x, end), 0.0, weight, ends)


def _tennis() -> Court:
    paint, base = 0.05, 0.075  # [m] widths that are painted: 2.5 to 5 cm by the rules, the base line 5 to 10 cm
    x, y = 23.77 / 2 - base / 2, 10.97 / 2 - paint / 2
    single, service = 8.23 / 2 - paint / 2, 6.40 - paint / 2
    lines = [_along(side * at, -x, x) for at in (y, single) for side in (-1, 1)]
    lines += [_across(side * x, -y, y) for side in (-1, 1)]
    lines += [_across(side * service, -single, single) for side in (-1, 1)]
    lines += [_along(0.0, -service, service)]
    rule = Standard(
        "ITF tennis court",
        23.77,
        0.003,
        "ITF Rules of Tennis 2024, rule 1: 23.77 x 10.97 m to the outside of the lines, singles 8.23 m, service lines "
        "6.40 m from the net; the spread is that of 253 courts of American cities about the mean of their picture",
    )
    return Court("tennis court", tuple(lines), (rule,))


TENNIS_COURT = _tennis()
