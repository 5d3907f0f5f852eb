"""How soft pictures are, by how unsure the measurer is of the edges in them.

An edge that may be the bonnet's or the bumper's is told between the two with a larger sigma, and moved out for that
(`MeasurerCard.outward`). In pictures that are out of focus, shaken, compressed or enlarged by repeating pixels every
edge is unsure, and lies no farther inside for that: there an edge is as sure as can be that is no less so than most.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from ..core.ruler import Ruler

# By which power of the median edge's a sure edge's sigma grows: of sharp pictures the median is below that of a sure
# edge, so softness has raised it by more than shows. The same vehicles as they are and in 65 soft copies, nine places
# of 16 to 47 px, blurred by 1 to 3 px, with noise, sharpened again, shaken, in JPEG of quality 15 or 30, or enlarged
# by repeating pixels (2026-11-27): mean lengths and widths there are larger by 4.0 and 7.6 %, with a power of 1 by 2.0
# and 2.5, with this one by 1.1 and 1.0. With a place left out the others choose 1.5 to 2.
GROWS = 1.5
# What is not known of the margin where pictures show less than their pixels could: one sigma of length and width in
# pixels of those looked at, times the share of the pixels that are too many, or the part of a sure edge's sigma that
# is softness. Blurred by 1.4 and 2 px, vehicles of four places with 10 to 14 such pixels (`gorinchem`, `tartu_b`,
# `us_freeway_a`, `us_grey_lots`; 2026-11-24) come out 0.3 to 1.1 px longer and 0.2 to 0.5 px wider, their scales 3 to
# 9 % smaller; where nothing but pixels was added, they do not. Of the soft copies above what is left in sizes is 0.65
# and 0.3 px (0.55 to 0.69 and 0.24 to 0.33 with a place left out); but small vehicles are missed there, and scales of
# five places blurred by 2 px with noise are 1 to 10 % smaller: of one, most of whose vehicles were missed, by more
# than this explains.
LESS_SURE = (1.5, 1.0)


def softness(unsure: np.ndarray) -> float:
    """How many times as unsure as in a sharp picture a sure edge is, 1 at least.

    unsure : (N, 4) sigmas of the edges of N vehicles over that of a sure edge (`MeasurerCard.sure_sigma`).
    """
    # No more than half of the edges may be at two places. Of 63 places with sharp pictures the median is 0.51 to 0.98.
    return max(1.0, float(np.median(unsure))) ** GROWS if unsure.size else 1.0


def less_sure(ruler: Ruler, enlarged: Fraction, soft: float) -> Ruler:
    """The measurer's ruler for pictures that had been `enlarged` or are `soft`: it is less sure of where edges lie."""
    more = np.array(LESS_SURE) * np.hypot(float(1 - 1 / enlarged), np.sqrt(1 - 1 / soft**2))
    return replace(ruler, margin_sd=tuple(np.hypot(ruler.margin_sd, more).tolist()))
