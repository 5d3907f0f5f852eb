"""Whether the pixels of an orthophoto are square, by how the shapes of vehicles depend on their headings.

If pixels are not square, vehicles along x look longer and narrower, or shorter and wider, than those along y. That
needs no scale and no georeferencing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..boxes import Boxes
from ..normal import robust_sd
from ..projection.planar import ground_size

SQUEEZE = "squeeze"  # name of this part of a scale's uncertainty
LEAST_VEHICLES = 20  # vehicles; with fewer, their scatter cannot be estimated
FIT_STEPS = 20  # most iterations of the fit; it settles in about five
SETTLED_SQUEEZE = 1e-5  # log aspect
# Sigmas beyond which a vehicle has no weight: Tukey's biweight, 95 % efficient for normal errors.
ODD_SHAPE_SIGMAS = 4.685
# One sigma of the squeeze that appears in square pixels, from shadows, the detector, and lots of different vehicles
# with different headings: ten orthophotos of known scale with 20 vehicles or more (places and orthophotos, 2026-11-25)
# have -0.074 to 0.081, rms 0.045.
OF_SQUARE = 0.045
# Least standard deviation of cos(2 heading). Where all vehicles stand one way, squeezed pixels make their headings
# depend on their lengths, which looks like a squeeze, or hides one. Those ten orthophotos have 0.34 to 0.95.
LEAST_TURNED = 0.2
SHAPE_RIDGE = 1e-9  # added to the variance of sizes, which is 0 if all boxes are the same


@dataclass(frozen=True)
class Squeeze:
    """log_aspect : log of a pixel's width over its height on the ground, beyond the known aspect. sd : one sigma."""

    log_aspect: float
    sd: float

    @property
    def sigmas(self) -> float:
        """How many sigmas it is from the known aspect."""
        return abs(self.log_aspect) / self.sd


def squeeze(boxes: Boxes, aspect: float = 1.0) -> Squeeze | None:
    """How the pixels under `boxes` (N, of one picture) differ from the `aspect` that they are taken to have; None for
    fewer than LEAST_VEHICLES boxes, or where all stand one way.

    In pixels of log aspect s, a vehicle at an angle h from the x axis looks shorter by s / 2 cos(2 h) and wider by as
    much, in logarithms. So s is the slope of a regression. Lengths and widths are weighted by their scatter about it,
    and outlying vehicles count less (an iterated M-estimate). From the smallest rectangles around vehicles squeezed by
    a factor of up to 1.4, 0.98 of s is found. From the measurer's boxes it is less: 0.7 on four places of 0.06 to
    0.13 m/px, half on three of 0.2 and 0.3 m/px (squeezed by 1.25 and by 0.8; 2026-11-28).
    """
    if len(boxes) < LEAST_VEHICLES:
        return None
    found, weight, way = 0.0, np.ones(len(boxes)), np.cos(2 * boxes.angle)
    for _ in range(FIT_STEPS):
        size = np.log(ground_size(boxes, aspect * np.exp(found)))
        left = size - np.average(size, axis=0, weights=weight)
        scatter = np.cov(left.T, aweights=weight) + SHAPE_RIDGE * np.eye(2)
        mix = np.linalg.solve(scatter, [-0.5, 0.5])
        each = left @ mix / (mix @ [-0.5, 0.5])  # by each vehicle: (what is left of s) * cos(2 heading)
        off = way - np.average(way, weights=weight)
        spread = float(weight @ off**2)
        if spread < LEAST_TURNED**2 * weight.sum():
            return None
        step = float(weight @ (off * each)) / spread
        rest = each - step * off
        sd = max(float(robust_sd(rest)), SHAPE_RIDGE)
        usual = np.clip(1 - (rest / (ODD_SHAPE_SIGMAS * sd)) ** 2, 0, None)
        weight = usual**2
        found += step
        if abs(step) < SETTLED_SQUEEZE:
            break
    # The derivative of the biweight's estimating sum by the slope is less than its weights: (1 - u^2) (1 - 5 u^2) for
    # each vehicle (Huber 1964).
    moved = max(float(usual * (5 * usual - 4) @ off**2), spread / 2)
    own = float(np.sqrt(weight**2 @ (off * rest) ** 2)) / moved
    return Squeeze(found, float(np.hypot(own, OF_SQUARE)))
