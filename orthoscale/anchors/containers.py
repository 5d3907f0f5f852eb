"""ISO containers in rows, by the outlines of their roofs.

A roof is a rectangle of one colour, five times or two and a half times as long as wide. A single rectangle may be
anything, but nothing else stands in rows of equal rectangles a hand's breadth apart. Next to dark gaps and shadows the
edges of roofs appear displaced by 0.1 to 0.3 m, and stacks are nearer to the camera than the ground. These errors are
common to all containers of one place, so the spread of the standards is wide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..core.anchors import Anchor, Standard
from ..core.angles import axis_angle, quarter_turn, unit_vector
from ..core.linked import linked_groups
from ..core.normal import robust_sd
from .peaks import peak_shift
from .repeated import LOCAL_STRETCH
from .rules import SIGMAS_SEARCHED, within_reach
from .strokes import values

CONTAINER_WIDTH, DOMESTIC_WIDTH = 2.438, 2.591  # [m] of ISO containers, 8 ft; of longer American ones, 102 in
LONGEST_ISO = 13.8  # [m]
CONTAINER_SPREAD = 0.018  # relative one sigma: edges beside gaps and shadows, heights of stacks; common to a place
_SOURCE = "ISO 668: series 1 freight containers, 2.438 m wide; the spread is ours: rims beside gaps, stacks' heights"
CONTAINERS = (
    Standard("container of 40 ft", 12.192, CONTAINER_SPREAD, _SOURCE, 0.5),
    Standard("container of 20 ft", 6.058, CONTAINER_SPREAD, _SOURCE, 0.4),
    Standard("container of 45 ft", 13.716, CONTAINER_SPREAD, _SOURCE, 0.1),
    Standard(
        "container or trailer of 53 ft",
        16.154,
        CONTAINER_SPREAD,
        "AAR M-930 domestic containers and 23 CFR 658 trailers: 53 ft long, 102 in wide; the spread is ours, as above",
        0.4,
        ("US", "CA"),
    ),
)
CONTAINER_FALSE = 0.1

FEWEST_CONTAINERS = 3  # in a row
SEGMENTED = 0.15  # [m/px] at which roofs are segmented: corrugation hardly shows; coarser pictures are enlarged
ROOF_EDGES = (3.0, 5.0, 8.0, 13.0, 21.0)  # [grey levels/px] of an edge between roofs: each is tried
ROUGH_SLACK = 1.22  # factor by which a region's sides may differ from a container's at the given scale
ROUGH_AREA = 0.25  # of a roof's area: least area of a region
ROUGH_BOX = 1.2  # of a roof's length: largest diagonal of the upright box about a region
ROOF_FULL = 0.8  # least share of its bounding rectangle that a region fills
SAME_ROOF = 0.4  # of its width: nearer to a roof's middle, another fit is to the same roof
ASPECT = -0.12, 0.04  # limits of ln(aspect ratio / that of a standard): part of a gap is taken for roof
ASPECT_PX = 0.4  # [px] error of the width that widens these limits
EDGE_SOUGHT, EDGE_SOUGHT_PX = 0.35, 1.5  # [m] and [px] on either side of a rough side where its edge is searched
FIRST_EDGE = 0.5  # of the strongest edge: least strength of a clear one
END_PARTS, SIDE_PARTS = 3, 8  # number of parts of an end and of a long side that are measured separately
SIDE_MEASURED = 0.85  # of a side, without its corners
PART_LINES = 5  # cross sections of a part that are averaged
ACROSS_EDGE = 0.25  # [px] step of the samples across an edge
FAINTEST_EDGE = 0.3  # [grey levels] from one step to the next
FEWEST_PARTS = 8  # in all sides together
FIT_ROUNDS, ROBUST_ROUNDS = 3, 5
ROOF_TURN = 0.1  # [rad] most that one round of the fit turns a roof
EDGE_CLEAR = 0.6  # least share of each side's parts whose edges lie within ...
EDGE_STRAIGHT, EDGE_STRAIGHT_PX = 0.1, 0.4  # ... so many [m] and [px] of the fitted side
ROW_TURN = np.radians(2.5)  # most between neighbours
ROW_LENGTH = 0.02  # most that neighbours' lengths may differ: |ln| of their ratio, plus [px]:
ROW_LENGTH_PX = 0.5
ROW_GAP = -0.1, 0.65  # [m] between neighbours side by side, or end to end
ROW_SHIFT = 0.5  # [m] by which neighbours may be shifted against each other
ROOF_INSIDE = 0.42, 0.32  # of its length and width, to either side of its middle: where a roof's colours are sampled
ROOF_EVEN = 16.0  # [grey levels] largest scatter of one roof's colours, one sigma, mean over the channels
# Of the way between the middles of two neighbours, from halfway: where the gap between them ends at the latest, and
# from where it is surely roof. And of their sides: the width that is looked at.
GAP_WITHIN, GAP_BEYOND, GAP_ALONG = 0.16, 0.21, 0.7
PAINTED_GAP = 6.0  # [grey levels] by which a gap may be brighter than both roofs: else it is a painted line
LENGTH_PX = 0.25  # [px] one sigma of a roof's length, common to a row: edges lie close to other edges


@dataclass(frozen=True)
class Roofs:
    """(N,) rectangles. place : (N, 2) centres [px]. angle : of their long sides [rad]. length, width : [px]. residual :
    root mean square distance of the edges from the fitted sides [px]."""

    place: np.ndarray
    angle: np.ndarray
    length: np.ndarray
    width: np.ndarray
    residual: np.ndarray

    def __len__(self) -> int:
        return len(self.length)

    def __getitem__(self, which: np.ndarray) -> Roofs:
        return Roofs(*(each[which] for each in vars(self).values()))

    @property
    def along(self) -> np.ndarray:
        """(N, 2) unit vectors along the long sides."""
        return unit_vector(self.angle)

    def corners(self) -> np.ndarray:
        """(N, 4, 2) corners in order around each roof [px]."""
        along = self.along * self.length[:, None] / 2
        across = quarter_turn(self.along) * self.width[:, None] / 2
        return self.place[:, None] + np.stack([-along - across, along - across, along + across, across - along], 1)


@dataclass(frozen=True)
class ContainerRows:
    """Finds rows of containers (an `AnchorFinder`) of any of the `standards`."""

    standards: tuple[Standard, ...] = CONTAINERS
    kind = "container"
    extent = 45.0
    finest = 0.05
    coarsest = 0.32

    def find(self, image: np.ndarray, gsd: float, gsd_sd: float, country: str) -> Sequence[Anchor]:
        """See `AnchorFinder.find`."""
        if min(image.shape[:2]) < CONTAINER_WIDTH / gsd * 3:
            return []
        colours = cv2.GaussianBlur(image, (0, 0), 0.5).astype(np.float32)
        standards = [s for s in self.standards if not s.countries or country in s.countries]
        roofs = _roofs(colours, image, gsd, gsd_sd, standards)
        found = []
        for members in _rows(colours, roofs, gsd):
            row = roofs[members]
            length = float(np.median(row.length))
            likely = [s for s in standards if _shaped(length, float(np.median(row.width)), s)]
            meant = within_reach(likely, length, gsd, gsd_sd)
            if meant:
                found.append(self._anchor(row, meant))
        return found

    def _anchor(self, roofs: Roofs, meant: tuple[Standard, ...]) -> Anchor:
        length = float(np.median(roofs.length))
        own = float(np.std(roofs.length)) / length / np.sqrt(len(roofs))
        corners = roofs.corners()
        return Anchor(
            kind=self.kind,
            place=roofs.place.mean(0),
            lines=np.stack([corners, np.roll(corners, -1, axis=1)], 2).reshape(-1, 2, 2),
            pixels=length,
            relative_sd=float(np.sqrt(own**2 + LOCAL_STRETCH**2 + (LENGTH_PX / length) ** 2)),
            residual=roofs.residual,
            standards=meant,
            false=CONTAINER_FALSE,
            count=len(roofs),
        )


def _rough(image: np.ndarray, length: float, width: float, spread: float, gsd: float) -> Roofs:
    """Regions without edges in `image` that are about as large as a roof of `length` and `width` [px]."""
    zoom = min(gsd / SEGMENTED, 2.0)
    how = cv2.INTER_AREA if zoom < 1 else cv2.INTER_CUBIC
    small = cv2.GaussianBlur(cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=how), (0, 0), 0.8)
    factor = np.array(small.shape[1::-1]) / image.shape[1::-1]
    edge = np.zeros(small.shape[:2], np.float32)
    for channel in cv2.split(small):
        gx, gy = (cv2.Sobel(channel, cv2.CV_32F, *d, ksize=3, scale=0.125) for d in ((1, 0), (0, 1)))
        edge = np.maximum(edge, cv2.magnitude(gx, gy))
    slack = ROUGH_SLACK * np.exp(spread)
    rows = []
    for limit in ROOF_EDGES:
        count, label, stats, _ = cv2.connectedComponentsWithStats((edge < limit).astype(np.uint8), connectivity=4)
        area = stats[:, cv2.CC_STAT_AREA] / zoom**2
        box = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]) / zoom
        likely = (area > ROUGH_AREA * length * width) & (area < length * width * slack**2)
        likely &= box < ROUGH_BOX * slack * length
        for k in (np.flatnonzero(likely[1:]) + 1).tolist():
            left, top, w, h = stats[k, :4].tolist()
            region = (label[top : top + h, left : left + w] == k).astype(np.uint8)
            (outline, *_), _ = cv2.findContours(region, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            (x, y), sides, turn = cv2.minAreaRect(outline)
            own = np.array(sides) + 1
            if own.max() * own.min() * ROOF_FULL > region.sum():
                continue
            if own[1] > own[0]:
                own, turn = own[::-1], turn + 90
            place = (np.array([x + left, y + top]) + 0.5) / factor - 0.5
            rows.append([*place, np.radians(turn), *((own + 2) / zoom)])  # edges take a pixel on either side
    found = np.array(rows).reshape(-1, 5)
    fits = (np.abs(np.log(found[:, 3] / length)) < np.log(slack)) & (
        np.abs(np.log(found[:, 4] / width)) < np.log(slack)
    )
    found = found[fits]
    return Roofs(found[:, :2], found[:, 2] % np.pi, found[:, 3], found[:, 4], np.zeros(len(found)))


def _width(standard: Standard) -> float:
    """Width of the standard's containers [m]."""
    return CONTAINER_WIDTH if standard.metres < LONGEST_ISO else DOMESTIC_WIDTH


