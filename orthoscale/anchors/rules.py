"""Which standards of a kind are possible: by country, and by a size that is roughly known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.anchors import Standard

SIGMAS_SEARCHED = 2.0  # sigmas of the scale within which sizes are searched


def ruled(standards: Sequence[Standard], country: str) -> bool:
    """Whether any of `standards` names `country`, or is the user's own."""
    return any(country in standard.countries for standard in standards) or not any(s.countries for s in standards)


def sizes(standards: Sequence[Standard], gsd: float, gsd_sd: float) -> tuple[float, float]:
    """The smallest and the largest that is searched [px]."""
    slack = np.exp(SIGMAS_SEARCHED * gsd_sd)
    metres = [standard.metres for standard in standards]
    return min(metres) / gsd / slack, max(metres) / gsd * slack


def within_reach(standards: Sequence[Standard], pixels: float, gsd: float, gsd_sd: float) -> tuple[Standard, ...]:
    """Those that something of `pixels` can be, within two sigma of the scale and of the standard."""
    return tuple(
        standard
        for standard in standards
        if abs(np.log(standard.metres / (pixels * gsd))) <= SIGMAS_SEARCHED * np.hypot(gsd_sd, standard.relative_sd)
    )
