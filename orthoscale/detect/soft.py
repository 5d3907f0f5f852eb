"""How soft pictures are, judged by how unsure the measurer is of the edges in them.

If an edge may be either the bonnet's or the bumper's, the measurer places it between the two with a larger sigma, and
it is moved out (`MeasurerCard.outward`). In pictures that are out of focus, shaken, compressed or enlarged by repeating
pixels every edge is unsure, but does not lie farther inside for that. So there the sigma of most edges is taken for
that of sure ones.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from ..core.ruler import Ruler

# A sure edge's sigma grows as this power of the median edge's sigma. In sharp pictures the median is below the sigma of
# a sure edge, so softness has raised it by more than their ratio shows. Measured on the same vehicles as they are and
# in 65 soft copies (2026-11-27): nine places with vehicles of 16 to 47 px, blurred by 1 to 3 px, with noise, sharpened
# again, shaken, in JPEG of quality 15 or 30, or enlarged by repeating pixels. In the copies mean lengths and widths are
# larger by 4.0 and 7.6 %; with a power of 1 by 2.0 and 2.5 %, with this one by 1.1 and 1.0 %. With any one place left
# out, the others choose 1.5 to 2.
GROWS = 1.5
# Uncertainty of the margin where pictures show less detail than their pixels could: one sigma of length and width, in
# the pixels that were looked at. It is multiplied by the share of superfluous pixels, or by the part of a sure edge's
# sigma that is due to softness. When vehicles of four places with 10 to 14 such pixels (`gorinchem`, `tartu_b`,
# `us_freeway_a`, `us_grey_lots`; 2026-11-24) are blurred by 1.4 and 2 px, they come out 0.3 to 1.1 px longer and 0.2 to
# 0.5 px wider, and scales 3 to 9 % smaller; if pixels are only added, they do not. In the soft copies above the
# remaining error of sizes is 0.65 and 0.3 px (0.55 to 0.69 and 0.24 to 0.33 with a place left out). But small vehicles
# are missed there: scales of five places blurred by 2 px with noise are 1 to 10 % smaller, and that of one, most of
# whose vehicles were missed, by more than this explains.
LESS_SURE = (1.5, 1.0)


def softness(unsure: np.ndarray) -> float:
    """Factor by which the sigma of a sure edge exceeds that in a sharp picture, at least 1.

    unsure : (N, 4) sigmas of the edges of N vehicles divided by that of a sure edge (`MeasurerCard.sure_sigma`).
    """
    # The median holds if at most half of the edges are ambiguous. In sharp pictures of 63 places it is 0.51 to 0.98.
    return max(1.0, float(np.median(unsure))) ** GROWS if unsure.size else 1.0


def less_sure(ruler: Ruler, enlarged: Fraction, soft: float) -> Ruler:
    """The measurer's ruler with a more uncertain margin, for pictures that had been `enlarged` by a factor or are
    `soft` (`softness`)."""
    more = np.array(LESS_SURE) * np.hypot(float(1 - 1 / enlarged), np.sqrt(1 - 1 / soft**2))
    return replace(ruler, margin_sd=tuple(np.hypot(ruler.margin_sd, more).tolist()))
