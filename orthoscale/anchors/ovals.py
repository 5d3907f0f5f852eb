"""Whole running tracks, by the length of their inner edge.

The 400 m are measured 0.30 m outside of it, whatever the radius of the bends and the length of the straights. Edges of
the right curvature vote for the centres of bends (Hough; Duda and Hart 1972). Two bends that fit together make an oval,
which is fitted to the edge. The lanes, a band of one colour outside of it, show that it is the inner edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..core.anchors import Anchor, Standard
from ..core.angles import unit_vector
from ..core.normal import ROBUST_SD
from .peaks import circle_centres, peak_shift
from .repeated import LOCAL_STRETCH
from .rules import sizes, within_reach
from .strokes import values

KERB = 2 * 84.389 + 2 * np.pi * 36.5  # [m] 398.12
OVAL = Standard(
    "400 m track, inner edge",
    KERB,
    0.003,
    "World Athletics, Technical Rule 14.2: 400 m measured 0.30 m outward from the kerb: 398.12 m along it for any "
    "radius, 36.5 m as a rule; the spread is ours: white line or surface in place of the kerb",
)

OVAL_FALSE = 0.03
SEARCHED_OVAL = 0.6  # [m/px] of the search
RADII = 30.0, 45.0  # [m] of bends
STRAIGHT = 1.5, 3.2  # limits of the straights in radii: 2.31 by the rule
VOTING_EDGE = 1.5  # of the mean gradient around: least gradient of an edge that votes
AROUND_PX = 31  # [px] side of the square for that mean
OVAL_BIN = 3  # [px] side of an accumulator cell
BEND_SEEN = 0.16  # of a whole circle: least votes for a bend, which is half of one
MOST_BENDS, MOST_OVALS = 60, 20  # of one picture, the clearest
BENDS_APART = 1.5  # [px] step between the radii that are tried
UNLIKE_BENDS = 0.06  # of the radius: most that those of an oval's two bends may differ
OVAL_SAMPLES = 240  # points along an oval
SEEN_OVAL = 0.45  # least share of the oval on edges that run along it, before the fit ...
FITTED_OVAL = 0.7  # ... and after, close to it
ALONG_EDGE = 0.9  # least cosine of the angle between an edge's normal and the oval's
WINDOWS_OVAL = (4.0, 2.0, 1.0, 0.8)  # [m] about the oval where its edge is looked for, round by round ...
LEAST_WINDOW_OVAL = 1.5  # [px] ... but never closer than this
CLOSE_TO_OVAL, CLOSE_TO_OVAL_PX = 0.5, 1.0  # [m] and [px]: the oval is seen where an edge is this close to it
EDGE_SPREAD_PX = 0.1  # [px] least one sigma about a fit by which its outliers are judged
BAND = 3.6, 12.5  # [m] width of the lanes: 3 to 10
OFF_EDGE = 1.0  # [m] from the inner edge to where colours inside and of the lanes are sampled
BAND_COLOUR = 0.5, 2.0  # of the step from the colour inside to that of the lanes: limits of what counts as lanes
BAND_EVEN = 0.5  # of the step at the inner edge: most that colours may scatter within the lanes, one sigma
EDGE_STEP = 10.0  # [grey levels] least step at the inner edge, median over the oval


@dataclass(frozen=True)
class Oval:
    """middle : (2,) [px]. angle : of the straights [rad]. straight, radius : [px]."""

    middle: np.ndarray
    angle: float
    straight: float
    radius: float

    @property
    def length(self) -> float:
        """Perimeter [px]."""
        return float(2 * self.straight + 2 * np.pi * self.radius)

    def points(self, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evenly spaced points (count, 2) [px], outward unit normals (count, 2), and the half on which each lies along
        the straights' direction: -1 or 1 in the bends, 0 on the straights."""
        s = (np.arange(count) + 0.5) / count * self.length
        bend = np.pi * self.radius
        part = np.searchsorted(np.cumsum([self.straight, bend, self.straight]), s)
        start = np.array([0, self.straight, self.straight + bend, 2 * self.straight + bend])[part]
        along = s - start
        turn = along / self.radius
        x = np.choose(part, [along - self.straight / 2, self.straight / 2 + self.radius * np.sin(turn),
                             self.straight / 2 - along, -self.straight / 2 - self.radius * np.sin(turn)])  # fmt: skip
        nx = np.choose(part, [0 * s, np.sin(turn), 0 * s, -np.sin(turn)])
        ny = np.choose(part, [0 * s - 1, -np.cos(turn), 0 * s + 1, np.cos(turn)])
        y = ny * self.radius
        c, s_ = np.cos(self.angle), np.sin(self.angle)
        turned = np.array([[c, s_], [-s_, c]])
        half = np.choose(part, [0, 1, 0, -1])
        return self.middle + np.stack([x, y], 1) @ turned, np.stack([nx, ny], 1) @ turned, half


