"""Which standards of a kind are possible, by country and by a roughly known size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.anchors import Standard

SIGMAS_SEARCHED = 2.0  # of the scale, within which sizes are searched


def ruled(standards: Sequence[Standard], country: str) -> bool:
    """Whether any of `standards` names `country`, or none names a country, as a user's own."""
    return any(country in standard.countries for standard in standards) or not any(s.countries for s in standards)


def sizes(standards: Sequence[Standard], gsd: float, gsd_sd: float) -> tuple[float, float]:
    """The smallest and the largest size to search for [px]."""
    slack = np.exp(SIGMAS_SEARCHED * gsd_sd)
    metres = [standard.metres for standard in standards]
    return min(metres) / gsd / slack, max(metres) / gsd * slack


def within_reach(standards: Sequence[Standard], pixels: float, gsd: float, gsd_sd: float) -> tuple[Standard, ...]:
    """The standards that something of `pixels` [px] can have, within two sigmas of the scale and the standard."""
    return tuple(
        standard
        for standard in standards
        if abs(np.log(standard.metres / (pixels * gsd))) <= SIGMAS_SEARCHED * np.hypot(gsd_sd, standard.relative_sd)
    )
