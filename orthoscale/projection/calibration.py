"""A reconstruction finds its own ruler: what its boxes take in of a vehicle's height, and by how much they exceed it.

The same vehicle must have one size from all its views. A box that takes in height makes it larger in flat views, one
with a margin makes it larger from afar, and one that ends above the ground grows in the flattest views only. So all
three follow from how sizes change from view to view, without any metres (but for the hull's shape, which is in metres).
Sizes are measured with the exact projection at the ruler so far, and how they would change with another one by
measuring again: nothing is linear but the step, and steps are repeated.
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
STEPS = 10
HEIGHT, MARGIN, UNDERCUT = 0, 1, 2  # columns of `OwnRuler.value`
STEP = (0.05, 0.25, 0.05)  # of the differences that give the slopes [m], [detector px], [m]
SETTLED = 0.01  # change of height [m], margin [px] and undercut [m] at which the steps end
FLAT = 0.01  # [m] height of an outline without a body
HIGHEST = 1.6  # of the effective height [m]: the roof of a car
# A card knows no undercut: its effective height is that of a body with upright sides, which grows as much in a view of
# USUAL_LEAN (cotangent of the elevation, along the side in question). UNDERCUT_SD is the prior's one sigma.
UNDERCUT_SD, MOST_UNDERCUT = 0.3, 1.0  # [m]
USUAL_LEAN = 0.7
# How much distances to one vehicle must differ, one sigma, beyond what its elevation angles explain, before its views
# tell a margin. At one altitude, distance and elevation are one thing, and a margin would take up whatever else makes
# boxes change with elevation.
FAR_AND_NEAR = 0.05
HUBER = 1.5  # residuals beyond so many sigmas count less (Huber 1964)


@dataclass(frozen=True)
class OwnRuler:
    """For lengths and widths apart: height [m], margin [detector px], and undercut [m].

    A vehicle is widest above the ground; below, it recedes into its own shade. Seen from steeply above, its outline is
    that of the waist on all sides, and it looks no larger than it is. Seen more flatly, the near side shows what lies
    under the waist, `undercut` further in, and only then does height make a box larger. A straight line through the
    flat views alone, as a body with upright sides gives it, takes too much off all: on `sheffield` 11 % of the widths.

    value : (2, 3) by axis, in this order. covariance : (2, 3, 3) of these, by axis.
    views : how many boxes told something about them, 0 where they are the detector's.
    """

    value: np.ndarray
    covariance: np.ndarray
    views: int = 0

    @classmethod
    def shipped(
        cls, height: Sequence[float], margin: Sequence[float], height_sd: Sequence[float], margin_sd: Sequence[float]
    ) -> OwnRuler:
        """What the detector's card says, (2,) each, by lengths and by widths; it knows no undercut."""
        covariance = [np.diag([float(h) ** 2, float(m) ** 2, 0.0]) for h, m in zip(height_sd, margin_sd, strict=True)]
        value = np.stack([np.asarray(height, float), np.asarray(margin, float), np.zeros(2)], 1)
        return cls(value, np.array(covariance))

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
        """(2, 3) one-sigmas, as `value`."""
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
        hulls = [Hull(height=float(height)) for height in self.height]
        upright = np.stack([ground_size(tight, views, metres_per_unit, hull)[:, k] for k, hull in enumerate(hulls)], 1)
        above = -(views.ground * views.normal).sum(1, keepdims=True)  # (N, 1) the camera over the ground
        nearer = 1 - self.height / metres_per_unit / above  # a waist at that height is so much closer than the ground
        waist = ground_size(tight, views, metres_per_unit, Hull(height=FLAT)) * nearer
        size = np.minimum(upright + self.undercut / metres_per_unit, np.maximum(waist, upright))
        size[swapped] = np.nan
        return size

    def slopes(self, boxes: Boxes, views: Views, zoom: float, metres_per_unit: float) -> np.ndarray:
        """(N, 2 axes, 3) how much smaller the size is for one more of each part of the ruler [units]."""
        out = np.empty((len(boxes), 2, len(STEP)))
        for k, step in enumerate(STEP):
            change = np.zeros((2, len(STEP)))
            change[:, k] = step
            more, less = (OwnRuler(self.value + sign * change, self.covariance) for sign in (1, -1))
            apart = less.size(boxes, views, zoom, metres_per_unit) - more.size(boxes, views, zoom, metres_per_unit)
            out[:, :, k] = apart / (2 * step)
        return out

    def relative_sd(self, size: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """(2 axes, 3) one-sigmas of all sizes, relative, from what is not known of each part of the ruler.

        They are found together and may err against each other: their squares add up to what all leave together.
        """
        share = np.nanmedian(slopes / size[..., None], axis=0)  # (2 axes, 3)
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
                for k, name in enumerate(("effective_height", "margin_px", "undercut"))
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
    free = [HEIGHT, UNDERCUT] + ([MARGIN] if _far_and_near(seen, vehicle) else [])
    prior = _with_undercut(shipped.covariance)
    ruler = start or shipped
    if not ruler.undercut.all():  # from none, boxes would not feel a little more or less of it
        value = ruler.value.copy()
        value[:, UNDERCUT] += UNDERCUT_SD
        value[:, HEIGHT] += UNDERCUT_SD / USUAL_LEAN
        ruler = OwnRuler(value, shipped.covariance)
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
                x, y, vehicle[good], shipped.value[axis, free], prior[axis][chosen]
            )
        value[:, HEIGHT] = np.clip(value[:, HEIGHT], 0.0, HIGHEST)
        value[:, UNDERCUT] = np.clip(value[:, UNDERCUT], 0.0, MOST_UNDERCUT)
        change = np.abs(value - ruler.value).max()
        # Half the way: which views feel the undercut depends on it, and whole steps would go to and fro.
        ruler = OwnRuler((ruler.value + value) / 2, covariance, int(good.sum()))
        if change < SETTLED:
            break
    return ruler


def _with_undercut(covariance: np.ndarray) -> np.ndarray:
    """`covariance` (2, 3, 3) of a card, with an undercut that leaves what boxes grow by in views of USUAL_LEAN."""
    direction = np.zeros((2, 3))
    direction[:, UNDERCUT] = UNDERCUT_SD
    direction[:, HEIGHT] = UNDERCUT_SD / USUAL_LEAN
    return covariance + direction[:, :, None] * direction[:, None]


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
