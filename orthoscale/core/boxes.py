"""Oriented boxes as arrays, and the two things done to them in bulk: exact overlap and non-maximum suppression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import chain

import numpy as np

from .angles import axis_angle, quarter_turn, unit_vector
from .brief import Brief
from .by_value import ByValue

SAME_VEHICLE = 0.5  # intersection over union from which two boxes are one vehicle's; side by side they share nothing
HEAPED = 250  # mean number of neighbours per box from which the boxes cannot be vehicles; closely packed ones have 30
PAIRS = 2**15  # pairs of boxes whose overlap is computed at once, in some 50 MB
KINDS = ("car", "pickup", "van", "larger")  # of vehicles: for passengers, with an open bed, a van or minibus, the rest


def unknown() -> np.ndarray:
    """The `sigma` or `kinds` of boxes of which they are not known: a single NaN, for all of them."""
    return np.array(np.nan)


def of_each(values: np.ndarray, name: str, rows: int, columns: int) -> np.ndarray:
    """A copy of `values` (rows, columns); all NaN if they are `unknown`. Raises ValueError for another shape."""
    each = np.full((rows, columns), np.nan) if np.ndim(values) == 0 else np.array(values, np.float64)
    if each.shape != (rows, columns):
        raise ValueError(f"{rows} boxes but {name} of shape {each.shape}")
    return each


@dataclass(frozen=True, eq=False, repr=False)
class Boxes(ByValue, Brief):
    """N oriented boxes in one image.

    xylwa : (N, 5) float64, centre x, centre y, length (long side), width [px], angle [rad].
        Image coordinates with x right, y down; (0, 0) is the outer corner of the first pixel, whose centre is
        (0.5, 0.5), as in COLMAP and GDAL. The angle is that of the long side from +x, clockwise on screen,
        in [-pi/2, pi/2).
    score : (N,) float64, the detector's confidence in 0..1.
    sigma : (N, 2) float64, relative one-sigma noise of each box's own length and width, NaN where the ruler's holds.
    kinds : (N, 4) float64, probability of each of `KINDS`, NaN where it was not assessed.
    """

    xylwa: np.ndarray
    score: np.ndarray
    sigma: np.ndarray = field(default_factory=unknown)
    kinds: np.ndarray = field(default_factory=unknown)

    def __post_init__(self) -> None:
        xylwa = np.array(self.xylwa, np.float64)
        if xylwa.size and (xylwa.ndim != 2 or xylwa.shape[1] != 5):
            raise ValueError(f"boxes of shape {xylwa.shape}, not (N, 5): x, y, length, width, angle")
        xylwa = xylwa.reshape(-1, 5)
        score = np.array(self.score, np.float64).reshape(-1)
        if len(xylwa) != len(score):
            raise ValueError(f"{len(xylwa)} boxes but {len(score)} scores")
        sigma, kinds = of_each(self.sigma, "sigma", len(score), 2), of_each(self.kinds, "kinds", len(score), len(KINDS))
        flat = xylwa[:, 2] < xylwa[:, 3]
        sigma[flat] = sigma[flat, ::-1]
        xylwa[flat, 2], xylwa[flat, 3] = xylwa[flat, 3], xylwa[flat, 2].copy()
        xylwa[flat, 4] += np.pi / 2
        xylwa[:, 4] = axis_angle(xylwa[:, 4])
        object.__setattr__(self, "xylwa", xylwa)
        object.__setattr__(self, "score", score)
        object.__setattr__(self, "sigma", sigma)
        object.__setattr__(self, "kinds", kinds)

    @classmethod
    def empty(cls) -> Boxes:
        """No boxes."""
        return cls(np.empty((0, 5)), np.empty(0))

    @classmethod
    def concatenate(cls, parts: Sequence[Boxes]) -> Boxes:
        """All boxes of `parts`, in their order; no boxes if there are no parts."""
        if not parts:
            return cls.empty()
        return cls(*(np.concatenate([getattr(p, each.name) for p in parts]) for each in fields(cls)))

    def __len__(self) -> int:
        return len(self.score)

    def brief(self) -> list[tuple[str, str]]:
        """The lines that printing them shows: how many, and the median of each figure with its range."""
        if not len(self):
            return [("boxes", "0")]
        figures = ("length", " px", self.length), ("width", " px", self.width), ("score", "", self.score)
        ranges = [(name, f"{np.median(v):.3g}{unit} ({v.min():.3g} to {v.max():.3g})") for name, unit, v in figures]
        return [("boxes", str(len(self))), *ranges]

    def __getitem__(self, index: np.ndarray | slice) -> Boxes:
        return Boxes(*(getattr(self, each.name)[index] for each in fields(self)))

    @property
    def centre(self) -> np.ndarray:
        """(N, 2) [px]."""
        return self.xylwa[:, :2]

    @property
    def length(self) -> np.ndarray:
        """(N,) [px]."""
        return self.xylwa[:, 2]

    @property
    def width(self) -> np.ndarray:
        """(N,) [px]."""
        return self.xylwa[:, 3]

    @property
    def sides(self) -> np.ndarray:
        """(N, 2) length and width [px]."""
        return self.xylwa[:, 2:4]

    @property
    def angle(self) -> np.ndarray:
        """(N,) [rad]."""
        return self.xylwa[:, 4]

    @property
    def along(self) -> np.ndarray:
        """(N, 2) unit vectors along the long sides."""
        return unit_vector(self.angle)

    @property
    def across(self) -> np.ndarray:
        """(N, 2) unit vectors along the short sides: `along`, a quarter turn clockwise on screen."""
        return quarter_turn(self.along)

    @property
    def corners(self) -> np.ndarray:
        """(N, 4, 2) [px]: front right, rear right, rear left, front left, if the angle's direction is forward."""
        along, across = self.along * self.length[:, None] / 2, self.across * self.width[:, None] / 2
        c = self.centre
        return np.stack([c + along + across, c - along + across, c - along - across, c + along - across], 1)

    def mapped(self, scale: float, shift: tuple[float, float] = (0.0, 0.0)) -> Boxes:
        """The boxes after ``x -> x * scale + shift``."""
        xylwa = self.xylwa.copy()
        xylwa[:, :4] *= scale
        xylwa[:, :2] += shift
        return replace(self, xylwa=xylwa)

    def inside(self, width: float, height: float, border: float = 0.0) -> np.ndarray:
        """(N,) bool: all four corners at least `border` px inside an image of `width` x `height` px."""
        return self.between((border, border), (width - border, height - border))

    def between(self, low: Sequence[float] | np.ndarray, high: Sequence[float] | np.ndarray) -> np.ndarray:
        """(N,) bool: all four corners between the points `low` (2,), upper left, and `high` (2,), lower right [px]."""
        corners = self.corners
        return np.logical_and((corners >= low).all((1, 2)), (corners <= high).all((1, 2)))

    def fault(self, width: float = np.inf, height: float = np.inf) -> tuple[int, str] | None:
        """The first box that is impossible in an image of `width` x `height` px: its index and what is wrong with it;
        None where all are possible. Boxes from files are checked with this."""
        sigma, kinds = (np.nan_to_num(share, nan=0.0) for share in (self.sigma, self.kinds))
        with np.errstate(invalid="ignore"):
            faults = {
                "is not made of numbers": ~np.isfinite(self.xylwa).all(1),
                "has no extent": ~(self.width > 0),
                "is longer than the whole picture": self.length > np.hypot(width, height),
                "has a score that is not from 0 to 1": ~((self.score >= 0) & (self.score <= 1)),
                "has a sigma that is not a fraction": ~((sigma >= 0) & (sigma < np.inf)).all(1),
                "has a kind that is not a probability": ~((kinds >= 0) & (kinds <= 1)).all(1),
            }
        return next(((int(np.argmax(bad)), words) for words, bad in faults.items() if bad.any()), None)


