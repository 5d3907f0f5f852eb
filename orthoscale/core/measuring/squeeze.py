"""Whether the pixels of an orthophoto are square, by the shapes of vehicles against their headings.

In squeezed pixels vehicles along x look longer and narrower, or shorter and wider, than those along y. That needs no
scale and no georeferencing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..boxes import Boxes
from ..pooling.posterior import ROBUST_SD
from ..projection.planar import ground_size

SQUEEZE = "squeeze"  # part of a scale's uncertainty
LEAST_VEHICLES = 20  # vehicles; their scatter is not known from fewer
FIT_STEPS = 20  # of the fit; it settles in about five
SETTLED_SQUEEZE = 1e-5  # log aspect
# Sigmas from which a vehicle counts no more: Tukey's biweight, 95 % efficient on normal errors.
ODD_SHAPE_SIGMAS = 4.685
# One sigma of what shadows, the detector, and lots of other vehicles that stand another way make of it: ten orthophotos
# of known scale with 20 vehicles or more (places and orthophotos, 2026-11-25) have -0.074 to 0.081, rms 0.045.
OF_SQUARE = 0.045
# Least standard deviation of cos(2 heading). In squeezed pixels the headings of vehicles that all stand one way depend
# on how long they are, which looks like a squeeze, or hides one. Those ten orthophotos have 0.34 to 0.95.
LEAST_TURNED = 0.2
SHAPE_RIDGE = 1e-9  # of the sizes' variance, which is 0 among boxes that are all alike


@dataclass(frozen=True)
class Squeeze:
    """log_aspect : of how many times as wide as high pixels are on the ground, beyond what is known. sd : one sigma."""

    log_aspect: float
    sd: float

    @property
    def sigmas(self) -> float:
        """How many sigmas it lies from square pixels."""
        return abs(self.log_aspect) / self.sd


def squeeze(boxes: Boxes, aspect: float = 1.0) -> Squeeze | None:
    """By what the pixels under `boxes` (N, of one picture) differ from the `aspect` they are taken to have; None for
    fewer than LEAST_VEHICLES boxes, or where all stand one way.

    In pixels of log aspect s, a vehicle whose box lies h from the x axis looks shorter by s / 2 cos(2 h) and wider by
    as much, in logarithms. So s is a slope, in which lengths and widths are weighted as their scatter about it tells,
    and odd vehicles count less (an iterated M-estimate). Smallest rectangles around what was squeezed by up to 1.4
    tell 0.98 of s.
    """
    if len(boxes) < LEAST_VEHICLES:
        return None
    found, weight, way = 0.0, np.ones(len(boxes)), np.cos(2 * boxes.angle)
    for _ in range(FIT_STEPS):
        size = np.log(ground_size(boxes, aspect * np.exp(found)))
        left = size - np.average(size, axis=0, weights=weight)
        scatter = np.cov(left.T, aweights=weight) + SHAPE_RIDGE * np.eye(2)
        mix = np.linalg.solve(scatter, [-0.5, 0.5])
        each = left @ mix / (mix @ [-0.5, 0.5])  # of a vehicle along x, minus its part of s
        off = way - np.average(way, weights=weight)
        spread = float(weight @ off**2)
        if spread < LEAST_TURNED**2 * weight.sum():
            return None
        step = float(weight @ (off * each)) / spread
        rest = each - step * off
        sd = max(ROBUST_SD * float(np.median(np.abs(rest - np.median(rest)))), SHAPE_RIDGE)
        usual = np.clip(1 - (rest / (ODD_SHAPE_SIGMAS * sd)) ** 2, 0, None)
        weight = usual**2
        found += step
        if abs(step) < SETTLED_SQUEEZE:
            break
    # With the slope a biweight's sum moves by less than its weights, (1 - u^2) (1 - 5 u^2) each (Huber 1964).
    moved = max(float(usual * (5 * usual - 4) @ off**2), spread / 2)
    own = float(np.sqrt(weight**2 @ (off * rest) ** 2)) / moved
    return Squeeze(found, float(np.hypot(own, OF_SQUARE)))