def _shaped(length: float, width: float, standard: Standard) -> bool:
    """Whether `length` and `width` [px] have about the aspect ratio of containers of a standard."""
    off, slack = np.log(length / width / standard.metres * _width(standard)), ASPECT_PX / width
    return bool(ASPECT[0] - slack < off < ASPECT[1] + slack)


def _roofs(colours: np.ndarray, image: np.ndarray, gsd: float, gsd_sd: float, standards: Sequence[Standard]) -> Roofs:
    """Rectangles of one colour whose four sides lie on straight edges, shaped like containers of any of `standards`; of
    several at one place, the one that fits best."""
    rows = []
    for standard in standards:
        rough = _rough(image, standard.metres / gsd, _width(standard) / gsd, SIGMAS_SEARCHED * gsd_sd, gsd)
        for k in range(len(rough)):
            fitted = _fitted(colours, rough[np.array([k])], gsd)
            if fitted is not None and _shaped(fitted[3], fitted[4], standard):
                rows.append(fitted)
    kept: list[np.ndarray] = []
    for row in sorted(rows, key=lambda row: row[5]):
        if all(np.hypot(*(row[:2] - other[:2])) > SAME_ROOF * other[4] for other in kept):
            kept.append(row)
    found = np.array(kept).reshape(-1, 6)
    return Roofs(found[:, :2], found[:, 2], *found[:, 3:].T)


