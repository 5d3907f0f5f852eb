"""Where courts may lie: on pairs of long parallel ridges, for each pair at the best place along it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from ..core.angles import axis_angle, unit_vector
from .circle_search import circled
from .court_models import PARALLEL_STROKES, Court
from .poses import Poses, Ridges
from .ridges import CLEAR_RIDGE, SEED_PX, Segments

SEEDS_APART = np.radians(2.5)  # largest angle between two seeds
LONG_STROKES = 0.6  # shares of the longest stroke and of the widest pair: least lengths and gaps of strokes with seeds
SEED_SLACK = 6  # [px] by which a seed may reach beyond its stroke
ALONG_PAIR = np.linspace(-4, 4, 9)  # [m] places along a pair where the ridges of all long strokes are looked up
PROMISING_PAIR = 0.3  # least mean ridge there
STROKE_ENOUGH = 0.7  # of a clear ridge: no stroke counts for more
PLACED_AT_ONCE = 64  # loose poses, for speed and memory
SAME_SIZE = 0.03  # [ln] and, across the seeds, [px]: loose poses this near each other count as one
SAME_PX = 2.0
LOOSE_KEPT = 3000  # most promising loose poses kept per megapixel, but never fewer than:
FEWEST_LOOSE = 100
COARSE_PIECE = 1.0  # [m] of a stroke for which one ridge value is looked up
APART = 6  # [px] least distance of two places along a pair, and step for strokes along it, whose ridge changes little
PLACES = 2  # kept along a pair
LIKELY_PLACE = 0.45  # least mean ridge of a place that is worth a fit
OTHER_ANGLE = 0.2  # [rad] least difference of two distinct poses at one place
SAME_SEED = 0.25  # of a court's width: places this near each other lead to the same fit


@dataclass(frozen=True)
class _Family:
    """Long parallel strokes of a court. direction [rad]. at (L,) their places across it [m]; low, high (L,) their ends
    along it [m]."""

    direction: float
    at: np.ndarray
    low: np.ndarray
    high: np.ndarray


@lru_cache(maxsize=64)
def _families(court: Court) -> tuple[_Family, ...]:
    """The long strokes of `court` by direction; for a court without half-turn symmetry, both ways round."""
    lines = [stroke for stroke in court.strokes if not stroke.radius]
    lines = [line for line in lines if line.length >= LONG_STROKES * max(one.length for one in lines)]
    found: dict[float, list[tuple[float, float, float]]] = {}
    for line in lines:
        points, direction = line.at(np.array([0.0, line.length]))
        for turn in (0.0,) if court.symmetric else (0.0, np.pi):
            angle = round(float(direction[0]) % np.pi + turn, 6)
            c, s = np.cos(angle), np.sin(angle)
            low, high = sorted(points @ (c, s))
            found.setdefault(angle, []).append((float(points[0] @ (-s, c)), low, high))
    return tuple(_Family(angle, *np.array(sorted(rows)).T) for angle, rows in found.items() if len(rows) > 1)


@dataclass(frozen=True)
class _LoosePoses:
    """Poses of courts whose place along a pair of seeds is not known yet, (N,) each. angle : of the seeds [rad].
    size : px per metre. middle : the court's centre across the seeds; low, high : limits of its place along them;
    about : the seeds' own place along them; all from the picture's origin [px]."""

    angle: np.ndarray
    size: np.ndarray
    middle: np.ndarray
    low: np.ndarray
    high: np.ndarray
    about: np.ndarray

    def only(self, which: np.ndarray | slice) -> _LoosePoses:
        return _LoosePoses(*(each[which] for each in vars(self).values()))


def search(ridges: Ridges, court: Court, size: float, spread: float) -> Poses:
    """Where `court` may lie, best first, with only the best of poses near each other. A metre is `size` [px] to within
    a factor exp(spread)."""
    found = [Poses(np.zeros((0, 2)), *np.zeros((3, 0)))]
    if not _families(court):
        found.append(circled(ridges, court, size, spread))
    for family in _families(court):
        loose = _promising(ridges, family, size, spread)
        for start in range(0, len(loose.angle), PLACED_AT_ONCE):
            found.append(_placed(ridges, court, family, loose.only(np.s_[start : start + PLACED_AT_ONCE])))
    names = ("place", "angle", "size", "score")
    poses = Poses(*(np.concatenate([getattr(one, name) for one in found]) for name in names))
    return _alone(poses.only(np.argsort(-poses.score, kind="stable")), court)


def _promising(ridges: Ridges, family: _Family, size: float, spread: float) -> _LoosePoses:
    """The loose poses with clear ridges where the strokes of `family` would be, most promising first."""
    longest, widest = float((family.high - family.low).max()), float(np.ptp(family.at))
    reach = size * np.exp(spread) * np.array([longest / 2, widest])
    loose = _on_pairs(*_pairs(ridges.seeds, *reach), family, size, spread)
    promise = _promise(ridges, family, loose)
    order = np.argsort(-promise, kind="stable")
    loose = loose.only(order[promise[order] >= PROMISING_PAIR])
    kept = max(FEWEST_LOOSE, round(LOOSE_KEPT * ridges.width * ridges.height / 1e6))
    return _distinct(loose, size, longest).only(np.s_[:kept])


def _pairs(seeds: Segments, ahead: float, apart: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of parallel seeds no farther than `ahead` from each other along them, and about `apart` across [px]: their
    angle (N,) [rad], and where both lie along and across it (N, 2) from the picture's origin [px], lower one first."""
    # pairs near in place and direction: a turn by SEEDS_APART counts as much as the whole reach
    most = float(np.hypot(ahead, apart))
    around = most / (2 * np.sin(SEEDS_APART)) * unit_vector(2 * seeds.angle)
    pair = cKDTree(np.hstack([seeds.middle, around])).query_pairs(most * np.sqrt(2), output_type="ndarray")
    turn = axis_angle(seeds.angle[pair[:, 1]] - seeds.angle[pair[:, 0]])
    pair, turn = pair[np.abs(turn) <= SEEDS_APART], turn[np.abs(turn) <= SEEDS_APART]
    angle = seeds.angle[pair[:, 0]] + turn / 2
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y = seeds.middle[pair, 0], seeds.middle[pair, 1]
    along, across = x * c + y * s, y * c - x * s
    first = np.argsort(across, axis=1)
    along, across = np.take_along_axis(along, first, 1), np.take_along_axis(across, first, 1)
    near = np.abs(np.diff(along, axis=1)[:, 0]) <= ahead
    return angle[near], along[near], across[near]


