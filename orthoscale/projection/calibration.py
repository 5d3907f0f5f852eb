"""A reconstruction finds its own ruler: what its boxes take in of a vehicle's height, and by how much they exceed it.

The same vehicle must have one size from all its views. A box that takes in height makes it larger in flat views, one
with a margin makes it larger from afar; so both follow from how sizes change from view to view, without any metres
(but for the hull's shape, which is in metres). Sizes are measured with the exact projection at the ruler so far, and
how they would change with another one by measuring again: nothing is linear but the step, and steps are repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..boxes import Boxes
from .exact import Hull, ground_size
from .view import Views

MIN_VIEWS = 3  # views of one vehicle from which its own mean is taken off
MIN_RESIDUALS = 20  # observations below which nothing is fitted
STEPS = 6
STEP_HEIGHT, STEP_MARGIN = 0.05, 0.25  # of the differences that give the slopes [m], [detector px]
SETTLED = 0.01  # change of height [m] and margin [px] at which the steps end
HIGHEST = 1.6  # of the effective height [m]: the roof of a car
# How much distances to one vehicle must differ, one sigma, beyond what its elevation angles explain, before its views
# tell a margin. At one altitude, distance and elevation are one thing, and a margin would take up whatever else makes
# boxes change with elevation.
FAR_AND_NEAR = 0.05
HUBER = 1.5  # residuals beyond so many sigmas count less (Huber 1964)


@dataclass(frozen=True)
class OwnRuler:
    """For lengths and widths apart, height [m] and margin [detector px].

    value : (2, 2) by axis: height, margin. covariance : (2, 2, 2) of these, by axis.
    views : how many boxes told something about them, 0 where they are the detector's.
    """

    value: np.ndarray
    covariance: np.ndarray
    views: int = 0

    @classmethod
    def shipped(
        cls, height: Sequence[float], margin: Sequence[float], height_sd: Sequence[float], margin_sd: Sequence[float]
    ) -> OwnRuler:
        """What the detector's card says, (2,) each, by lengths and by widths."""
        covariance = [np.diag([float(h) ** 2, float(m) ** 2]) for h, m in zip(height_sd, margin_sd, strict=True)]
        return cls(np.stack([np.asarray(height, float), np.asarray(margin, float)], 1), np.array(covariance))

    @property
    def height(self) -> np.ndarray:
        """(2,) [m]."""
        return self.value[:, 0]

    @property
    def margin(self) -> np.ndarray:
        """(2,) [detector px]."""
        return self.value[:, 1]

    @property
    def sd(self) -> np.ndarray:
        """(2, 2) one-sigmas, as `value`."""
        return np.sqrt(np.einsum("kii->ki", self.covariance))

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
        sides = [
            ground_size(tight, views, metres_per_unit, Hull(height=float(h)))[:, k] for k, h in enumerate(self.height)
        ]
        size = np.stack(sides, 1)
        size[swapped] = np.nan
        return size

    def slopes(self, boxes: Boxes, views: Views, zoom: float, metres_per_unit: float) -> np.ndarray:
        """(N, 2 axes, 2) how much smaller the size is for one more metre of height, and pixel of margin [units]."""
        out = np.empty((len(boxes), 2, 2))
        for k, step in enumerate((STEP_HEIGHT, STEP_MARGIN)):
            change = np.zeros((2, 2))
            change[:, k] = step
            more, less = (OwnRuler(self.value + sign * change, self.covariance) for sign in (1, -1))
            apart = less.size(boxes, views, zoom, metres_per_unit) - more.size(boxes, views, zoom, metres_per_unit)
            out[:, :, k] = apart / (2 * step)
        return out

    def relative_sd(self, size: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """(2 axes, 2) one-sigmas of all sizes, relative, from what is not known of the height and of the margin.

        The two are found together and may err against each other: their squares add up to what both leave together.
        """
        share = np.nanmedian(slopes / size[..., None], axis=0)  # (2 axes, 2)
        together = np.einsum("ki,kij,kj->k", share, self.covariance, share)
        alone = (share * self.sd) ** 2
        return np.sqrt(alone * (together / np.maximum(alone.sum(1), 1e-30))[:, None])

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
                for k, name in enumerate(("effective_height", "margin_px"))
            },
        }