def _fitted(colours: np.ndarray, roof: Roofs, gsd: float) -> np.ndarray | None:
    """(6,) place, angle, length, width and residual of the rectangle fitted to the edges near a rough one; None if none
    fits."""
    x, y = roof.place[0].tolist()
    angle, length, width = (float(each[0]) for each in (roof.angle, roof.length, roof.width))
    reach = max(EDGE_SOUGHT / gsd, EDGE_SOUGHT_PX)
    close = max(EDGE_STRAIGHT / gsd, EDGE_STRAIGHT_PX)
    for step in range(FIT_ROUNDS):
        c, s = np.cos(angle), np.sin(angle)
        rows, off = [], []
        for end, sign in ((True, 1), (False, 1), (True, -1), (False, -1)):
            along = _spots(END_PARTS, width) if end else _spots(SIDE_PARTS, length)
            off.append(_edges(colours, np.array([x, y]), (c, s), (length, width), end, sign, reach / (1 + step)))
            # derivatives of a part's outward position by the roof's place along and across, angle, half length, half
            # width
            one, none = np.ones(len(along)), np.zeros(len(along))
            columns = (
                [sign * one, none, -sign * along, one, none] if end else [none, sign * one, sign * along, none, one]
            )
            rows.append(np.stack(columns, 1))
        by, gap = np.concatenate(rows), np.concatenate(off)
        seen = np.isfinite(gap)
        if seen.sum() < FEWEST_PARTS:
            return None
        gap = np.where(seen, gap, 0)
        weight, change, left = seen.astype(float), np.zeros(5), gap
        for _ in range(ROBUST_ROUNDS):
            change = np.linalg.lstsq(by * weight[:, None], gap * weight, rcond=None)[0]
            left = gap - by @ change
            weight = seen / (1 + (left / close) ** 2)
        x, y = x + change[0] * c - change[1] * s, y + change[0] * s + change[1] * c
        angle += float(np.clip(change[2], -ROOF_TURN, ROOF_TURN))
        length, width = length + 2 * change[3], width + 2 * change[4]
        if not 2 < width < length:
            return None
    near = seen & (np.abs(left) < close)
    parts = np.split(near, np.cumsum([END_PARTS, SIDE_PARTS, END_PARTS]))
    if min(part.mean() for part in parts) < EDGE_CLEAR or not _is_one_colour(colours, x, y, angle, length, width):
        return None
    return np.array([x, y, angle % np.pi, length, width, float(np.sqrt((left[near] ** 2).mean()))])