@dataclass(frozen=True)
class TrackOvals:
    """Finds whole running tracks (an `AnchorFinder`) of any of the `standards`."""

    standards: tuple[Standard, ...] = (OVAL,)
    kind = "track oval"
    extent = 200.0
    finest = 0.25
    coarsest = 0.8

    def find(self, image: np.ndarray, gsd: float, gsd_sd: float, country: str) -> Sequence[Anchor]:
        """See `AnchorFinder.find`."""
        low, high = sizes(self.standards, gsd, gsd_sd)
        if np.hypot(*image.shape[:2]) < low / np.pi:
            return []
        zoom = min(1.0, gsd / SEARCHED_OVAL)
        small = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA)
        factor = np.array(small.shape[1::-1]) / image.shape[1::-1]
        look = cv2.GaussianBlur(image, (0, 0), 1.0)
        found: list[Anchor] = []
        for rough in _candidates(small, low * zoom, high * zoom):
            middle = (rough.middle + 0.5) / factor - 0.5
            if any(np.hypot(*(anchor.place - middle)) < rough.radius / zoom for anchor in found):
                continue
            start = Oval(middle, rough.angle, rough.straight / zoom, rough.radius / zoom)
            fitted = _fitted(look, start, gsd)
            if fitted is None:
                continue
            oval, residual, sd = fitted
            meant = within_reach(self.standards, oval.length, gsd, gsd_sd)
            if meant and _has_lanes(image, oval, gsd):
                corner = oval.points(120)[0]
                lines = np.stack([corner, np.roll(corner, -1, axis=0)], 1)
                relative = float(np.hypot(sd, LOCAL_STRETCH / 2))
                found.append(Anchor(self.kind, oval.middle, lines, oval.length, relative, residual, meant, OVAL_FALSE))
        return found


