"""Chains: equal strokes one behind the other at one period, as broken lane lines are painted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..core.angles import quarter_turn
from ..core.linked import linked_groups
from .periods import Row, find_row
from .strokes import Strokes, near_pairs, values

IN_LANE = np.radians(4)  # the next stroke lies within this angle of a stroke's own direction
LANE_TURN = np.radians(8)  # most that a lane bends from one stroke to the next
UNLIKE_DASHES = 1.5  # largest ratio of lengths of neighbours
LINKED = 3.1  # periods over which strokes are linked: two dashes may be hidden by vehicles
LEAST_STEP = 0.9, 1.2  # of the shortest period, and of the longer stroke: least distance of the centres of neighbours
INSIDE_DASH = np.linspace(0.15, 0.85, 15)  # of a dash, and of a gap: where its colour is sampled, away from its ends


@dataclass(frozen=True)
class Chain:
    """strokes : (M,) the strokes in order. row : their positions along the chain, by the chords between their
    centres."""

    strokes: Strokes
    row: Row

    @property
    def length(self) -> float:
        """Median length of its strokes [px]."""
        return float(np.median(self.strokes.length))

    @property
    def relative_sd(self) -> float:
        """Relative one sigma of the period, from the fit."""
        return self.row.sd / self.row.period

    def lines(self) -> np.ndarray:
        """(M, 2, 2) the strokes from end to end at their fitted places, all of the median length [px]."""
        along = _forward(self.strokes)
        centre = self.strokes.centre - self.row.residual[:, None] * along
        return np.stack([centre - along * self.length / 2, centre + along * self.length / 2], 1)


def find_chains(strokes: Strokes, low: float, high: float, fewest: int) -> Iterator[Chain]:
    """Chains of `strokes` with a period from `low` to `high` [px] and at least `fewest` strokes."""
    if len(strokes) < fewest:
        return
    for path in _paths(strokes, low, high, fewest):
        rest = path
        while len(rest) >= fewest:
            steps = np.linalg.norm(np.diff(strokes.centre[rest], axis=0), axis=1)
            row = find_row(np.concatenate([[0.0], np.cumsum(steps)]), low, high, fewest)
            if row is None:
                break
            yield Chain(strokes[rest[row.member]], row)
            rest = np.delete(rest, row.member)


def _paths(strokes: Strokes, low: float, high: float, fewest: int) -> list[np.ndarray]:
    """Groups of at least `fewest` strokes in line, each linked to the nearest ahead of it and behind it."""
    parts = [_in_line(strokes, i, j, low) for i, j in near_pairs(strokes, LINKED * high, LANE_TURN, IN_LANE)]
    i, j = (np.concatenate(each) for each in zip(*parts, strict=True))
    i, j = np.concatenate([i, j]), np.concatenate([j, i])
    apart = strokes.centre[j] - strokes.centre[i]
    distance = np.linalg.norm(apart, axis=1)
    # The nearest stroke ahead of, and behind, each stroke. Two are linked if each is the other's nearest.
    side = ((apart * strokes.along[i]).sum(1) > 0).astype(int)
    nearest = np.full((len(strokes), 2), -1)
    order = np.argsort(-distance)  # the nearest is written last
    nearest[i[order], side[order]] = j[order]
    mutual = (nearest[i, side] == j) & (nearest[j] == i[:, None]).any(1)
    return [_in_order(strokes, group) for group in linked_groups(i[mutual], j[mutual], len(strokes), fewest)]


def _in_line(strokes: Strokes, i: np.ndarray, j: np.ndarray, low: float) -> tuple[np.ndarray, np.ndarray]:
    """The pairs (i, j) that can belong to one line: alike, one behind the other, and not too near."""
    apart = strokes.centre[j] - strokes.centre[i]
    distance = np.linalg.norm(apart, axis=1)
    unit = apart / np.maximum(distance, 1e-9)[:, None]
    off = [np.abs(unit[:, 0] * strokes.along[k, 1] - unit[:, 1] * strokes.along[k, 0]) for k in (i, j)]
    shorter = np.minimum(strokes.length[i], strokes.length[j])
    longer = np.maximum(strokes.length[i], strokes.length[j])
    own = np.maximum(*off) < np.sin(IN_LANE)
    own &= np.abs((strokes.along[i] * strokes.along[j]).sum(1)) > np.cos(LANE_TURN)
    own &= (longer < UNLIKE_DASHES * shorter) & (distance > np.maximum(LEAST_STEP[0] * low, LEAST_STEP[1] * longer))
    return i[own], j[own]


def _in_order(strokes: Strokes, group: np.ndarray) -> np.ndarray:
    """`group` sorted along its longest extent: lanes bend, but do not turn back within a chain."""
    off = strokes.centre[group] - strokes.centre[group].mean(0)
    return group[np.argsort(off @ np.linalg.svd(off, full_matrices=False)[2][0])]


def _forward(strokes: Strokes) -> np.ndarray:
    """(M, 2) unit vectors along the strokes, each towards the next."""
    step = np.gradient(strokes.centre, axis=0)
    way = np.sign((step * strokes.along).sum(1))
    return strokes.along * np.where(way == 0, 1, way)[:, None]


@dataclass(frozen=True)
class ChainLevels:
    """Colours on and around a chain, the median along each stroke. paint : (M, 3) on the strokes. gap : (M - 1, 3) on
    the line between neighbours. side : (2, M, 3) beside the strokes, left and right."""

    paint: np.ndarray
    gap: np.ndarray
    side: np.ndarray


def levels(image: np.ndarray, chain: Chain, aside: float) -> ChainLevels:
    """Colours of RGB uint8 `image` on and around `chain`. aside : how far beside the strokes [px]."""
    lines = chain.lines()
    along = _forward(chain.strokes)
    across = quarter_turn(along)
    share = INSIDE_DASH[:, None, None]
    on = lines[:, 0] * (1 - share) + lines[:, 1] * share
    between = lines[:-1, 1] * (1 - share) + lines[1:, 0] * share
    beside = np.stack([on - aside * across, on + aside * across], 1)
    return ChainLevels(*(np.median(values(image, place), axis=0) for place in (on, between, beside)))
