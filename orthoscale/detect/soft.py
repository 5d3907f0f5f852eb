"""How soft pictures are, by how unsure the measurer is of the edges in them.

An edge that may be the bonnet's or the bumper's is told between the two with a larger sigma, and moved out for that
(`MeasurerCard.outward`). In pictures that are out of focus, shaken, compressed or enlarged by repeating pixels every
edge is unsure, and lies no farther inside for that: there an edge is as sure as can be that is no less so than most.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..core.ruler import Ruler

# What is not known of the margin in soft pictures: one sigma of length and width [px of those looked at], times the
# part of a sure edge's sigma that is softness. By so much the same vehicles differ on average between places as they
# are and 52 soft copies of them: nine places of 16 to 47 px, blurred by 1 to 3 px, with noise, sharpened again, shaken,
# in JPEG of quality 15 or 30, or enlarged by repeating pixels (2026-11-27). With a place left out it is 0.86 to 0.98
# and 0.34 to 0.48.
SOFT_SD = (0.95, 0.45)


def softness(unsure: np.ndarray) -> float:
    """How many times as unsure as a sharp picture's a picture's sure edges are, 1 at least.

    unsure : (N, 4) sigmas of the edges of N vehicles over that of a sure edge (`MeasurerCard.sure_sigma`).
    """
    # No more than half of the edges may be at two places. Of 63 places with sharp pictures the median is 0.51 to 0.98.
    return max(1.0, float(np.median(unsure))) if unsure.size else 1.0


def of_soft(ruler: Ruler, soft: float) -> Ruler:
    """The measurer's ruler for pictures so `soft`: it is less sure of where edges lie."""
    more = np.array(SOFT_SD) * np.sqrt(1 - 1 / soft**2)
    return replace(ruler, margin_sd=tuple(np.hypot(ruler.margin_sd, more).tolist()))