def _on_pairs(
    angle: np.ndarray, along: np.ndarray, across: np.ndarray, family: _Family, size: float, spread: float
) -> _LoosePoses:
    """Courts of a size that fits, with any two strokes of `family` on a pair of seeds as `_pairs` gives it."""
    widest = float(np.ptp(family.at))
    half = SEED_PX / 2 - SEED_SLACK
    rows = []
    for p in range(len(family.at)):
        for q in range(p + 1, len(family.at)):
            gap = family.at[q] - family.at[p]
            if gap < LONG_STROKES * widest:  # says little about the size
                continue
            own = (across[:, 1] - across[:, 0]) / gap
            low = (along + half - own[:, None] * family.high[[p, q]]).max(1)
            high = (along - half - own[:, None] * family.low[[p, q]]).min(1)
            middle = (across - own[:, None] * family.at[[p, q]]).mean(1)
            fits = (np.abs(np.log(np.maximum(own, 1e-9) / size)) <= spread) & (high >= low)
            rows.append(np.stack([angle, own, middle, low, high, along.mean(1)])[:, fits])
    return _LoosePoses(*np.concatenate(rows, 1))


def _distinct(loose: _LoosePoses, size: float, longest: float) -> _LoosePoses:
    """The first of loose poses that count as one, with the limits of all of them together, in their order. size : px
    per metre, roughly. longest : length of the longest stroke [m]."""
    turn = np.rint(loose.angle / SEEDS_APART)
    c, s = np.cos(loose.angle - turn * SEEDS_APART), np.sin(loose.angle - turn * SEEDS_APART)
    scale = np.rint(np.log(loose.size / size) / SAME_SIZE)
    key = [turn, scale, (loose.middle * c + loose.about * s) // SAME_PX, loose.about // (longest * size / 2)]
    _, alone, group = np.unique(np.stack(key, 1), axis=0, return_index=True, return_inverse=True)
    low, high = loose.low[alone], loose.high[alone]
    np.minimum.at(low, group.ravel(), loose.low)
    np.maximum.at(high, group.ravel(), loose.high)
    return replace(loose.only(alone), low=low, high=high).only(np.argsort(alone))


def _promise(ridges: Ridges, family: _Family, loose: _LoosePoses) -> np.ndarray:
    """(N,) mean ridge of all the long strokes near the seeds."""
    c, s = np.cos(loose.angle)[:, None], np.sin(loose.angle)[:, None]
    along = loose.about[:, None] + loose.size[:, None] * ALONG_PAIR
    total = np.zeros(len(loose.angle))
    for at in family.at:
        across = (loose.middle + loose.size * at)[:, None]
        ridge = ridges.at(along * c - across * s, along * s + across * c, loose.angle[:, None])
        total += np.minimum(ridge.mean(1) / CLEAR_RIDGE, STROKE_ENOUGH)
    return total / len(family.at)


def _placed(ridges: Ridges, court: Court, family: _Family, loose: _LoosePoses) -> Poses:
    """The best places along the seeds, a few for each of the loose poses."""
    pieces = court.pieces(COARSE_PIECE)
    steps = int(np.ceil((loose.high - loose.low).max())) + 1
    shift = loose.low[:, None] + np.arange(steps)  # (N, T) [px]
    angle = loose.angle - family.direction
    c, s = np.cos(family.direction), np.sin(family.direction)
    weight = (pieces.weight / pieces.weight.sum() / CLEAR_RIDGE).astype(np.float32)
    turn = loose.angle[:, None, None].astype(np.float32)
    cos, sin = np.cos(turn), np.sin(turn)
    size = loose.size[:, None, None]
    score = np.zeros(shift.shape, np.float32)
    parallel = np.abs(np.sin(pieces.direction - family.direction)) < PARALLEL_STROKES
    # strokes that cross the seeds need every pixel along them, parallel ones only some
    for which, every in ((~parallel, 1), (parallel, APART)):
        u, v = pieces.middle[which] @ (c, s), pieces.middle[which] @ (-s, c)
        along = (shift[:, ::every, None] + size * u).astype(np.float32)
        across = (loose.middle[:, None, None] + size * v).astype(np.float32)
        direction = (angle[:, None, None] + pieces.direction[which]).astype(np.float32)
        ridge = ridges.at(along * cos - across * sin, along * sin + across * cos, direction)
        part = ridge.astype(np.float32) @ weight[which]
        place = np.arange(steps) / every
        left = np.minimum(place.astype(int), part.shape[1] - 1)
        right = np.minimum(left + 1, part.shape[1] - 1)
        rest = (place - left).astype(np.float32)
        score += part[:, left] * (1 - rest) + part[:, right] * rest
    score[shift > loose.high[:, None] + 1] = -1
    row, found = np.arange(len(score)), []
    for _ in range(PLACES):
        column = score.argmax(1)
        found.append(np.stack([row, column, score[row, column]], 1))
        score[np.abs(np.arange(steps) - column[:, None]) < APART] = -1
    best = np.concatenate(found)
    best = best[best[:, 2] >= LIKELY_PLACE]
    row, column = best[:, :2].astype(int).T
    along, across, cos, sin = shift[row, column], loose.middle[row], cos[row, 0, 0], sin[row, 0, 0]
    place = np.stack([along * cos - across * sin, along * sin + across * cos], 1)
    return Poses(place, angle[row], loose.size[row], best[:, 2])


def _alone(poses: Poses, court: Court) -> Poses:
    """`poses` without those near an earlier one."""
    kept: list[int] = []
    for i in range(len(poses.score)):
        gap = np.hypot(*(poses.place[kept] - poses.place[i]).T)
        turn = poses.angle[kept] - poses.angle[i]
        turn = np.abs(np.sin(turn)) if court.symmetric else np.abs(np.sin(turn / 2)) * 2
        if not ((gap < SAME_SEED * min(court.size) * poses.size[i]) & (turn < OTHER_ANGLE)).any():
            kept.append(i)
    return poses.only(np.array(kept, int))
