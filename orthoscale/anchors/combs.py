"""Combs: parallel lines at one pitch, followed along straights and bends, as lanes of running tracks and yard lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..core.anchors import Anchor, Standard
from ..core.angles import axis_angle, quarter_turn, unit_vector
from ..core.normal import ROBUST_SD, median_and_sd, median_sd
from .following import SECTION_STEP, followed, ridge_across, three_back
from .peaks import peak_shift
from .periods import Row, find_row, fit_row
from .repeated import LOCAL_STRETCH
from .ridges import SEED_PX, segments, steered
from .strokes import values

LINE_SEED = 0.3  # least mean ridge of a seed, a short straight piece of a line
LINES_PARALLEL = np.radians(4)
BESIDE_SEED = 4  # least number of parallel seeds beside one that is a start
SEED_GAP = 0.8  # of the smallest pitch: least distance between these
MOST_STARTS, LEAST_STARTS = 150, 20  # most per megapixel, but never limited to fewer than the second
LINE_SD_PX = 0.75, 1.2  # [px] limits of the ridge filter's sigma, which is half the width of a line
LINE_LEAST = 0.1  # [grey levels] least ridge of a line in a cross section ...
LINE_CLEAR = 0.4  # ... and as a share of the n-th strongest ridge, where n is the fewest lines of a comb
LINE_KEPT = 0.3  # least strength of the lines of other blocks, as a share of the first block's
COMB_FILLED = 0.85  # least share of the lines that are seen
COMB_REGULAR = 4.0  # least `Row.regularity`: natural logarithm of the likelihood ratio of a row to chance
FEWEST_BLOCKS = 10
MOST_BLOCKS = 200  # in one direction: once round a running track
BLOCKS_KEPT = 0.7  # least share of the blocks tried that show the comb, and of its blocks that show a line
COMB_UNEVEN = 0.02  # largest relative scatter of the blocks' periods, one sigma
PITCH_KEPT = 0.06  # largest relative difference between the pitch of a block and that of the first
ASTRAY = 0.6  # of the pitch: largest sideways shift from one block to the next
LINE_SIDE = 0.4  # of the pitch: from a line to where the ground beside it is sampled
TRUE_LINE = 0.35  # each line must stand out by this share of the upper quartile of all lines
STEPS = 0.6  # of the contrast: most that levels midway between lines change from block to block, one sigma
CONTRAST = 8.0  # [grey levels] least contrast of lines to ground; less where lines are thinner than half a pixel


@dataclass(frozen=True)
class Comb:
    """What to look for. low, high : limits of the pitch [px]. fewest, most : number of lines. block : length of a piece
    that is measured at once, across : half the width of its cross section, line : width of the paint [px]."""

    low: float
    high: float
    fewest: int
    most: int
    block: float
    across: float
    line: float


@dataclass(frozen=True)
class Block:
    """A piece of a comb. place : (2,) a point on the line that is followed [px]. heading : of the lines [rad]. row :
    positions of all lines relative to `place`, along `across` [px]. strength : median ridge of the lines [grey
    levels]."""

    place: np.ndarray
    heading: float
    row: Row
    strength: float

    @property
    def across(self) -> np.ndarray:
        """(2,) unit vector across the lines."""
        return quarter_turn(unit_vector(self.heading))

    @property
    def number(self) -> np.ndarray:
        """(M,) numbers of the lines, counted from the one that is followed."""
        return self.row.number + round(self.row.start / self.row.period)

    def lines(self, aside: float = 0.0) -> np.ndarray:
        """(M, 2) points where the lines, shifted by `aside` periods, cross the middle of the block [px]."""
        return self.place + (self.row.start + self.row.period * (self.row.number + aside))[:, None] * self.across

    def only(self, numbers: np.ndarray, fewest: int) -> Block | None:
        """The block with only the lines of these `numbers`; None if fewer than `fewest` are left."""
        kept = np.isin(self.number, numbers)
        if kept.sum() < fewest:
            return None
        at = self.row.start + self.row.period * self.row.number + self.row.residual
        row = fit_row(at[kept], self.row.number[kept])
        return Block(self.place, self.heading, row, self.strength)


def find_combs(image: np.ndarray, light: np.ndarray, comb: Comb) -> Iterator[list[Block]]:
    """Combs in RGB uint8 `image` with `light` (H, W) float32, each as its blocks in order: bright lines at a constant
    pitch, on ground that is uniform along them."""
    taken = np.zeros((0, 2))
    found: list[list[Block]] = []
    for x, y, angle in _starts(light, comb):
        if len(taken) and np.hypot(*(taken - (x, y)).T).min() < comb.across / 2:
            continue
        blocks, tried = _followed(light, np.array([x, y]), angle, comb)
        blocks = _of_true_lines(light, blocks, comb)
        if len(blocks) >= max(FEWEST_BLOCKS, BLOCKS_KEPT * tried) and _is_painted(image, blocks, comb):
            taken = np.concatenate([taken, *(block.lines() for block in blocks)])
            found.append(blocks)
    kept = np.full((1, 2), -1e9)
    for blocks in sorted(found, key=len, reverse=True):
        places = np.concatenate([block.lines() for block in blocks])
        if np.median(cKDTree(kept).query(places)[0]) > pitch(blocks):  # otherwise it is part of a longer one
            kept = np.concatenate([kept, places])
            yield blocks


def comb_anchor(blocks: Sequence[Block], kind: str, standards: tuple[Standard, ...], false: float) -> Anchor:
    """A comb as an anchor of `kind`; its reference length is the pitch."""
    period = _pitches(blocks)
    half = np.linalg.norm(blocks[0].place - blocks[1].place) / 2
    pieces = []
    for block in blocks:
        along = half * unit_vector(block.heading)
        pieces.append(np.stack([block.lines() - along, block.lines() + along], 1))
    lines = np.concatenate(pieces)
    return Anchor(
        kind=kind,
        place=lines.mean((0, 1)),
        lines=lines,
        pixels=pitch(blocks),
        relative_sd=float(np.hypot(median_sd(period) / pitch(blocks), LOCAL_STRETCH)),
        residual=np.concatenate([block.row.residual for block in blocks]),
        standards=standards,
        false=false,
        count=round(float(np.median([len(block.row.number) for block in blocks]))),
    )


def _pitches(blocks: Sequence[Block]) -> np.ndarray:
    """(B,) pitch of each block, perpendicular to the direction in which the comb runs [px]."""
    place = np.array([block.place for block in blocks])
    step = np.gradient(place, axis=0)
    turn = np.arctan2(step[:, 1], step[:, 0]) - [block.heading for block in blocks]
    return np.array([block.row.period for block in blocks]) * np.abs(np.cos(turn))


def pitch(blocks: Sequence[Block]) -> float:
    """Median pitch of a comb's blocks [px]."""
    return float(np.median(_pitches(blocks)))