def _spots(count: int, length: float) -> np.ndarray:
    """(count,) evenly spaced offsets from the middle of a side of `length`, leaving out its corners."""
    return ((np.arange(count) + 0.5) / count - 0.5) * SIDE_MEASURED * length


def _edges(
    colours: np.ndarray,
    place: np.ndarray,
    heading: tuple[float, float],
    sides: tuple[float, float],
    end: bool,
    sign: int,
    reach: float,
) -> np.ndarray:
    """(parts,) how far [px] outside of a side its innermost clear edge lies; nan where there is none within `reach`.
    The innermost, because the next roof's edge lies across a gap. end : whether it is a short side; sign : on which
    side of the middle."""
    (length, width), (c, s), parts = sides, heading, END_PARTS if end else SIDE_PARTS
    out = np.arange(-reach - 1, reach + 1.01, ACROSS_EDGE)
    along = _spots(parts * PART_LINES, width if end else length)
    along, off = np.meshgrid(along, sign * ((length if end else width) / 2 + out), indexing="ij")
    u, v = (off, along) if end else (along, off)
    spots = place + np.stack([u * c - v * s, u * s + v * c], -1)
    seen = values(colours, spots).reshape(parts, PART_LINES, len(out), 3)
    slope = np.linalg.norm(np.gradient(seen.mean(1), axis=1), axis=2)
    slope = cv2.blur(slope, (3, 1))
    slope[:, np.abs(out) > reach] = 0
    peak = (slope[:, 1:-1] >= slope[:, :-2]) & (slope[:, 1:-1] >= slope[:, 2:])
    clear = peak & (slope[:, 1:-1] > FIRST_EDGE * slope.max(1, keepdims=True))
    best = np.argmax(clear, axis=1) + 1
    row = np.arange(parts)
    left, middle, right = (slope[row, np.clip(best + d, 0, len(out) - 1)] for d in (-1, 0, 1))
    edge = out[best] + peak_shift(left, middle, right) * ACROSS_EDGE
    return np.where(middle > FAINTEST_EDGE, edge, np.nan)