def _gradients(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) each: gradients along x and y, of the channel that changes most."""
    gx, gy = (cv2.Sobel(cv2.GaussianBlur(image, (0, 0), 1.0), cv2.CV_32F, *d, ksize=3) for d in ((1, 0), (0, 1)))
    most = (gx**2 + gy**2).argmax(2)[..., None]
    return np.take_along_axis(gx, most, 2)[..., 0], np.take_along_axis(gy, most, 2)[..., 0]


def _candidates(image: np.ndarray, low: float, high: float) -> list[Oval]:
    """Ovals with a perimeter from `low` to `high` [px] that lie on edges of `image`, those with most edges first."""
    gx, gy = _gradients(image)
    size = cv2.magnitude(gx, gy)
    clear = size > VOTING_EDGE * cv2.blur(size, (AROUND_PX, AROUND_PX)) + 2.0
    y, x = np.nonzero(clear)
    nx, ny = gx[y, x] / size[y, x], gy[y, x] / size[y, x]
    radii = np.arange(RADII[0] * low / KERB, RADII[1] * high / KERB, BENDS_APART)
    bends = np.concatenate([circle_centres((x, y), (nx, ny), r, clear.shape, OVAL_BIN, BEND_SEEN) for r in radii])
    best = bends[np.argsort(-bends[:, 3], kind="stable")][:MOST_BENDS]
    ovals = []
    for i in range(len(best)):
        for j in range(i):
            step = best[i, :2] - best[j, :2]
            straight, radius = float(np.hypot(*step)), float(best[[i, j], 2].mean())
            oval = Oval(best[[i, j], :2].mean(0), float(np.arctan2(step[1], step[0])), straight, radius)
            right = STRAIGHT[0] * radius < straight < STRAIGHT[1] * radius and low < oval.length < high
            if not right or abs(best[i, 2] - best[j, 2]) > UNLIKE_BENDS * radius:
                continue
            seen = _seen(gx, gy, clear, oval)
            if seen > SEEN_OVAL:
                ovals.append((seen, oval))
    return [oval for _, oval in sorted(ovals, key=lambda each: -each[0])[:MOST_OVALS]]


def _seen(gx: np.ndarray, gy: np.ndarray, clear: np.ndarray, oval: Oval) -> float:
    """Share of `oval` near clear edges that run along it."""
    place, normal, _ = oval.points(OVAL_SAMPLES)
    hit = np.zeros(OVAL_SAMPLES, bool)
    for off in (-2, -1, 0, 1, 2):
        column, row = np.rint(place + off * normal).astype(int).T
        inside = (column >= 0) & (column < gx.shape[1]) & (row >= 0) & (row < gx.shape[0])
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        across = np.abs(gx[row, column] * normal[:, 0] + gy[row, column] * normal[:, 1])
        hit |= inside & clear[row, column] & (across > ALONG_EDGE * np.hypot(gx[row, column], gy[row, column]))
    return float(hit.mean())


def _fitted(image: np.ndarray, oval: Oval, gsd: float) -> tuple[Oval, np.ndarray, float] | None:
    """The oval fitted to the edges near a first one, the distances of edges from it [px], and the relative one sigma of
    its length by these; None where there is no edge with the same change of colour nearly all round."""
    light = image.astype(np.float32)
    for window in WINDOWS_OVAL:
        reach = max(window / gsd, LEAST_WINDOW_OVAL)
        edges = _edges(light, oval, reach)
        if edges is None:
            return None
        peak, weight = edges
        by = _rows(oval)
        change = _solve(by, peak, weight, reach)
        oval = Oval(
            oval.middle + change[:2], oval.angle + change[2], oval.straight + change[3], oval.radius + change[4]
        )
        if not (oval.straight > 0 and oval.radius > 5):
            return None
    off = peak - by @ change
    close = np.abs(off) < max(CLOSE_TO_OVAL / gsd, CLOSE_TO_OVAL_PX)
    if close.mean() < FITTED_OVAL:
        return None
    covariance = np.linalg.pinv(by[close].T @ by[close]) * float((off[close] ** 2).mean())
    length = np.array([0, 0, 0, 2, 2 * np.pi])
    return oval, off[close], float(np.sqrt(length @ covariance @ length)) / oval.length


def _edges(light: np.ndarray, oval: Oval, reach: float) -> tuple[np.ndarray, np.ndarray] | None:
    """How far outward of OVAL_SAMPLES points of `oval` the edge lies (OVAL_SAMPLES,) [px], at most `reach`, and its
    weight, 0 to 1; None where nothing changes. light : (H, W, 3) float32."""
    offset = np.arange(-reach - 1, reach + 1.01, 0.5)
    place, normal, _ = oval.points(OVAL_SAMPLES)
    seen = values(light, place[:, None] + offset[:, None] * normal[:, None])
    slope = np.gradient(seen, axis=1)
    # the mean change of colour along the whole oval: edges count by how much of it they show
    change = slope.mean(0)
    middle = np.abs(offset) <= reach
    colour = change[middle][np.linalg.norm(change[middle], axis=1).argmax()]
    size = float(np.linalg.norm(colour))
    if size < 1e-3:
        return None
    signed = slope @ (colour / size)
    signed[:, ~middle] = -1e9
    at = signed.argmax(1)
    strength = signed.max(1)
    peak = offset[at].copy()
    inner = (at > 0) & (at < len(offset) - 1)
    rows = np.flatnonzero(inner)
    left, mid, right = (signed[rows, at[rows] + d] for d in (-1, 0, 1))
    fine = (left > -1e8) & (right > -1e8)
    peak[rows[fine]] += 0.5 * peak_shift(left[fine], mid[fine], right[fine])
    return peak, np.clip(strength / max(float(np.median(strength)), 1e-6), 0, 1)


def _rows(oval: Oval) -> np.ndarray:
    """(OVAL_SAMPLES, 5) by how much the points of `oval` move outward with its middle (two columns), angle, straight
    and radius."""
    place, normal, half = oval.points(OVAL_SAMPLES)
    along = unit_vector(oval.angle)
    lever = place - oval.middle
    turned = normal[:, 1] * lever[:, 0] - normal[:, 0] * lever[:, 1]
    return np.column_stack([normal, turned, half * (normal @ along) / 2, np.ones(OVAL_SAMPLES)])


def _solve(by: np.ndarray, peak: np.ndarray, weight: np.ndarray, reach: float) -> np.ndarray:
    """The change (5,) of the oval that solves peak [px] = by @ change by robust least squares (Tukey's weights)."""
    scale = reach / 2
    change = np.zeros(5)
    for _ in range(8):
        off = peak - by @ change
        robust = np.clip(1 - (off / (3 * scale)) ** 2, 0, None) ** 2 * weight
        change = np.linalg.lstsq(by * np.sqrt(robust)[:, None], peak * np.sqrt(robust), rcond=None)[0]
        off = peak - by @ change
        scale = float(np.clip(ROBUST_SD * np.median(np.abs(off)), EDGE_SPREAD_PX, reach / 2))
    return change


def _has_lanes(image: np.ndarray, oval: Oval, gsd: float) -> bool:
    """Whether a band of one colour, as wide as lanes, lies outside of `oval`, and another colour inside."""
    offset = np.arange(-3.0, BAND[1] + 3.0, 0.25)  # [m]
    place, normal, _ = oval.points(OVAL_SAMPLES)
    seen = np.median(values(image, place[:, None] + offset[:, None] / gsd * normal[:, None]), axis=0)
    out = offset > OFF_EDGE
    inside, lanes = np.median(seen[offset < -OFF_EDGE], axis=0), np.median(seen[out & (offset < BAND[0])], axis=0)
    step = lanes - inside
    size = float(np.linalg.norm(step))
    if size < EDGE_STEP:
        return False
    # 0 for the colour inside, 1 for the lanes' colour
    share = (seen - inside) @ step / size**2
    end = np.flatnonzero(out & ((share < BAND_COLOUR[0]) | (share > BAND_COLOUR[1])))
    width = float(offset[end[0]]) if len(end) else np.inf
    even = np.std(share[out & (offset < min(width - OFF_EDGE, BAND[1]))]) < BAND_EVEN
    return bool(even) and BAND[0] < width < BAND[1]