def _starts(light: np.ndarray, comb: Comb) -> np.ndarray:
    """(N, 3) place [px] and direction [rad] of pieces of lines with parallel ones beside them, those with most
    first."""
    seeds = segments(steered(light), LINE_SEED)
    if len(seeds.angle) < comb.fewest:
        return np.zeros((0, 3))
    reach = max(comb.fewest * comb.high, SEED_PX)
    by_turn = reach / (2 * LINES_PARALLEL) * unit_vector(2 * seeds.angle)
    near = cKDTree(np.hstack([seeds.middle, by_turn])).query_pairs(reach, output_type="ndarray")
    gap = seeds.middle[near[:, 1]] - seeds.middle[near[:, 0]]
    angle = seeds.angle[near[:, 0]]
    ahead = np.abs(gap[:, 0] * np.cos(angle) + gap[:, 1] * np.sin(angle))
    across = np.abs(gap[:, 1] * np.cos(angle) - gap[:, 0] * np.sin(angle))
    beside = (ahead < SEED_PX / 2) & (across > SEED_GAP * comb.low)
    support = np.bincount(near[beside].ravel(), minlength=len(seeds.angle))
    order = np.argsort(-support, kind="stable")
    order = order[support[order] >= BESIDE_SEED][: max(LEAST_STARTS, round(MOST_STARTS * light.size / 1e6))]
    return np.column_stack([seeds.middle, seeds.angle])[order]


def _followed(light: np.ndarray, start: np.ndarray, angle: float, comb: Comb) -> tuple[list[Block], int]:
    """The comb at `start` [px], followed block by block in both directions, and how many blocks were tried."""
    first = _block(light, start, angle, comb, (comb.low, comb.high), LINE_LEAST)
    if first is None:
        return [], 1
    between = first.row.period * (1 - PITCH_KEPT), first.row.period * (1 + PITCH_KEPT)

    def further(place: np.ndarray, before: Sequence[Block], way: float) -> Block | None:
        seen = _block(light, place, before[-1].heading, comb, between, LINE_KEPT * first.strength)
        return None if seen is None else replace(seen, heading=_heading(before, seen.place, way))

    return followed(first, comb.block, light.shape, further, MOST_BLOCKS)


