"""Ladders: equal strokes side by side at one pitch, as zebra crossings and parking bays are painted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..core.angles import quarter_turn, unit_vector
from ..core.linked import linked_groups
from .periods import MISSING_IN_A_ROW, Row, find_row, fit_row
from .strokes import Strokes, near_pairs, values

RUNGS_TURN = np.radians(5)  # most from one stroke to the next
RUNGS_PARALLEL = np.cos(RUNGS_TURN)
STEEPEST_SLANT = 1.3  # tangent: most that a stroke may stand ahead of its neighbour, in pitches
RUNGS_BESIDE = 0.5  # of the shorter: least length over which neighbours lie side by side ...
RUNGS_SLANTED = 0.25  # ... and in a row that is no steeper than the slant
RUNGS_APART = 0.8, 1.05  # of the smallest pitch and of the farthest reach: limits of the distance of neighbours
UNLIKE_RUNGS = 1.7  # largest ratio of lengths of neighbours: a vehicle may hide part of one
BETWEEN_RUNGS = 0.27  # of a pitch: least distance from both strokes of a line between them; double lines stand closer
LEAN_PX = 0.1  # [px] over its length: one sigma by which a stroke leans towards rows or columns, common to all
PROFILES = np.linspace(-0.42, 0.42, 12)  # of a stroke's length, from its middle: where it is cut across
INSIDE_RUNG = np.linspace(0.1, 0.9, 16)  # of a stroke: where its colour is sampled, away from its ends
PAST_RUNG = np.linspace(-0.3, 0.3, 5)  # of the distance past its ends, about it: where the colour there is sampled
ALIKE_PAIR, PAIR_BESIDE = 1.3, 0.7  # of the lines of a double one: largest ratio of lengths, least share side by side
LADDERS = 8  # most ladders in one cluster of strokes


@dataclass(frozen=True)
class Ladder:
    """strokes : (M,) the strokes in order. row : their positions along `across`.
    along, across : (2,) unit vectors along the strokes and along the pitch."""

    strokes: Strokes
    row: Row
    along: np.ndarray
    across: np.ndarray

    @property
    def length(self) -> float:
        """Median length of its strokes [px]."""
        return float(np.median(self.strokes.length))

    @property
    def apart(self) -> float:
        """Distance between the two lines of its strokes, if they are double [px]; else 0."""
        return 0.0 if self.strokes.apart is None else float(np.median(self.strokes.apart))

    @property
    def relative_sd(self) -> float:
        """Relative one sigma of the pitch, by the fit and by the direction in which it is measured.

        The pitch is taken across the strokes: in a slanted row an error of their direction counts by the tangent of the
        slant.
        """
        step = self.strokes.centre[-1] - self.strokes.centre[0]
        slant = float(step @ self.along) / max(abs(float(step @ self.across)), 1.0)
        turn = (self.strokes.along * self.across).sum(1)  # (M,) sines
        direction = np.hypot(float(np.std(turn)) / np.sqrt(len(turn)), LEAN_PX / self.length)
        return float(np.hypot(self.row.sd / self.row.period, slant * direction))

    @property
    def askew(self) -> float:
        """How far the strokes are shifted along themselves from a straight row, rms, as a share of their length."""
        ahead = self.strokes.centre @ self.along
        off = ahead - np.polyval(np.polyfit(self.row.number, ahead, 1), self.row.number)
        return float(np.sqrt((off**2).mean())) / self.length

    @property
    def fanned(self) -> float:
        """Sine of the angle by which the strokes turn from the first to the last."""
        turn = (self.strokes.along * self.across).sum(1) * np.sign((self.strokes.along * self.along).sum(1))
        return float(abs(np.polyfit(self.row.number, turn, 1)[0]) * self.row.number[-1])

    def shares(self, other: Ladder) -> bool:
        """Whether most of its strokes are strokes of `other`, or one of the two lines of its double strokes."""
        gap = self.strokes.centre[:, None] - other.strokes.centre
        near = np.abs(gap @ other.across) < max(other.apart, 1.0)
        near &= np.abs(gap @ other.along) < other.length / 2
        return bool(near.any(1).mean() > 0.5)

    def lines(self) -> np.ndarray:
        """(M, 2, 2) the strokes at their fitted places, from end to end [px]."""
        centre = self.strokes.centre - self.row.residual[:, None] * self.across
        half = self.along * self.strokes.length[:, None] / 2
        return np.stack([centre - half, centre + half], 1)


def doubled(strokes: Strokes, least: float, most: float) -> Strokes:
    """The double strokes: pairs of equal `strokes` side by side, `least` to `most` [px] apart, each pair replaced by
    one stroke midway."""
    pairs = [_pair(strokes, i, j, least, most) for i, j in near_pairs(strokes, 2 * most, RUNGS_TURN)]
    i, j, across = (np.concatenate(each) for each in zip(*pairs, strict=True)) if pairs else np.zeros((3, 0), int)
    order = np.argsort(across, kind="stable")
    free, kept = np.ones(len(strokes), bool), []
    for k in order.tolist():  # each stroke belongs to one pair, its closest
        if free[i[k]] and free[j[k]]:
            free[[i[k], j[k]]] = False
            kept.append(k)
    one, other = strokes[i[kept]], strokes[j[kept]]
    along = one.along + np.sign((one.along * other.along).sum(1))[:, None] * other.along
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    middle = (one.centre + other.centre) / 2
    return Strokes(middle, along, (one.length + other.length) / 2, across[kept])


def _pair(
    strokes: Strokes, i: np.ndarray, j: np.ndarray, least: float, most: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The pairs (i, j) that can be one double stroke, and the distance between their lines [px]."""
    ahead, across, shorter, longer, own = _compared(strokes, i, j)
    own &= longer < ALIKE_PAIR * shorter
    own &= (across > least) & (across < most) & ((shorter + longer) / 2 - ahead > PAIR_BESIDE * shorter)
    return i[own], j[own], across[own]


