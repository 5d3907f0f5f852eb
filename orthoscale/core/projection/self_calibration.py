"""Self-calibration of the ruler by a reconstruction: the height that boxes enclose, their margin and the undercut.

A vehicle must have one size in all its views. Boxes that enclose height make it larger in flat views, a margin makes it
larger from afar, and an undercut makes boxes grow in the flattest views only. So all three follow from how sizes change
from view to view, without any metres (except that the hull's shape is in metres). Sizes are measured by the exact
projection with the current ruler, their derivatives by measuring again with a changed one: Gauss-Newton steps, repeated
until they converge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..normal import ROBUST_SD
from .own_ruler import CORNER, HEIGHT, LARGEST, LEAN, LOWEST, MARGIN, UNDERCUT, OwnRuler, SeenBoxes
from .view import Views

Trends = dict[str, dict[str, list[float]]]  # see `trends`
Free = tuple[list[int], list[int]]  # columns of `OwnRuler.value` that are fitted, for lengths and for widths

MIN_VIEWS = 3  # fewest views of a vehicle that is used; their mean is taken off
MIN_RESIDUALS = 20  # fewest observations to which a ruler is fitted
RULER_STEPS = 16
STRIDE = (0.3, 3.0, 0.3, 0.08, 0.08)  # largest step: far from the solution the slopes are those of another body
RULER_SETTLED, SAME_SLOPES = 0.03, 0.1  # shares of STRIDE below which steps end, and slopes are not measured again
# For a card without an undercut: its effective height is that of a body with upright sides, which grows as much in a
# view of USUAL_LEAN (cotangent of the elevation, along the side in question). UNDERCUT_SD is the prior's one sigma.
UNDERCUT_SD, LEAST_UNDERCUT = 0.3, 0.05  # [m]; less is also fitted to upright bodies, from noise
USUAL_LEAN = 0.7
# Shapes other than upright walls, by the columns that lengths and widths determine besides height and margin: a body
# that recedes below its waist; one whose walls lean. Corners show where the ground is foreshortened across the vehicle:
# in lengths.
SHAPES = (([UNDERCUT], [UNDERCUT]), ([LEAN, CORNER], [LEAN]))
# One sigma by which log distances to a vehicle must differ, beyond what its elevation angles explain, for its views to
# determine a margin. At one altitude, distance and elevation are one and the same, and a margin would absorb whatever
# else makes boxes change with elevation.
FAR_AND_NEAR = 0.05
HUBER = 1.5  # residuals beyond so many sigmas count less (Huber 1964)


def self_calibrated(
    boxes: SeenBoxes, members: Sequence[np.ndarray], card: OwnRuler, start: OwnRuler | None = None
) -> OwnRuler:
    """The ruler by which vehicles have one size in all their views, with that of the detector's `card` as the prior.

    members : indices of each vehicle's boxes. start : the current ruler, if it is not the card's.
    """
    index, vehicle = _often_seen(members)
    if len(index) < MIN_RESIDUALS:
        return card
    seen = _RulerData(boxes[index], vehicle, card)
    known = card.expects_undercut  # then the card is its prior, as for the height
    common = [HEIGHT, *([UNDERCUT] if known else []), *([MARGIN] if _far_and_near(seen.boxes.views, vehicle) else [])]
    plain = _settled(start or card, seen, (common, common))
    before = plain.size(seen.boxes)
    best, most, fitted = plain, 0.0, (common, common)
    for shape in SHAPES[1:] if known else SHAPES:
        free = (common + shape[0], common + shape[1])
        shaped = _settled(_undercut(plain) if UNDERCUT in shape[0] else plain, seen, free)
        gain = _gain(before, shaped.size(seen.boxes), vehicle)
        # Another shape only if the views demand it, by the Bayesian information criterion (Schwarz 1978).
        gain -= sum(map(len, shape)) * float(np.log(len(index)))
        told = UNDERCUT not in shape[0] or shaped.undercut.max() > LEAST_UNDERCUT
        if told and gain > most:
            best, most, fitted = shaped, gain, free
    return _with_the_rest(best, seen, fitted)


@dataclass(frozen=True)
class _RulerData:
    """The data to which a ruler is fitted: N boxes of vehicles with enough views, and (N,) the index of each one's
    vehicle. card : the prior."""

    boxes: SeenBoxes
    vehicle: np.ndarray
    card: OwnRuler

    def prior(self, free: Free) -> np.ndarray:
        """(2, 5, 5) prior covariance if the columns `free` are fitted."""
        unknown = UNDERCUT in free[0] and not self.card.expects_undercut
        return _with_undercut(self.card.covariance) if unknown else self.card.covariance


def _undercut(ruler: OwnRuler) -> OwnRuler:
    """`ruler` with an undercut to start from: the search must not start at zero, where the gradient vanishes."""
    value = ruler.value.copy()
    value[:, UNDERCUT] += UNDERCUT_SD
    value[:, HEIGHT] += UNDERCUT_SD / USUAL_LEAN
    return replace(ruler, value=value)


def _settled(ruler: OwnRuler, seen: _RulerData, free: Free) -> OwnRuler:
    """The ruler by which each vehicle of `seen` has one size, starting from `ruler`; values that are not `free` are as
    on the card."""
    card, prior, vehicle = seen.card, seen.prior(free), seen.vehicle
    change, slopes = np.inf, np.empty(0)
    for _ in range(RULER_STEPS):
        size = ruler.size(seen.boxes)
        if change > SAME_SLOPES:
            slopes = ruler.slopes(seen.boxes, {*free[0], *free[1]})
        good = np.isfinite(size).all(1) & np.isfinite(slopes).all((1, 2))
        value, covariance = card.value.copy(), card.covariance.copy()
        for axis in range(2):
            least = ruler.hulls[axis].least_lean[axis]
            for fitted in (free[axis], [k for k in free[axis] if k != LEAN]):
                x = slopes[good, axis][:, fitted]
                y = size[good, axis] + x @ ruler.value[axis, fitted]
                chosen = np.ix_(fitted, fitted)
                covariance[axis] = card.covariance[axis]
                value[axis, fitted], covariance[axis][chosen] = _within(
                    x, y, vehicle[good], card.value[axis, fitted], prior[axis][chosen]
                )
                if value[axis, LEAN] >= least:
                    break
                value[axis, LEAN] = least  # walls do not lean outwards: fit the others alone
        value[1, CORNER] = value[0, CORNER]
        # Half steps with an undercut: its value decides which views it affects, and whole steps would oscillate.
        share = 0.5 if UNDERCUT in free[0] else 1.0
        value = ruler.value + np.clip(share * (value - ruler.value), -np.array(STRIDE), STRIDE)
        value = np.clip(value, LOWEST, LARGEST)
        change = (np.abs(value - ruler.value) / STRIDE).max()
        ruler = replace(card, value=value, covariance=covariance, views=int(good.sum()))
        if change < RULER_SETTLED:
            break
    return ruler


def _with_the_rest(ruler: OwnRuler, seen: _RulerData, free: Free) -> OwnRuler:
    """`ruler` with the joint covariance of all uncertain values, `free` or not.

    A body that leans in is smaller in flat views, and a height fitted to them is lower: the two errors cancel in the
    views to which they were fitted. And the views exclude a lean that would have shown. So the covariance is that of a
    joint fit of all values. By as much as that fit would change them they may be off besides, but by no more than the
    prior one sigma: far off, the slopes are those of another body.
    """
    card, prior, size, slopes = seen.card, seen.prior(free), ruler.size(seen.boxes), ruler.slopes(seen.boxes)
    good = np.isfinite(size).all(1) & np.isfinite(slopes).all((1, 2))
    covariance = np.zeros_like(card.covariance)
    for axis in range(2):
        every = np.flatnonzero(np.diag(prior[axis]) > 0)
        x, value, chosen = slopes[good, axis][:, every], ruler.value[axis, every], np.ix_(every, every)
        told, covariance[axis][chosen] = _within(
            x, size[good, axis] + x @ value, seen.vehicle[good], card.value[axis, every], prior[axis][chosen]
        )
        before = np.sqrt(np.diag(prior[axis])[every])
        off = np.clip(told - value, -before, before)
        covariance[axis][chosen] += np.outer(off, off)
    return replace(ruler, covariance=covariance)


def _with_undercut(covariance: np.ndarray) -> np.ndarray:
    """`covariance` (2, 5, 5) of a card, with an undercut that does not change how boxes grow in views of USUAL_LEAN."""
    direction = np.zeros(covariance.shape[:2])
    direction[:, UNDERCUT] = UNDERCUT_SD
    direction[:, HEIGHT] = UNDERCUT_SD / USUAL_LEAN
    return covariance + direction[:, :, None] * direction[:, None]


def _gain(plain: np.ndarray, shaped: np.ndarray, vehicle: np.ndarray) -> float:
    """By how much `shaped` sizes (N, 2) of each `vehicle` (N,) agree better than `plain` ones: twice the difference of
    their Huber losses, relative to the residual noise of the shaped ones.

    It is the smaller of two gains: with residuals relative to each one's own sizes, and relative to the plain sizes. A
    body that makes vehicles larger reduces the relative noise, one that makes them smaller reduces the noise itself;
    neither is a better agreement.
    """
    good = np.isfinite(plain).all(1) & np.isfinite(shaped).all(1)
    plain, shaped, vehicle = plain[good], shaped[good], vehicle[good]
    typical = np.exp(_mean_of_vehicle(np.log(plain), vehicle))
    gains = []
    for before, after in ((np.log(plain), np.log(shaped)), (plain / typical, shaped / typical)):
        old, new = (np.abs(values - _mean_of_vehicle(values, vehicle)) for values in (before, after))
        noise = np.maximum(ROBUST_SD * np.median(new, axis=0), 1e-9)
        loss = [np.where(r < HUBER, r**2, HUBER * (2 * r - HUBER)).sum() for r in (old / noise, new / noise)]
        gains.append(float(loss[0] - loss[1]))
    return min(gains)


def trends(
    before: np.ndarray, after: np.ndarray, elevation: np.ndarray, pixel: np.ndarray, members: Sequence[np.ndarray]
) -> Trends | None:
    """How the scale by a vehicle changes from view to view, before and after calibration; None for too few views.

    before, after : (N, 2) sizes, NaN where no vehicle fits a box at this scale. elevation : (N,) [deg].
    pixel : (N,) size of a pixel on the ground [units]: it gives a vehicle's length in pixels without its box's error.
    Slopes of the log scale in percent per 10 degrees and per doubling of the length in pixels, each [slope, one sigma].
    """
    known = np.isfinite(before).all(1) & np.isfinite(after).all(1)
    index, vehicle = _often_seen([m[known[m]] for m in members])
    if len(index) < MIN_RESIDUALS:
        return None
    over = {"percent_per_10_degrees": elevation / 10, "percent_per_pixel_doubling": -np.log2(pixel)}
    out: Trends = {}
    for when, size in (("before", before), ("after", after)):
        log_scale = -100 * np.log(np.maximum(size, 1e-12)).mean(1)
        out[when] = {}
        for name, x in over.items():
            slope, covariance = _within(x[index, None], log_scale[index], vehicle, np.zeros(1), np.full((1, 1), 1e12))
            out[when][name] = [float(slope[0]), float(np.sqrt(covariance[0, 0]))]
    return out


def _often_seen(members: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(N,) indices of the boxes of vehicles with MIN_VIEWS or more, and (N,) the number of each one's vehicle."""
    often = [m for m in members if len(m) >= MIN_VIEWS]
    index = np.concatenate([np.empty(0, int), *often])
    return index, np.repeat(np.arange(len(often)), [len(m) for m in often])


