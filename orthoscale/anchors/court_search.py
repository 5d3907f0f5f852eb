"""Where courts may lie: frames on pairs of long parallel ridges, and in each the best place along them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from .circle_search import circled
from .court_models import Court
from .poses import Poses, Ridges
from .ridges import CLEAR_RIDGE, SEED_PX

SEEDS_APART = np.radians(2.5)  # largest angle between two seeds
LONG_STROKES = 0.6  # shares of the longest stroke and of the widest pair: least lengths and gaps of strokes with seeds
SEED_SLACK = 6  # [px] by which a seed may reach beyond its stroke
ALONG_PAIR = np.linspace(-4, 4, 9)  # [m] places along a pair where the ridges of all long strokes are looked up
PROMISING_FRAME = 0.3  # least mean ridge there
STROKE_ENOUGH = 0.7  # of a clear ridge: no stroke counts for more
FRAMES_AT_ONCE = 64  # placed together: for speed and memory
SAME_SIZE = 0.03  # [ln] and, across the seeds, [px]: frames this near each other count as one
SAME_PX = 2.0
FRAMES = 3000  # most promising ones kept per megapixel, but never fewer than:
FEWEST_FRAMES = 100
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
class _Frames:
    """Poses of courts whose place along the seeds is not known yet, (N,) each. angle : of the seeds [rad]. size : px
    per metre. middle : the court's centre across the seeds; low, high : limits of its place along them; about : the
    seeds' own place along them; all from the picture's origin [px]. promise : mean ridge."""

    angle: np.ndarray
    size: np.ndarray
    middle: np.ndarray
    low: np.ndarray
    high: np.ndarray
    about: np.ndarray
    promise: np.ndarray

    def only(self, which: np.ndarray | slice) -> _Frames:
        return _Frames(*(each[which] for each in vars(self).values()))


def search(ridges: Ridges, court: Court, size: float, spread: float) -> Poses:
    """Where `court` may lie, best first, with only the best of poses near each other. A metre is `size` [px] to within
    a factor exp(spread)."""
    found = [Poses(np.zeros((0, 2)), *np.zeros((3, 0)))]
    if not _families(court):
        found.append(circled(ridges, court, size, spread))
    for family in _families(court):
        frames = _framed(ridges, family, size, spread)
        if len(frames.angle):
            for start in range(0, len(frames.angle), FRAMES_AT_ONCE):
                found.append(_placed(ridges, court, family, frames.only(np.s_[start : start + FRAMES_AT_ONCE])))
    names = ("place", "angle", "size", "score")
    poses = Poses(*(np.concatenate([getattr(one, name) for one in found]) for name in names))
    return _alone(poses.only(np.argsort(-poses.score, kind="stable")), court)


def _framed(ridges: Ridges, family: _Family, size: float, spread: float) -> _Frames:
    seeds = ridges.seeds
    longest, widest = float((family.high - family.low).max()), float(np.ptp(family.at))
    reach = size * np.exp(spread) * np.array([longest / 2, widest])
    # pairs near in place and direction: a turn by SEEDS_APART counts as much as the whole reach
    most = float(np.hypot(*reach))
    around = most / (2 * np.sin(SEEDS_APART)) * np.stack([np.cos(2 * seeds.angle), np.sin(2 * seeds.angle)], 1)
    pair = cKDTree(np.hstack([seeds.middle, around])).query_pairs(most * np.sqrt(2), output_type="ndarray")
    turn = (seeds.angle[pair[:, 1]] - seeds.angle[pair[:, 0]] + np.pi / 2) % np.pi - np.pi / 2
    pair, turn = pair[np.abs(turn) <= SEEDS_APART], turn[np.abs(turn) <= SEEDS_APART]
    angle = seeds.angle[pair[:, 0]] + turn / 2
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y = seeds.middle[pair, 0], seeds.middle[pair, 1]
    along, across = x * c + y * s, y * c - x * s
    first = np.argsort(across, axis=1)
    along, across = np.take_along_axis(along, first, 1), np.take_along_axis(across, first, 1)
    near = np.abs(np.diff(along, axis=1)[:, 0]) <= reach[0]
    angle, along, across = angle[near], along[near], across[near]
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
            rows.append(np.stack([angle, own, middle, low, high, along.mean(1), 0 * angle])[:, fits])
    frames = _Frames(*np.concatenate(rows, 1))
    promise = _promise(ridges, family, frames)
    order = np.argsort(-promise, kind="stable")
    frames = replace(frames, promise=promise).only(order[promise[order] >= PROMISING_FRAME])
    # the most promising of frames that count as one, with the limits of all of them together
    turn = np.rint(frames.angle / SEEDS_APART)
    c, s = np.cos(frames.angle - turn * SEEDS_APART), np.sin(frames.angle - turn * SEEDS_APART)
    scale = np.rint(np.log(frames.size / size) / SAME_SIZE)
    key = [turn, scale, (frames.middle * c + frames.about * s) // SAME_PX, frames.about // (longest * size / 2)]
    _, alone, group = np.unique(np.stack(key, 1), axis=0, return_index=True, return_inverse=True)
    low, high = frames.low[alone], frames.high[alone]
    np.minimum.at(low, group.ravel(), frames.low)
    np.maximum.at(high, group.ravel(), frames.high)
    most_promising = np.argsort(alone)[: max(FEWEST_FRAMES, round(FRAMES * ridges.width * ridges.height / 1e6))]
    return replace(frames.only(alone), low=low, high=high).only(most_promising)


def _promise(ridges: Ridges, family: _Family, frames: _Frames) -> np.ndarray:
    """(N,) mean ridge of all the long strokes near the seeds."""
    c, s = np.cos(frames.angle)[:, None], np.sin(frames.angle)[:, None]
    along = frames.about[:, None] + frames.size[:, None] * ALONG_PAIR
    total = np.zeros(len(frames.angle))
    for at in family.at:
        across = (frames.middle + frames.size * at)[:, None]
        ridge = ridges.at(along * c - across * s, along * s + across * c, frames.angle[:, None])
        total += np.minimum(ridge.mean(1) / CLEAR_RIDGE, STROKE_ENOUGH)
    return total / len(family.at)


def _placed(ridges: Ridges, court: Court, family: _Family, frames: _Frames) -> Poses:
    """The best places along the seeds, a few for each frame."""
    pieces = court.pieces(COARSE_PIECE)
    steps = int(np.ceil((frames.high - frames.low).max())) + 1
    shift = frames.low[:, None] + np.arange(steps)  # (N, T) [px]
    angle = frames.angle - family.direction
    c, s = np.cos(family.direction), np.sin(family.direction)
    weight = (pieces.weight / pieces.weight.sum() / CLEAR_RIDGE).astype(np.float32)
    turn = frames.angle[:, None, None].astype(np.float32)
    cos, sin = np.cos(turn), np.sin(turn)
    size = frames.size[:, None, None]
    score = np.zeros(shift.shape, np.float32)
    parallel = np.abs(np.sin(pieces.direction - family.direction)) < 0.1
    # strokes that cross the seeds need every pixel along them, parallel ones only some
    for which, every in ((~parallel, 1), (parallel, APART)):
        u, v = pieces.middle[which] @ (c, s), pieces.middle[which] @ (-s, c)
        along = (shift[:, ::every, None] + size * u).astype(np.float32)
        across = (frames.middle[:, None, None] + size * v).astype(np.float32)
        direction = (angle[:, None, None] + pieces.direction[which]).astype(np.float32)
        ridge = ridges.at(along * cos - across * sin, along * sin + across * cos, direction)
        part = ridge.astype(np.float32) @ weight[which]
        place = np.arange(steps) / every
        left = np.minimum(place.astype(int), part.shape[1] - 1)
        right = np.minimum(left + 1, part.shape[1] - 1)
        rest = (place - left).astype(np.float32)
        score += part[:, left] * (1 - rest) + part[:, right] * rest
    score[shift > frames.high[:, None] + 1] = -1
    row, found = np.arange(len(score)), []
    for _ in range(PLACES):
        column = score.argmax(1)
        found.append(np.stack([row, column, score[row, column]], 1))
        score[np.abs(np.arange(steps) - column[:, None]) < APART] = -1
    best = np.concatenate(found)
    best = best[best[:, 2] >= LIKELY_PLACE]
    row, column = best[:, :2].astype(int).T
    along, across, cos, sin = shift[row, column], frames.middle[row], cos[row, 0, 0], sin[row, 0, 0]
    place = np.stack([along * cos - across * sin, along * sin + across * cos], 1)
    return Poses(place, angle[row], frames.size[row], best[:, 2])


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