def _heading(before: Sequence[Block], place: np.ndarray, way: float) -> float:
    """Direction of the lines at `place` [rad]. The chord from three blocks back turns half as much as the lines do."""
    back = three_back(before)
    chord = (place - back.place) * way
    turned = axis_angle(np.arctan2(chord[1], chord[0]) - back.heading)
    return float(back.heading + turned * (2 if len(before) > 1 else 1))


def _block(
    light: np.ndarray, place: np.ndarray, angle: float, comb: Comb, between: tuple[float, float], least: float
) -> Block | None:
    """The lines in a cross section of the comb at `place` [px], whose pitch lies `between` two values [px] and whose
    ridges exceed `least` [grey levels]; None if they are too few."""
    along = unit_vector(angle)
    across = quarter_turn(along)
    fine = np.arange(-comb.across, comb.across, SECTION_STEP)
    t = np.linspace(-0.5, 0.5, max(6, int(comb.block))) * comb.block
    grid = place + t[:, None, None] * along + fine[:, None] * across
    inside = ((grid >= 0) & (grid <= np.array(light.shape[::-1]) - 1)).all(-1).all(0)
    response = ridge_across(values(light, grid).mean(0), float(np.clip(comb.line / 2, *LINE_SD_PX)))
    left, middle, right = response[:-2], response[1:-1], response[2:]
    peak = np.flatnonzero((middle > left) & (middle >= right) & (middle > least) & inside[1:-1])
    if len(peak) < comb.fewest:
        return None
    clear = max(LINE_CLEAR * float(np.sort(middle[peak])[-comb.fewest]), least)
    peak = peak[middle[peak] > clear]
    offset = fine[peak + 1] + SECTION_STEP * peak_shift(left[peak], middle[peak], right[peak])
    row = find_row(offset, *between, comb.fewest)
    if row is None or row.filled < COMB_FILLED or len(row.number) > comb.most or row.regularity < COMB_REGULAR:
        return None
    # the line to follow is the one nearest to the place
    nearest = float(np.clip(np.round(-row.start / row.period), 0, row.number[-1]))
    shift = row.start + nearest * row.period
    if abs(shift) > ASTRAY * row.period:
        return None
    moved = replace(row, start=row.start - shift)
    return Block(place + shift * across, angle, moved, float(np.median(middle[peak[row.member]])))


def _of_true_lines(light: np.ndarray, blocks: Sequence[Block], comb: Comb) -> list[Block]:
    """`blocks` with only those lines that are brighter than both their sides all along: where lanes end at brighter
    ground there is an edge, but no line."""
    if len(blocks) < FEWEST_BLOCKS:
        return []
    number = np.concatenate([block.number for block in blocks])
    over = []
    for block in blocks:
        line, *sides = (values(light, block.lines(aside)) for aside in (0.0, -LINE_SIDE, LINE_SIDE))
        over.append(line - np.maximum(*sides))
    rise = np.concatenate(over)
    numbers, count = np.unique(number, return_counts=True)
    typical = np.array([np.median(rise[number == n]) for n in numbers])
    true = (count > BLOCKS_KEPT * len(blocks)) & (typical > TRUE_LINE * np.quantile(typical, 0.75))
    if typical.max() <= 0 or true.sum() < comb.fewest:
        return []
    return [one for block in blocks if (one := block.only(numbers[true], comb.fewest - 1)) is not None]


def _is_painted(image: np.ndarray, blocks: Sequence[Block], comb: Comb) -> bool:
    """Whether the lines keep their pitch and are brighter than the ground, which is uniform along them."""
    period, scatter = median_and_sd(np.array([block.row.period for block in blocks]))
    if scatter / period > COMB_UNEVEN:
        return False
    paint = np.array([np.median(values(image, block.lines()), axis=0) for block in blocks])
    ground = np.array([np.median(values(image, block.lines(0.5)[:-1]), axis=0) for block in blocks])
    over = np.median(paint, axis=0) - np.median(ground, axis=0)
    contrast = float(over[:2].mean())
    steps = ROBUST_SD * float(np.median(np.abs(np.diff(ground[:, :2].mean(1)))))
    # white paint on red ground adds less in red than in green and blue
    return contrast > CONTRAST * min(1.0, comb.line / 0.5) and steps < STEPS * contrast and float(over.min()) > 0