def overlap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Exact intersection over union of paired boxes, (K, 5) and (K, 5) to (K,).

    Each rectangle of `a`, in the coordinate frame of its partner in `b`, is clipped by the partner's four sides
    (Sutherland and Hodgman 1974), and the area of what is left is computed, for many pairs at once.
    """
    blocks = range(0, max(len(a), 1), PAIRS)
    return np.concatenate([_overlap(a[k : k + PAIRS], b[k : k + PAIRS]) for k in blocks])


def _overlap_from(a: np.ndarray, b: np.ndarray, iou: float) -> np.ndarray:
    """`overlap` of pairs that may overlap by `iou` (> 0) or more; 0 for those that surely do not, which are most."""
    out = np.zeros(len(a))
    may = np.flatnonzero(_most_shared(a, b) >= (1 - 1e-9) * iou / (1 + iou) * (a[:, 2] * a[:, 3] + b[:, 2] * b[:, 3]))
    out[may] = overlap(a[may], b[may])
    return out


def _most_shared(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(K,) cheap upper bound of the area that paired boxes share: the area of the smaller box, or that of the rectangle
    in which their extents along the sides of either box overlap, whichever is least."""
    most = np.minimum(a[:, 2] * a[:, 3], b[:, 2] * b[:, 3])
    x, y = (b[:, :2] - a[:, :2]).T
    turn = b[:, 4] - a[:, 4]
    c, s = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    for one, other in ((a, b), (b, a)):
        cos, sin = np.cos(one[:, 4]), np.sin(one[:, 4])
        apart = np.abs(x * cos + y * sin), np.abs(y * cos - x * sin)
        extent = c * other[:, 2] + s * other[:, 3], s * other[:, 2] + c * other[:, 3]
        along, across = (
            np.clip((one[:, 2 + k] + extent[k]) / 2 - apart[k], 0, np.minimum(one[:, 2 + k], extent[k])) for k in (0, 1)
        )
        most = np.minimum(most, along * across)
    return most