def _compared(strokes: Strokes, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, ...]:
    """How pairs of strokes (i, j) lie to each other, (N,) each: the distance between their centres along and across the
    strokes [px], the shorter and the longer length [px], and whether they are parallel."""
    apart = strokes.centre[j] - strokes.centre[i]
    ahead = np.abs((apart * strokes.along[i]).sum(1))
    across = np.sqrt(np.maximum((apart**2).sum(1) - ahead**2, 0))
    shorter = np.minimum(strokes.length[i], strokes.length[j])
    longer = np.maximum(strokes.length[i], strokes.length[j])
    parallel = np.abs((strokes.along[i] * strokes.along[j]).sum(1)) > RUNGS_PARALLEL
    return ahead, across, shorter, longer, parallel


def find_ladders(strokes: Strokes, low: float, high: float, fewest: int) -> Iterator[Ladder]:
    """Ladders of `strokes` with a pitch from `low` to `high` [px] and at least `fewest` strokes."""
    if len(strokes) < fewest:
        return
    for cluster in _clusters(strokes, low, high, fewest):
        rest = cluster
        for _ in range(LADDERS):
            ladder, used = _ladder(strokes[rest], low, high, fewest)
            if ladder is None:
                break
            yield ladder
            rest = np.delete(rest, used)


def _clusters(strokes: Strokes, low: float, high: float, fewest: int) -> list[np.ndarray]:
    """Groups of strokes that are side by side, a few pitches apart at most."""
    reach = (MISSING_IN_A_ROW + 1) * high
    near = near_pairs(strokes, reach * np.hypot(1, STEEPEST_SLANT), RUNGS_TURN)
    parts = [_beside(strokes, i, j, low, reach) for i, j in near]
    i, j = (np.concatenate(each) for each in zip(*parts, strict=True))
    return linked_groups(i, j, len(strokes), fewest)


