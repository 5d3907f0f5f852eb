"""Whether one scale holds for the whole model: by frame, by region, and as a trend over the ground.

Frames are compared by the vehicles that they share: all frames must give a vehicle the same size, whatever that is.
Regions are compared by the fleet: they hold different vehicles, so a region says less than its count suggests.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..normal import of_median, robust_sd
from ..scale import Scale
from ..votes import LEAST_NOISE, Votes, weighted_median
from .drift import Trend
from .surface import LOT_SIZE, LOTS_SD, Cells, SurfaceFit, bowl, plane

MIN_SHARED = 3  # vehicles that a frame must share with others before it is judged
ODD_SIGMAS, ODD_STRAY = 4.0, 0.05  # a frame is odd if it strays by more than both: sigmas, and a share of the scale
CELLS = 3  # regions across the longer side of the model
MIN_IN_REGION = 5
MIN_FOR_TREND, MIN_FOR_BOWL = 12, 24


@dataclass(frozen=True)
class FrameScale:
    """scale : metres per unit by one frame. sd : one sigma of that. vehicles : number that it shares with others."""

    scale: float
    sd: float
    vehicles: int


@dataclass(frozen=True)
class Region:
    """centre : (2,) mean position of its vehicles on the plan [units]. scale : metres per unit by them. sd : one sigma
    of that, which includes the variation between lots."""

    centre: tuple[float, ...]
    scale: float
    sd: float
    vehicles: int


@dataclass(frozen=True)
class ModelDrift:
    """How the scale changes within a model.

    frames : by name, those that share vehicles with others. odd : names of those that disagree, worst first, each with
    its relative deviation. regions : those of the plan with enough vehicles. trend : over the plan, None for too few
    vehicles.
    """

    frames: Mapping[str, FrameScale]
    odd: Sequence[tuple[str, float]]
    regions: Sequence[Region]
    trend: Trend | None

    @property
    def drifts(self) -> bool:
        """Whether the trend is significant, and large enough to matter."""
        return self.trend is not None and self.trend.drifts

    @property
    def amplitude(self) -> float:
        """Relative difference of the scale between its extremes; 0 without a significant drift."""
        return 0.0 if self.trend is None else self.trend.amplitude

    @property
    def warnings(self) -> list[str]:
        """What speaks against a single scale, in words."""
        remarks = []
        if self.odd:
            worst = ", ".join(f"{name} by {100 * stray:+.0f} %" for name, stray in self.odd[:5])
            who = "a frame disagrees" if len(self.odd) == 1 else f"{len(self.odd)} frames disagree"
            remarks.append(f"{who} with the others about the same vehicles: {worst}")
        if self.trend is not None and self.trend.tilts:
            remarks.append(
                f"the scale changes by {100 * self.trend.tilt:.0f} % across the model: it may be bent, or its "
                "vehicles differ from place to place"
            )
        if self.trend is not None and self.trend.bends:
            remarks.append(
                f"the scale changes by {100 * self.trend.bend:.0f} % from the model's middle to its ends, as in a "
                "bowl: it may be bent, or its vehicles differ from place to place"
            )
        return remarks


def model_drift(
    size: np.ndarray, weights: np.ndarray, picture: np.ndarray, votes: Votes, scale: Scale, plan: np.ndarray
) -> ModelDrift:
    """The scale by frame and by region, and its trend.

    size : (M, 2) of each box [units]. weights : (M, 2) of these (`view_weights`). picture : (M,) name of its frame.
    votes : of N vehicles. Margins are taken off both sizes. plan : (N, 2) positions of the votes on the ground's plane
    [units].
    """
    frames, odd = by_frame(np.log(np.maximum(size, 1e-12)), weights, picture, votes, scale)
    used = scale.used
    log_scale = -np.log(votes.size[used]) @ np.asarray(scale.weights)
    relative, there = log_scale - np.median(log_scale), plan[used]
    regions, trend = by_region(relative, there, scale.value), trend_of(relative, there, scale.value)
    return ModelDrift(frames, odd, regions, trend)


def by_frame(
    log_size: np.ndarray, weights: np.ndarray, picture: np.ndarray, votes: Votes, scale: Scale
) -> tuple[dict[str, FrameScale], list[tuple[str, float]]]:
    """Metres per unit by each frame that shares vehicles with others; and the odd frames, worst first, each with its
    relative deviation.

    log_size, weights : (M, 2) of each box, as in `model_drift`. A box's deviation is the log ratio of the median size
    in the same vehicle's other views to its own size, the weighted mean over length and width. How uncertain it is
    beside others follows from the weights, for flat views err more than steep ones; how uncertain they all are, from
    how they scatter. A frame whose boxes contradict each other, as of half-hidden vehicles, says less (Birge 1932).
    """
    each = np.full(log_size.shape, np.nan)
    for members, counts in zip(votes.members, scale.used, strict=True):
        if counts and len(members) >= 3:
            for m in members:
                each[m] = np.median(log_size[members[members != m]], axis=0) - log_size[m]
    stray, own = np.average(each, axis=1, weights=weights), 1 / np.sqrt(weights.sum(1))
    known = np.isfinite(stray)
    if not known.any():
        return {}, []
    sure = 1 / np.maximum(own * robust_sd((stray / own)[known]), LEAST_NOISE) ** 2
    frames, odd = {}, []
    for name in np.unique(picture[known]):
        mine = known & (picture == name)
        if (count := int(mine.sum())) < MIN_SHARED:
            continue
        middle = float(weighted_median(stray[mine, None], 0, sure[mine, None])[0])
        birge = np.sqrt(sure[mine] @ (stray[mine] - middle) ** 2 / (count - 1))
        sd = float(np.sqrt(of_median(count) / sure[mine].mean()) * max(birge, 1.0))
        frames[str(name)] = FrameScale(float(scale.value * np.exp(middle)), float(scale.value * sd), count)
        if abs(middle) > max(ODD_STRAY, ODD_SIGMAS * sd):
            odd.append((str(name), float(np.expm1(middle))))
    return frames, sorted(odd, key=lambda item: -abs(item[1]))


def by_region(log_scale: np.ndarray, plan: np.ndarray, value: float) -> list[Region]:
    """Regions with their own scale. log_scale : (K,) of each vehicle, relative to the scale `value`. plan : (K, 2)
    their positions [units]."""
    low, extent = plan.min(0), np.maximum(np.ptp(plan, axis=0), 1e-12)
    cell = np.minimum(((plan - low) / (extent.max() / CELLS)).astype(int), CELLS - 1)
    regions = []
    for key in np.unique(cell, axis=0):
        here = (cell == key).all(1)
        mine = log_scale[here]
        if len(mine) >= MIN_IN_REGION:
            sd = np.hypot(mine.std(ddof=1) / np.sqrt(len(mine)), LOTS_SD)
            regions.append(
                Region(
                    tuple(plan[here].mean(0).tolist()), value * float(np.exp(mine.mean())), value * float(sd), len(mine)
                )
            )
    return regions


def trend_of(
    log_scale: np.ndarray, plan: np.ndarray, metres_per_unit: float = 1.0, lots_sd: float = LOTS_SD
) -> Trend | None:
    """A plane, and what a quadric adds to it, fitted to the relative `log_scale` (K,) of vehicles on the `plan` (K, 2)
    [units]; None for too few vehicles.

    The p-values are those of F-tests against no trend, and against the plane alone. Lots of vehicles are taken to vary
    by `lots_sd`, one sigma (`surface`). Tilt and bend are the change between the extremes over the vehicles.
    """
    if len(plan) < MIN_FOR_TREND:
        return None
    low, extent = plan.min(0), np.maximum(np.ptp(plan, axis=0), 1e-12)
    cells = Cells.of(plan, log_scale, low, extent)
    covariance = cells.covariance(LOT_SIZE / metres_per_unit, lots_sd)
    middle = plan.mean(0)

    def fitted(terms: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> tuple[SurfaceFit, np.ndarray]:
        fit = SurfaceFit.of(terms(cells.place - middle, extent), cells.mean, covariance)
        return fit, terms(plan - middle, extent) @ fit.coefficients

    flat = SurfaceFit.of(np.ones((len(cells.mean), 1)), cells.mean, covariance)
    tilted, across = fitted(plane)
    trend = Trend(float(np.ptp(across)), tilted.p_against(flat))
    if len(plan) < MIN_FOR_BOWL:
        return trend
    bent, curved = fitted(bowl)
    return replace(trend, bend=float(np.ptp(curved - across)), p_bend=bent.p_against(tilted))