def _overlap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    cos, sin = np.cos(b[:, 4]), np.sin(b[:, 4])
    d = Boxes(a, np.zeros(len(a))).corners - b[:, None, :2]
    polygon = np.stack(
        [d[..., 0] * cos[:, None] + d[..., 1] * sin[:, None], -d[..., 0] * sin[:, None] + d[..., 1] * cos[:, None]], -1
    )
    count = np.full(len(a), 4)
    for axis, side in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        polygon, count = _clip(polygon, count, axis, side, b[:, 2 + axis] / 2)
    following = _following(polygon, count)
    valid = np.arange(polygon.shape[1]) < count[:, None]
    cross = polygon[..., 0] * following[..., 1] - polygon[..., 1] * following[..., 0]
    shared = np.abs((cross * valid).sum(1)) / 2
    return shared / np.maximum(a[:, 2] * a[:, 3] + b[:, 2] * b[:, 3] - shared, 1e-12)


def _following(polygon: np.ndarray, count: np.ndarray) -> np.ndarray:
    """(K, V, 2) the vertex that follows each vertex around its own polygon of `count` vertices."""
    index = np.arange(polygon.shape[1])[None] + 1
    index = np.where(index >= np.maximum(count, 1)[:, None], 0, index)
    return np.take_along_axis(polygon, index[..., None], 1)


