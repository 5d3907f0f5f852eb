"""Which standards of a kind are possible, by country and by a roughly known size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.anchors import Standard

SIGMAS_SEARCHED = 2.0  # of the scale, within which sizes are searched


def ruled(standards: Sequence[Standard], country: str) -> bool:
    """Whether any of `standards` names `country`, or none names a country, as a user's own."""
    return any(country in standard.countries for standard in standards) or not any(s.countries for s in standards)


def shares_by_country(standards: Sequence[Standard]) -> dict[str, dict[Standard, float]]:
    """The share of each standard among those of a country, by their priors, for every country that `standards` name."""
    named = dict.fromkeys(country for standard in standards for country in standard.countries)
    own = {country: [each for each in standards if country in each.countries] for country in named}
    return {
        country: {one: one.prior / sum(each.prior for each in of_it) for one in of_it} for country, of_it in own.items()
    }


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