def own_ruler(
    boxes: Boxes,
    views: Views,
    zoom: float,
    members: Sequence[np.ndarray],
    metres_per_unit: float,
    shipped: OwnRuler,
    start: OwnRuler | None = None,
) -> OwnRuler:
    """The ruler for which vehicles have one size from all their views, held by the one that the detector ships.

    start : the ruler so far, if another than shipped.
    members : indices of each vehicle's boxes. metres_per_unit : the scale so far, for the hull's shape.
    """
    often = [m for m in members if len(m) >= MIN_VIEWS]
    if sum(map(len, often)) < MIN_RESIDUALS:
        return shipped
    index = np.concatenate(often)
    vehicle = np.repeat(np.arange(len(often)), [len(m) for m in often])
    some, seen = boxes[index], views[index]
    free = [0, 1] if _far_and_near(seen, vehicle) else [0]
    ruler = start or shipped
    for _ in range(STEPS):
        size = ruler.size(some, seen, zoom, metres_per_unit)
        slopes = ruler.slopes(some, seen, zoom, metres_per_unit)
        good = np.isfinite(size).all(1) & np.isfinite(slopes).all((1, 2))
        value, covariance = shipped.value.copy(), shipped.covariance.copy()
        for axis in range(2):
            x = slopes[good, axis][:, free]
            y = size[good, axis] + x @ ruler.value[axis, free]
            chosen = np.ix_(free, free)
            value[axis, free], covariance[axis][chosen] = _within(
                x, y, vehicle[good], shipped.value[axis, free], shipped.covariance[axis][chosen]
            )
        value[:, 0] = np.clip(value[:, 0], 0.0, HIGHEST)
        change = np.abs(value - ruler.value).max()
        ruler = OwnRuler(value, covariance, int(good.sum()))
        if change < SETTLED:
            break
    return ruler


def trends(
    before: np.ndarray, after: np.ndarray, elevation: np.ndarray, pixel: np.ndarray, members: Sequence[np.ndarray]
) -> dict[str, Any] | None:
    """How the scale of a vehicle changes from view to view, before and after calibration; None for too few views.

    before, after : (N, 2) sizes. elevation : (N,) [deg]. pixel : (N,) what one covers of the ground [units]: the
    length of a vehicle in pixels, without its box's own error.
    Slopes of the log scale in percent per 10 degrees and per doubling of the length in pixels, each [slope, one sigma].
    """
    often = [m for m in members if len(m) >= MIN_VIEWS]
    if sum(map(len, often)) < MIN_RESIDUALS:
        return None
    index = np.concatenate(often)
    vehicle = np.repeat(np.arange(len(often)), [len(m) for m in often])
    over = {"percent_per_10_degrees": elevation / 10, "percent_per_pixel_doubling": -np.log2(pixel)}
    out: dict[str, Any] = {}
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
        variance = max(1.4826 * float(np.median(np.abs(residual))) / np.sqrt(freedom), 1e-12) ** 2
        weight = 1 / np.maximum(1, np.abs(residual) / (HUBER * np.sqrt(variance)))
        pulled = x * weight[:, None]
        alone = pulled.T @ x / variance
        score = np.stack([np.bincount(vehicle, column) for column in (pulled * residual[:, None]).T]) / variance
        design = max(1.0, float(np.trace(np.linalg.pinv(alone) @ score @ score.T)) / x.shape[1])
        slope = np.linalg.solve(alone / design + held, pulled.T @ y / variance / design + held @ prior)
    return slope, np.linalg.inv(alone / design + held)