def _clip(
    polygon: np.ndarray, count: np.ndarray, axis: int, side: float, limit: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Keep the part of each polygon with ``side * coordinate <= limit``."""
    k, v, _ = polygon.shape
    following = _following(polygon, count)
    room, next_room = (limit[:, None] - side * p[..., axis] for p in (polygon, following))
    valid = np.arange(v) < count[:, None]
    keep = (room >= 0) & valid
    cut = ((room >= 0) != (next_room >= 0)) & valid
    t = np.where(cut, room / np.where(cut, room - next_room, 1.0), 0.0)
    crossing = polygon + t[..., None] * (following - polygon)
    # Every vertex gives up to two new ones, itself and the crossing after it; a stable sort packs them to the front.
    candidates = np.stack([polygon, crossing], 2).reshape(k, 2 * v, 2)
    chosen = np.stack([keep, cut], 2).reshape(k, 2 * v)
    new_count = chosen.sum(1)
    order = np.argsort(~chosen, axis=1, kind="stable")[:, : max(int(new_count.max(initial=0)), 1)]
    return np.take_along_axis(candidates, order[..., None], 1), new_count


class _Neighbours:
    """An index of boxes (N, 5) that finds which of them other boxes may touch, by their circumscribed circles.

    They are sorted into one tree per octave of size, so that one long box does not make neighbours of all the others.
    """

    def __init__(self, xylwa: np.ndarray):
        from scipy.spatial import cKDTree

        self._centre, self._reach = xylwa[:, :2], _reach(xylwa)
        octave = np.frexp(self._reach)[1]
        groups = [np.flatnonzero(octave == o) for o in np.unique(octave)]
        self._trees = [(group, cKDTree(self._centre[group]), self._reach[group].max()) for group in groups]

    def count(self, xylwa: np.ndarray) -> np.ndarray:
        """(M,) upper bound of the number of indexed boxes that each of other boxes (M, 5) may touch."""
        centre, reach = xylwa[:, :2], _reach(xylwa)
        count = np.zeros(len(centre), int)
        for _, tree, longest in self._trees:
            count += tree.query_ball_point(centre, reach + longest, return_length=True)
        return count

    def pairs(self, xylwa: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (i, j) of other boxes (M, 5) and the indexed boxes that they may touch, sorted by i and then j."""
        centre, reach = xylwa[:, :2], _reach(xylwa)
        parts = [(np.empty(0, int), np.empty(0, int))]
        for group, tree, longest in self._trees:
            near = tree.query_ball_point(centre, reach + longest)
            lengths = np.fromiter(map(len, near), int, len(near))
            i = np.repeat(np.arange(len(near)), lengths)
            j = group[np.fromiter(chain.from_iterable(near), int, int(lengths.sum()))]
            close = np.hypot(*(centre[i] - self._centre[j]).T) < reach[i] + self._reach[j]
            parts.append((i[close], j[close]))
        i, j = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.lexsort((j, i))
        return i[order], j[order]


def _so_many(count: np.ndarray) -> int:
    """How many of the boxes, each with `count` neighbours, to process at once: for PAIRS pairs or fewer, but at least
    one box."""
    return max(1, int(np.searchsorted(np.cumsum(count[:PAIRS]), PAIRS)))


def _reach(xylwa: np.ndarray) -> np.ndarray:
    """(N,) radii of the boxes' circumscribed circles."""
    return np.hypot(xylwa[:, 2], xylwa[:, 3]) / 2


def overlapping(a: Boxes, b: Boxes, iou: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All pairs (i, j, overlap) of boxes of one image that overlap by `iou` (> 0) or more, sorted by i and then j."""
    neighbours = _Neighbours(b.xylwa)
    count = neighbours.count(a.xylwa)
    start, parts = 0, [(np.empty(0, int), np.empty(0, int), np.empty(0))]
    while start < len(a):
        n = _so_many(count[start:])
        i, j = neighbours.pairs(a.xylwa[start : start + n])
        o = _overlap_from(a.xylwa[start + i], b.xylwa[j], iou)
        enough = o >= iou
        parts.append((start + i[enough], j[enough], o[enough]))
        start += n
    i, j, o = (np.concatenate(column) for column in zip(*parts, strict=True))
    return i, j, o


def matched(a: Boxes, b: Boxes, iou: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One-to-one matches (i, j, overlap) between two sets of boxes of one image that overlap by `iou` or more, best
    first."""
    i, j, o = overlapping(a, b, iou)
    free_a, free_b = np.ones(len(a), bool), np.ones(len(b), bool)
    taken: list[int] = []
    for k in np.argsort(-o, kind="stable"):
        if free_a[i[k]] and free_b[j[k]]:
            free_a[i[k]] = free_b[j[k]] = False
            taken.append(int(k))
    chosen = np.array(taken, int)
    return i[chosen], j[chosen], o[chosen]


def suppress(boxes: Boxes, iou: float = 0.3) -> Boxes:
    """Non-maximum suppression: of boxes that overlap by `iou` or more, the one with the highest score stays.

    Boxes are never merged: an average of two boxes is larger than either when they see different ends of a vehicle.
    """
    boxes = boxes[np.argsort(-boxes.score, kind="stable")]
    neighbours = _Neighbours(boxes.xylwa)
    count = neighbours.count(boxes.xylwa)
    alive = np.ones(len(boxes), bool)
    waiting = np.arange(len(boxes))
    while len(waiting):
        n = _so_many(count[waiting])
        i, j = neighbours.pairs(boxes.xylwa[waiting[:n]])
        i = waiting[i]
        worse = (j > i) & alive[j]
        i, j = i[worse], j[worse]
        clash = _overlap_from(boxes.xylwa[i], boxes.xylwa[j], iou) >= iou
        better, first = np.unique(i[clash], return_index=True)
        # Without any pair, np.split still returns one part.
        for k, rivals in zip(better.tolist(), np.split(j[clash], first[1:]), strict=False):
            if alive[k]:
                alive[rivals] = False
        waiting = waiting[n:]
        waiting = waiting[alive[waiting]]
    return boxes[alive]


def distinct(boxes: Boxes) -> Boxes:
    """`boxes` with one box per vehicle; sorted by falling score if any were dropped.

    Two boxes that overlap by SAME_VEHICLE are of one vehicle. Detectors without non-maximum suppression and merged
    files contain such duplicates. Raises ValueError for more boxes on one another than vehicles can give.
    """
    ordered = boxes[np.argsort(-boxes.score, kind="stable")]
    _, first = np.unique(ordered.xylwa.round(6), axis=0, return_index=True)  # exact copies may be thousands
    ordered = ordered[np.sort(first)]
    if _Neighbours(ordered.xylwa).count(ordered.xylwa).sum() > HEAPED * len(ordered):
        raise ValueError(f"{len(ordered)} boxes overlap almost entirely")
    left = suppress(ordered, SAME_VEHICLE)
    return boxes if len(left) == len(boxes) else left