def _beside(strokes: Strokes, i: np.ndarray, j: np.ndarray, low: float, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """The pairs (i, j) that can belong to one ladder: alike, and side by side."""
    ahead, across, shorter, longer, own = _compared(strokes, i, j)
    overlap = (shorter + longer) / 2 - ahead
    own &= (across > RUNGS_APART[0] * low) & (across < RUNGS_APART[1] * reach) & (longer < UNLIKE_RUNGS * shorter)
    slanted = ahead < STEEPEST_SLANT * across
    own &= overlap > np.where(slanted, RUNGS_SLANTED, RUNGS_BESIDE) * shorter
    return i[own], j[own]


def _ladder(strokes: Strokes, low: float, high: float, fewest: int) -> tuple[Ladder | None, np.ndarray]:
    """The best ladder in a cluster, and the indices of its strokes."""
    if len(strokes) < fewest:
        return None, np.zeros(0, int)
    along = _direction(strokes)
    row = find_row(strokes.centre @ quarter_turn(along), low, high, fewest)
    if row is None:
        return None, np.zeros(0, int)
    along = _direction(strokes[row.member])  # by the ladder's own strokes alone
    again = find_row(strokes.centre @ quarter_turn(along), low, high, fewest)
    row = again if again is not None else row
    own = strokes[row.member]
    return Ladder(own, row, along, quarter_turn(along)), row.member


def _direction(strokes: Strokes) -> np.ndarray:
    """(2,) mean direction of the strokes. Strokes have no front, so doubled angles are averaged."""
    turn = 2 * np.arctan2(strokes.along[:, 1], strokes.along[:, 0])
    mean = np.arctan2((strokes.length * np.sin(turn)).sum(), (strokes.length * np.cos(turn)).sum()) / 2
    return unit_vector(mean)


def refined(light: np.ndarray, ladder: Ladder, reach: float) -> Ladder:
    """`ladder` with its strokes centred on the centroid of `light` (H, W) across them, to `reach` [px] on either side
    of each line. All get one direction, since ridges of lines a pixel wide lean towards rows or columns."""
    strokes = ladder.strokes
    reach += ladder.apart / 2
    offset = np.linspace(-reach, reach, 2 * int(np.ceil(2 * reach)) + 1)
    t = strokes.length[:, None] * PROFILES
    place = (strokes.centre[:, None] + t[..., None] * ladder.along)[:, :, None] + offset[:, None] * ladder.across
    seen = values(light, place)  # (M, P, O)
    rise = np.linspace(0, 1, len(offset))
    over = np.maximum(seen - seen[..., :1] * (1 - rise) - seen[..., -1:] * rise, 0)
    mass = over.sum(-1)
    centroid = (over * offset).sum(-1) / np.maximum(mass, 1e-6)
    # The line of each stroke by weighted least squares about its middle; their median slope is that of all.
    weight = mass / np.maximum(mass.sum(1, keepdims=True), 1e-6)
    middle, height = (weight * t).sum(1), (weight * centroid).sum(1)
    off = t - middle[:, None]
    slope = (weight * off * centroid).sum(1) / np.maximum((weight * off**2).sum(1), 1e-6)
    common = float(np.median(slope))
    centre = strokes.centre + (height - common * middle)[:, None] * ladder.across
    along = ladder.along + common * ladder.across
    along /= np.linalg.norm(along)
    own = ladder.along + slope[:, None] * ladder.across
    own /= np.linalg.norm(own, axis=1, keepdims=True)
    across = quarter_turn(along)
    row = fit_row(centre @ across, ladder.row.number, ladder.row.strays)
    return Ladder(replace(strokes, centre=centre, along=own), row, along, across)


def crowded(ladder: Ladder, strokes: Strokes) -> float:
    """Share of the gaps of `ladder` in which another of `strokes` runs beside its own. If it is large, the pitch is
    wrong."""
    off = strokes.centre - ladder.strokes.centre[0]
    first = float(ladder.strokes.centre[0] @ ladder.across)
    place = (strokes.centre @ ladder.across - ladder.row.start) / ladder.row.period
    number, phase = np.floor(place).astype(int), place % 1
    among = (
        (np.abs(strokes.along @ ladder.along) > RUNGS_PARALLEL) & (phase > BETWEEN_RUNGS) & (phase < 1 - BETWEEN_RUNGS)
    )
    among &= (number >= 0) & (number < ladder.row.number[-1]) & (strokes.length > 0.5 * ladder.length)
    # Where the ladder's own strokes lie at that place; they are shifted if the row is slanted.
    own = (ladder.strokes.centre - ladder.strokes.centre[0]) @ ladder.along
    there = np.interp(strokes.centre @ ladder.across - first, (ladder.strokes.centre @ ladder.across) - first, own)
    among &= np.abs(off @ ladder.along - there) < RUNGS_BESIDE * ladder.length
    return len(np.unique(number[among])) / ladder.row.number[-1]


@dataclass(frozen=True)
class LadderLevels:
    """Colours on and around a ladder, the median along each stroke. paint : (M, 3) on the strokes. ground : (M - 1, 3)
    midway between neighbours. beside : (2, M, 3) left and right of the strokes. beyond : (2, M, 3) on their axes past
    both ends."""

    paint: np.ndarray
    ground: np.ndarray
    beside: np.ndarray
    beyond: np.ndarray


def levels(image: np.ndarray, ladder: Ladder, aside: float, past: float) -> LadderLevels:
    """Colours of RGB uint8 `image` on and around `ladder`. aside, past : how far beside the strokes' lines and past
    their ends [px]."""
    lines = ladder.lines()
    middle = (lines[1:] + lines[:-1]) / 2
    ends = np.stack([lines[:, 0] - past * ladder.along, lines[:, 1] + past * ladder.along])
    share = INSIDE_RUNG[:, None, None]
    spot = PAST_RUNG[:, None, None, None] * past * ladder.along

    axis = lines[:, 0] * (1 - share) + lines[:, 1] * share
    half = ladder.apart / 2 * ladder.across
    away = half + aside * ladder.across
    on = np.concatenate([axis - half, axis + half]) if ladder.apart else axis
    between = middle[:, 0] * (1 - share) + middle[:, 1] * share
    beside = np.stack([axis - away, axis + away], 1)
    return LadderLevels(*(np.median(values(image, place), axis=0) for place in (on, between, beside, ends + spot)))