def _mean_of_vehicle(values: np.ndarray, vehicle: np.ndarray) -> np.ndarray:
    """`values` (N, D), each replaced by the mean of its `vehicle` (N,)."""
    count = np.maximum(np.bincount(vehicle), 1)
    return np.stack([np.bincount(vehicle, column) / count for column in values.T], 1)[vehicle]


def _far_and_near(views: Views, vehicle: np.ndarray) -> bool:
    """Whether the views of a vehicle (N,) differ in distance by more than their elevation angles explain."""
    values = np.log(np.stack([views.unit_per_pixel, np.sin(views.elevation)], 1))
    pixel, steep = (values - _mean_of_vehicle(values, vehicle)).T
    explained = steep * (steep @ pixel) / max(float(steep @ steep), 1e-12)
    return float(np.std(pixel - explained)) > FAR_AND_NEAR


def _within(
    x: np.ndarray, y: np.ndarray, vehicle: np.ndarray, prior: np.ndarray, prior_covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (D,) of `y` (N,) over `x` (N, D) within each `vehicle` (N,), with a prior; and their covariance.

    The errors of a vehicle's boxes are correlated (its paint, its shade), so the scores are summed by vehicle before
    their scatter is taken (Liang and Zeger 1986); the covariance is never less than by the residuals alone.
    """
    x = x - _mean_of_vehicle(x, vehicle)
    y = y - _mean_of_vehicle(y[:, None], vehicle)[:, 0]
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
