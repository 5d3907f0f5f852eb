"""A reconstruction calibrates its own ruler: the same vehicle must have one size from all its views.

A box takes in some of a vehicle's height, which shows the more the flatter the view, and has a margin in pixels, which
covers the more ground the farther the camera. With the vehicle's own size as unknown,

    size = vehicle + height * lean + margin * pixel,

so height and margin follow from how its sizes change from view to view, without any metres. Where the views do not
tell, the detector's card does: its values enter as measurements with their own uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ..detections import Detections

MIN_VIEWS = 3  # views of one vehicle from which its own mean is taken off
MIN_RESIDUALS = 20  # observations below which nothing is fitted
HUBER = 1.5  # residuals beyond so many sigmas count less (Huber 1964)


@dataclass(frozen=True)
class Calibration:
    """What a detector's boxes are, for length and width apart.

    height, height_sd : (2,) up to where they enclose a vehicle, and its one sigma [m].
    margin, margin_sd : (2,) by how much they exceed it, and its one sigma [detector px].
    views : how many boxes told something about it.
    """

    height: np.ndarray
    height_sd: np.ndarray
    margin: np.ndarray
    margin_sd: np.ndarray
    views: int = 0

    @classmethod
    def of_card(cls, found: Detections, height_sd: float) -> Calibration:
        """What the detector ships."""
        ruler = found.ruler
        height = np.array(found.effective_height, float)
        return cls(height, np.full(2, height_sd), np.array(ruler.margin, float), np.array(ruler.margin_sd, float))

    def document(self, card: Calibration) -> dict[str, Any]:
        """As plain values, beside those of the `card`."""
        return {
            "views": self.views,
            "effective_height": {
                "card": card.height.tolist(),
                "fitted": self.height.tolist(),
                "sd": self.height_sd.tolist(),
            },
            "margin_px": {"card": card.margin.tolist(), "fitted": self.margin.tolist(), "sd": self.margin_sd.tolist()},
        }


def calibrate(
    flat: np.ndarray,
    leaning: np.ndarray,
    pixel: np.ndarray,
    members: Sequence[np.ndarray],
    metres_per_unit: float,
    card: Calibration,
    highest: float,
) -> Calibration:
    """The ruler that the views of the same vehicles agree on, held by the `card`.

    flat : (N, 2) sizes on the ground as if vehicles were flat, margin included [units].
    leaning : (N, 2) share of its height that each box shows, from `height.lean`. pixel : (N,) detector pixels [units].
    members : the boxes of each vehicle. highest : upper bound of the effective height [m].
    """
    often = [m for m in members if len(m) >= MIN_VIEWS]
    count = sum(map(len, often))
    if count < MIN_RESIDUALS:
        return card
    height, margin = np.empty((2, 2)), np.empty((2, 2))
    for k in range(2):
        x = np.stack([leaning[:, k], pixel * metres_per_unit], 1)  # [1, m/px]; the answer is in m and px
        prior = np.array([card.height[k], card.margin[k]])
        prior_sd = np.array([card.height_sd[k], card.margin_sd[k]])
        value, sd = _within(x, flat[:, k] * metres_per_unit, often, prior, prior_sd)
        height[k], margin[k] = (value[0], sd[0]), (value[1], sd[1])
    return Calibration(np.clip(height[:, 0], 0, highest), height[:, 1], margin[:, 0], margin[:, 1], count)


def _within(
    x: np.ndarray, y: np.ndarray, members: Sequence[np.ndarray], prior: np.ndarray, prior_sd: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (D,) of `y` (N,) over `x` (N, D) within each vehicle, with independent priors, and their sds (D,).

    Boxes of one vehicle err alike (its paint, its shade), so they tell less than as many of different vehicles: by the
    design effect of clustered data (Liang and Zeger 1986).
    """
    vehicle = np.repeat(np.arange(len(members)), [len(m) for m in members])
    x = np.concatenate([x[m] - x[m].mean(0) for m in members])
    y = np.concatenate([y[m] - y[m].mean() for m in members])
    freedom = max(1 - len(members) / len(y), 0.1)  # each vehicle's mean costs one observation
    weight = np.ones(len(y))
    precision = np.diag(1 / prior_sd**2)
    variance = max(1.4826 * np.median(np.abs(y)) / np.sqrt(freedom), 1e-9) ** 2
    design = 1.0
    for _ in range(20):
        pulled = x * weight[:, None]
        told = pulled.T @ x / variance / design
        slope = np.linalg.solve(told + precision, pulled.T @ y / variance / design + precision @ prior)
        residual = y - x @ slope
        variance = max(1.4826 * float(np.median(np.abs(residual))) / np.sqrt(freedom), 1e-9) ** 2
        weight = 1 / np.maximum(1, np.abs(residual) / (HUBER * np.sqrt(variance)))
        score = np.stack([np.bincount(vehicle, column) for column in (x * (weight * residual)[:, None]).T])
        alone = (x * weight[:, None]).T @ x * variance
        design = max(1.0, float(np.trace(np.linalg.pinv(alone) @ score @ score.T)) / x.shape[1])
    return slope, np.sqrt(np.diag(np.linalg.inv(told + precision)))


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
    over = {"percent_per_10_degrees": elevation / 10, "percent_per_pixel_doubling": -np.log2(pixel)}
    out: dict[str, Any] = {}
    for when, size in (("before", before), ("after", after)):
        log_scale = -100 * np.log(np.maximum(size, 1e-12)).mean(1)
        out[when] = {}
        for name, x in over.items():
            slope, sd = _within(x[:, None], log_scale, often, np.zeros(1), np.full(1, 1e6))
            out[when][name] = [float(slope[0]), float(sd[0])]
    return out