def _is_one_colour(colours: np.ndarray, x: float, y: float, angle: float, length: float, width: float) -> bool:
    c, s = np.cos(angle), np.sin(angle)
    along, across = ROOF_INSIDE
    u, v = np.meshgrid(np.linspace(-along, along, 24) * length, np.linspace(-across, across, 5) * width)
    seen = values(colours, np.stack([x + u * c - v * s, y + u * s + v * c], -1)).reshape(-1, 3)
    return bool(robust_sd(seen).mean() < ROOF_EVEN)


def _rows(colours: np.ndarray, roofs: Roofs, gsd: float) -> list[np.ndarray]:
    """Indices of the roofs of each row: roofs of equal length, side by side or end to end."""
    if len(roofs) < FEWEST_CONTAINERS:
        return []
    i, j = np.triu_indices(len(roofs), 1)
    turn = np.abs(axis_angle(roofs.angle[i] - roofs.angle[j]))
    equal = np.abs(np.log(roofs.length[i] / roofs.length[j])) < ROW_LENGTH + ROW_LENGTH_PX / roofs.length[i]
    step = roofs.place[j] - roofs.place[i]
    along = roofs.along[i]
    ahead = np.abs((step * along).sum(1))
    aside = np.abs(step[:, 1] * along[:, 0] - step[:, 0] * along[:, 1])
    low, high = ROW_GAP[0] / gsd, ROW_GAP[1] / gsd
    beside = aside - (roofs.width[i] + roofs.width[j]) / 2
    behind = ahead - (roofs.length[i] + roofs.length[j]) / 2
    side_by_side = (beside > low - 1) & (beside < high + 0.5) & (ahead < ROW_SHIFT / gsd)
    end_to_end = (behind > low - 1) & (behind < high + 0.5) & (aside < ROW_SHIFT / gsd)
    joined = (turn < ROW_TURN) & equal & (side_by_side | end_to_end)
    pairs = [
        (a, b) for a, b in zip(i[joined].tolist(), j[joined].tolist(), strict=True) if _is_gap(colours, roofs, a, b)
    ]
    if not pairs:
        return []
    a, b = np.array(pairs).T
    return linked_groups(a, b, len(roofs), FEWEST_CONTAINERS)


def _is_gap(colours: np.ndarray, roofs: Roofs, a: int, b: int) -> bool:
    """Whether the strip between two roofs is not brighter than both of them, as a painted line or a joint would be."""
    share = np.linspace(0, 1, 41)
    off = share - 0.5
    along = roofs.along[a]
    middle = roofs.place[a] + share[:, None] * (roofs.place[b] - roofs.place[a])
    side = abs(float((roofs.place[b] - roofs.place[a]) @ along)) < roofs.length[a] / 2
    across = along if side else quarter_turn(along)
    wide = GAP_ALONG * (roofs.length[a] if side else roofs.width[a])
    spots = middle[:, None] + np.linspace(-0.5, 0.5, 15)[:, None] * wide * across
    seen = np.median(values(colours, spots), axis=1).mean(1)
    inside = max(np.median(seen[off < -GAP_BEYOND]), np.median(seen[off > GAP_BEYOND]))
    return bool(seen[np.abs(off) < GAP_WITHIN].max() < inside + PAINTED_GAP)
