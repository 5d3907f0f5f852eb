"""Self-calibration of the ruler by a reconstruction: the height that boxes enclose, their margin and the undercut.

The same vehicle must have one size in all its views. Boxes that enclose height make it larger in flat views, a margin
makes it larger from afar, and an undercut makes boxes grow in the flattest views only. So all three follow from how
sizes change from view to view, without any metres (except that the hull's shape is in metres). Sizes are measured by
the exact projection with the current ruler, their derivatives by measuring again with a changed one: Gauss-Newton
steps, repeated until they converge.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..boxes import Boxes
from ..pooling.posterior import ROBUST_SD
from .exact import FLAT, Hull, ground_size, size_by_ends_and_sides
from .view import Views

Trends = dict[str, dict[str, list[float]]]  # see `trends`
Free = tuple[list[int], list[int]]  # columns of `OwnRuler.value` that are fitted, of lengths and of widths

MIN_VIEWS = 3  # views of one vehicle from which its own mean is taken off
MIN_RESIDUALS = 20  # observations below which nothing is fitted
RULER_STEPS = 16
HEIGHT, MARGIN, UNDERCUT, LEAN, CORNER = range(5)  # columns of `OwnRuler.value`
STRIDE = (0.3, 3.0, 0.3, 0.08, 0.08)  # of one step, at most: far from the answer the slopes are another body's
DIFFERENCES = (0.05, 0.25, 0.05, 0.05, 0.05)  # that give the slopes: [m], [detector px], [m], [1/m], share of the width
RULER_SETTLED, SAME_SLOPES = 0.03, 0.1  # shares of STRIDE at which the steps end, and slopes are not measured again
HIGHEST = 2.2  # of the effective height [m]: the roof of a van
# A card knows no undercut: its effective height is that of a body with upright sides, which grows as much in a view of
# USUAL_LEAN (cotangent of the elevation, along the side in question). UNDERCUT_SD is the prior's one sigma.
UNDERCUT_SD, LEAST_UNDERCUT, MOST_UNDERCUT = 0.3, 0.05, 1.0  # [m]; less shows in upright bodies too, by noise
USUAL_LEAN = 0.7
# How far vehicles' shapes stray from the hull's, one sigma, held against what views tell: their lean by lengths and
# widths (`Hull.end_lean`, `Hull.side_lean`), and the corner. Roofs of saloons begin 0.44 and end 0.28 of the length
# from the bumpers, those of vans 0.16 and 0.01; sides lean in by 0.14 of the width up to a saloon's roof, 0.05 a van's.
LEAN_SD = (0.1, 0.08)
CORNER_SD = 0.07
# Other shapes than upright walls, by what lengths and widths tell beyond height and margin: a body that recedes below
# its waist, one whose walls lean. Corners show where the ground is foreshortened athwart: in lengths.
SHAPES = (([UNDERCUT], [UNDERCUT]), ([LEAN, CORNER], [LEAN]))
LOWEST, LARGEST = (0.0, -np.inf, 0.0, -1.0, 0.0), (HIGHEST, np.inf, MOST_UNDERCUT, 1.0, 0.3)
# How much distances to one vehicle must differ, one sigma, beyond what its elevation angles explain, before its views
# tell a margin. At one altitude, distance and elevation are one thing, and a margin would take up whatever else makes
# boxes change with elevation.
FAR_AND_NEAR = 0.05
HUBER = 1.5  # residuals beyond so many sigmas count less (Huber 1964)


@dataclass(frozen=True)
class OwnRuler:
    """A ruler for lengths and for widths: height [m], margin [detector px], undercut [m], lean [1/m], corner [of the
    width].

    A vehicle is widest above the ground; below, it recedes into its own shade. In steep views its outline is that of
    the waist on all sides, which is its true size. In flatter views the near side ends on the ground, `undercut`
    further in, and only then does height make a box larger. Fitting a straight line to the flat views alone, as for a
    body with upright sides, would remove too much everywhere: on `sheffield` 11 % of the widths.

    value : (2, 5) by axis, in that order. covariance : (2, 5, 5) of these, by axis. views : number of boxes that they
    were fitted to, 0 for the detector's own values. body : the hull to which height, lean and corner belong.
    """

    value: np.ndarray
    covariance: np.ndarray
    views: int = 0
    body: Hull = Hull()

    @classmethod
    def shipped(
        cls,
        height: Sequence[float],
        margin: Sequence[float],
        height_sd: Sequence[float],
        margin_sd: Sequence[float],
        body: Hull | None = None,
    ) -> OwnRuler:
        """What the detector's card says, (2,) each, by lengths and by widths; it knows no undercut."""
        body = body or Hull()
        value = [[h, m, 0.0, 0.0, body.corner] for h, m in zip(height, margin, strict=True)]
        sd = [[h, m, 0.0, lean, CORNER_SD] for h, m, lean in zip(height_sd, margin_sd, LEAN_SD, strict=True)]
        return cls(np.array(value, float), np.array([np.diag(np.square(one)) for one in sd]), body=body)

    @property
    def height(self) -> np.ndarray:
        """(2,) [m]."""
        return self.value[:, HEIGHT]

    @property
    def margin(self) -> np.ndarray:
        """(2,) [detector px]."""
        return self.value[:, MARGIN]

    @property
    def undercut(self) -> np.ndarray:
        """(2,) [m]."""
        return self.value[:, UNDERCUT]

    @property
    def sd(self) -> np.ndarray:
        """(2, 5) one-sigmas, as `value`."""
        return np.sqrt(np.einsum("kii->ki", self.covariance))

    @property
    def hulls(self) -> tuple[Hull, Hull]:
        """The bodies by which lengths and widths are measured."""
        along, across = (
            replace(self.body, height=height, end_lean=lean, side_lean=lean, corner=corner)
            for height, _, _, lean, corner in self.value.tolist()
        )
        return along, across

    def size(self, boxes: Boxes, views: Views, zoom: float, metres_per_unit: float) -> np.ndarray:
        """(N, 2) length and width on the ground [units], the margin taken off; NaN where no vehicle gives the box.

        `zoom` is detector pixels per picture pixel. The margin comes off the box, before it is projected: seen
        obliquely, a pixel covers more ground away from the camera than across.
        """
        xylwa = boxes.xylwa.copy()
        xylwa[:, 2:4] = np.maximum(xylwa[:, 2:4] - self.margin / zoom, 1e-6)
        swapped = xylwa[:, 2] < xylwa[:, 3]  # `Boxes` would call the shorter side the width
        xylwa[swapped, 2:4] = boxes.xylwa[swapped, 2:4]
        tight = Boxes(xylwa, boxes.score)
        size = size_by_ends_and_sides(tight, views, metres_per_unit, self.hulls)
        if self.undercut.any():
            above = -(views.ground * views.normal).sum(1, keepdims=True)  # (N, 1) the camera over the ground
            nearer = 1 - self.height / metres_per_unit / above  # a waist so high is closer than the ground
            waist = ground_size(tight, views, metres_per_unit, replace(self.body, height=FLAT)) * nearer
            size = np.minimum(size + self.undercut / metres_per_unit, np.maximum(waist, size))
        size[swapped] = np.nan
        return size

    def slopes(
        self,
        boxes: Boxes,
        views: Views,
        zoom: float,
        metres_per_unit: float,
        columns: Iterable[int] = range(len(DIFFERENCES)),
    ) -> np.ndarray:
        """(N, 2 axes, 5) how much smaller the size is for one more of each of `value` [units], 0 but for `columns`."""
        out = np.zeros((len(boxes), 2, len(DIFFERENCES)))
        for k in columns:
            change = np.zeros(len(DIFFERENCES))
            change[k] = DIFFERENCES[k]
            low, high = (np.clip(self.value + sign * change, LOWEST, LARGEST) for sign in (-1, 1))
            less, more = (replace(self, value=value).size(boxes, views, zoom, metres_per_unit) for value in (low, high))
            out[:, :, k] = (less - more) / (high - low)[:, k]
        return out

    def relative_sd(self, size: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """(2 axes, 5) one-sigmas of all sizes, relative, from what is not known of each of `value`.

        These are found together and may err against each other: their squares add up to what they leave together.
        """
        share = _median_share(size, slopes)
        together = np.einsum("ki,kij,kj->k", share, self.covariance, share)
        alone = (share * self.sd) ** 2
        return np.sqrt(alone * (together / np.maximum(alone.sum(1), 1e-30))[:, None])

    def left_of_height(self, card: OwnRuler, size: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """(2,) by how much lengths' and widths' errors from bodies correlate with the error of the card's height.

        What views told makes the error of a height, h - fitted, independent of fitted - card; so its covariance with
        h - card is its own variance, and that of any other error its covariance with h - fitted. 1 where no view told.
        None below zero: two errors that cancel in a mean would be more than is known of bodies.
        """
        bodies = [HEIGHT, UNDERCUT, LEAN, CORNER]
        share = _median_share(size, slopes)[:, bodies]
        covariance = self.covariance[:, bodies][:, :, bodies]
        with_height = np.einsum("ki,ki->k", share, covariance[:, :, 0])
        variance = np.einsum("ki,kij,kj->k", share, covariance, share)
        return np.clip(with_height / (np.sqrt(np.maximum(variance, 1e-30)) * card.sd[:, HEIGHT]), 0, 1)

    def document(self, shipped: OwnRuler) -> dict[str, Any]:
        """As plain values, beside those that were `shipped`."""
        return {
            "views": self.views,
            **{
                name: {
                    "card": shipped.value[:, k].tolist(),
                    "fitted": self.value[:, k].tolist(),
                    "sd": self.sd[:, k].tolist(),
                }
                for k, name in enumerate(("effective_height", "margin_px", "undercut", "lean_per_m", "corner"))
            },
        }


def _median_share(size: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """(2 axes, 5) by what share the usual one of sizes (N, 2) is smaller for one more of each of a ruler's values, by
    their `slopes` (N, 2, 5)."""
    return np.nanmedian(slopes / size[..., None], axis=0)


def own_ruler(
    boxes: Boxes,
    views: Views,
    zoom: float,
    members: Sequence[np.ndarray],
    metres_per_unit: float,
    shipped: OwnRuler,
    start: OwnRuler | None = None,
) -> OwnRuler:
    """The ruler for which vehicles have one size in all their views, with the detector's own as the prior.

    start : the current ruler, if it is not `shipped`. members : indices of each vehicle's boxes. metres_per_unit : the
    current scale, for the hull's shape.
    """
    often = [m for m in members if len(m) >= MIN_VIEWS]
    if sum(map(len, often)) < MIN_RESIDUALS:
        return shipped
    index = np.concatenate(often)
    vehicle = np.repeat(np.arange(len(often)), [len(m) for m in often])
    seen = _RulerData(boxes[index], views[index], zoom, metres_per_unit, vehicle, shipped)
    common = [HEIGHT, MARGIN] if _far_and_near(seen.views, vehicle) else [HEIGHT]
    plain = _settled(start or shipped, seen, (common, common))
    before = seen.size(plain)
    best, most, fitted = plain, 0.0, (common, common)
    for shape in SHAPES:
        free = (common + shape[0], common + shape[1])
        shaped = _settled(_undercut(plain) if UNDERCUT in free[0] else plain, seen, free)
        gain = _gain(before, seen.size(shaped), vehicle)
        # Another shape only where the views ask for it: the Bayesian information criterion (Schwarz 1978).
        gain -= sum(map(len, shape)) * float(np.log(len(index)))
        told = UNDERCUT not in free[0] or shaped.undercut.max() > LEAST_UNDERCUT
        if told and gain > most:
            best, most, fitted = shaped, gain, free
    return _with_the_rest(best, seen, fitted)


@dataclass(frozen=True)
class _RulerData:
    """The data that a ruler is fitted to: N boxes of vehicles with enough views, and their views. vehicle : (N,) index
    of each one's vehicle. shipped : the prior. Others as of `own_ruler`."""

    boxes: Boxes
    views: Views
    zoom: float
    metres_per_unit: float
    vehicle: np.ndarray
    shipped: OwnRuler

    def size(self, ruler: OwnRuler) -> np.ndarray:
        """`OwnRuler.size` of all."""
        return ruler.size(self.boxes, self.views, self.zoom, self.metres_per_unit)

    def slopes(self, ruler: OwnRuler, columns: Iterable[int] = range(len(DIFFERENCES))) -> np.ndarray:
        """`OwnRuler.slopes` of all."""
        return ruler.slopes(self.boxes, self.views, self.zoom, self.metres_per_unit, columns)

    def prior(self, free: Free) -> np.ndarray:
        """(2, 5, 5) covariance beforehand, where `free` may be fitted."""
        return _with_undercut(self.shipped.covariance) if UNDERCUT in free[0] else self.shipped.covariance


def _undercut(ruler: OwnRuler) -> OwnRuler:
    """With an undercut to begin with: the search starts above zero, where the gradient vanishes."""
    value = ruler.value.copy()
    value[:, UNDERCUT] += UNDERCUT_SD
    value[:, HEIGHT] += UNDERCUT_SD / USUAL_LEAN
    return replace(ruler, value=value)


def _settled(ruler: OwnRuler, seen: _RulerData, free: Free) -> OwnRuler:
    """The ruler for which each vehicle of `seen` has one size, starting from `ruler`; values that are not `free` are as
    shipped."""
    shipped, prior, vehicle = seen.shipped, seen.prior(free), seen.vehicle
    change, slopes = np.inf, np.empty(0)
    for _ in range(RULER_STEPS):
        size = seen.size(ruler)
        if change > SAME_SLOPES:
            slopes = seen.slopes(ruler, {*free[0], *free[1]})
        good = np.isfinite(size).all(1) & np.isfinite(slopes).all((1, 2))
        value, covariance = shipped.value.copy(), shipped.covariance.copy()
        for axis in range(2):
            least = ruler.hulls[axis].least_lean[axis]
            for fitted in (free[axis], [k for k in free[axis] if k != LEAN]):
                x = slopes[good, axis][:, fitted]
                y = size[good, axis] + x @ ruler.value[axis, fitted]
                chosen = np.ix_(fitted, fitted)
                covariance[axis] = shipped.covariance[axis]
                value[axis, fitted], covariance[axis][chosen] = _within(
                    x, y, vehicle[good], shipped.value[axis, fitted], prior[axis][chosen]
                )
                if value[axis, LEAN] >= least:
                    break
                value[axis, LEAN] = least  # walls do not lean outwards: the others without it
        value[1, CORNER] = value[0, CORNER]
        # Half the way where which views feel the undercut depends on it: whole steps would go to and fro.
        share = 0.5 if UNDERCUT in free[0] else 1.0
        value = ruler.value + np.clip(share * (value - ruler.value), -np.array(STRIDE), STRIDE)
        value = np.clip(value, LOWEST, LARGEST)
        change = (np.abs(value - ruler.value) / STRIDE).max()
        ruler = replace(shipped, value=value, covariance=covariance, views=int(good.sum()))
        if change < RULER_SETTLED:
            break
    return ruler


def _with_the_rest(ruler: OwnRuler, seen: _RulerData, free: Free) -> OwnRuler:
    """`ruler` with the covariance that it has with all that is not known of bodies, `free` or not.

    A body that leans in makes flat views smaller, and a height that is fitted to them lower: the two errors cancel in
    the views that they were fitted to. And a lean that would have shown is not there. So views tell of all of these
    together; by what they would change if all were free, they may be off besides, though by no more than was not known
    before: far off, the slopes are another body's.
    """
    shipped, prior, size, slopes = seen.shipped, seen.prior(free), seen.size(ruler), seen.slopes(ruler)
    good = np.isfinite(size).all(1) & np.isfinite(slopes).all((1, 2))
    covariance = np.zeros_like(shipped.covariance)
    for axis in range(2):
        every = np.flatnonzero(np.diag(prior[axis]) > 0)
        x, value, chosen = slopes[good, axis][:, every], ruler.value[axis, every], np.ix_(every, every)
        told, covariance[axis][chosen] = _within(
            x, size[good, axis] + x @ value, seen.vehicle[good], shipped.value[axis, every], prior[axis][chosen]
        )
        before = np.sqrt(np.diag(prior[axis])[every])
        off = np.clip(told - value, -before, before)
        covariance[axis][chosen] += np.outer(off, off)
    return replace(ruler, covariance=covariance)


def _with_undercut(covariance: np.ndarray) -> np.ndarray:
    """`covariance` (2, 5, 5) of a card, with an undercut that leaves what boxes grow by in views of USUAL_LEAN."""
    direction = np.zeros(covariance.shape[:2])
    direction[:, UNDERCUT] = UNDERCUT_SD
    direction[:, HEIGHT] = UNDERCUT_SD / USUAL_LEAN
    return covariance + direction[:, :, None] * direction[:, None]


def _gain(plain: np.ndarray, shaped: np.ndarray, vehicle: np.ndarray) -> float:
    """By how much `shaped` sizes (N, 2) of each `vehicle` (N,) agree better than `plain` ones: twice the difference of
    their Huber losses, relative to the residual noise of the shaped ones.

    It is the smaller of two: with residuals as shares of each one's own sizes, and of the plain sizes. A body that
    makes vehicles larger reduces the noise as a share of them, one that makes them smaller reduces the noise itself;
    neither is a better agreement.
    """
    good = np.isfinite(plain).all(1) & np.isfinite(shaped).all(1)
    plain, shaped, vehicle = plain[good], shaped[good], vehicle[good]
    count = np.maximum(np.bincount(vehicle), 1)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(vehicle, column) / count for column in values.T], 1)[vehicle]

    typical = np.exp(mean(np.log(plain)))
    gains = []
    for before, after in ((np.log(plain), np.log(shaped)), (plain / typical, shaped / typical)):
        old, new = (np.abs(values - mean(values)) for values in (before, after))
        noise = np.maximum(ROBUST_SD * np.median(new, axis=0), 1e-9)
        loss = [np.where(r < HUBER, r**2, HUBER * (2 * r - HUBER)).sum() for r in (old / noise, new / noise)]
        gains.append(float(loss[0] - loss[1]))
    return min(gains)


def trends(
    before: np.ndarray, after: np.ndarray, elevation: np.ndarray, pixel: np.ndarray, members: Sequence[np.ndarray]
) -> Trends | None:
    """How the scale of a vehicle changes from view to view, before and after calibration; None for too few views.

    before, after : (N, 2) sizes, NaN where a box is of no vehicle at this scale. elevation : (N,) [deg].
    pixel : (N,) what one covers of the ground [units]: the length of a vehicle in pixels, without its box's own error.
    Slopes of the log scale in percent per 10 degrees and per doubling of the length in pixels, each [slope, one sigma].
    """
    known = np.isfinite(before).all(1) & np.isfinite(after).all(1)
    often = [m for m in (m[known[m]] for m in members) if len(m) >= MIN_VIEWS]
    if sum(map(len, often)) < MIN_RESIDUALS:
        return None
    index = np.concatenate(often)
    vehicle = np.repeat(np.arange(len(often)), [len(m) for m in often])
    over = {"percent_per_10_degrees": elevation / 10, "percent_per_pixel_doubling": -np.log2(pixel)}
    out: Trends = {}
    for when, size in (("before", before), ("after", after)):
        log_scale = -100 * np.log(np.maximum(size, 1e-12)).mean(1)
        out[when] = {}
        for name, x in over.items():
            slope, covariance = _within(x[index, None], log_scale[index], vehicle, np.zeros(1), np.full((1, 1), 1e12))
            out[when][name] = [float(slope[0]), float(np.sqrt(covariance[0, 0]))]
    return out


def _far_and_near(views: Views, vehicle: np.ndarray) -> bool:
    """Whether the views of a vehicle (N,) differ in distance by more than their elevation angles explain."""
    count = np.maximum(np.bincount(vehicle), 1)
    pixel, steep = (
        v - (np.bincount(vehicle, v) / count)[vehicle]
        for v in (np.log(views.unit_per_pixel), np.log(np.sin(views.elevation)))
    )
    explained = steep * (steep @ pixel) / max(float(steep @ steep), 1e-12)
    return float(np.std(pixel - explained)) > FAR_AND_NEAR


def _within(
    x: np.ndarray, y: np.ndarray, vehicle: np.ndarray, prior: np.ndarray, prior_covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (D,) of `y` (N,) over `x` (N, D) within each `vehicle` (N,), held by a prior; and their covariance.

    Boxes of one vehicle err alike (its paint, its shade), so the scores are summed by vehicle before their scatter is
    taken (Liang and Zeger 1986); it never counts for less than the residuals do.
    """
    count = np.maximum(np.bincount(vehicle), 1)

    def centred(values: np.ndarray) -> np.ndarray:
        return values - (np.bincount(vehicle, values) / count)[vehicle]

    x = np.stack([centred(column) for column in x.T], 1)
    y = centred(y)
    freedom = max(1 - len(np.unique(vehicle)) / len(y), 0.1)  # each vehicle's mean costs one observation
    held = np.linalg.inv(prior_covariance)
    weight, slope, design = np.ones(len(y)), prior, 1.0
    for _ in range(20):
        residual = y - x @ slope
        variance = max(ROBUST_SD * float(np.median(np.abs(residual))) / np.sqrt(freedom), 1e-12) ** 2
        weight = 1 / np.maximum(1, np.abs(residual) / (HUBER * np.sqrt(variance)))
        pulled = x * weight[:, None]
        alone = pulled.T @ x / variance
        score = np.stack([np.bincount(vehicle, column) for column in (pulled * residual[:, None]).T]) / variance
        design = max(1.0, float(np.trace(np.linalg.pinv(alone) @ score @ score.T)) / x.shape[1])
        slope = np.linalg.solve(alone / design + held, pulled.T @ y / variance / design + held @ prior)
    return slope, np.linalg.inv(alone / design + held)
