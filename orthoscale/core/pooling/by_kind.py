"""What a place's vehicles are called tells its country: a fifth of America's are pickups, in China hardly any.

It needs no size, so it holds where shapes mislead, because boxes are too wide or too long together. What stands at one
place and what the measurer calls it there both stray, so a thousand vehicles tell little more than a hundred.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import gammaln

from ..fleet import Fleet
from ..market_segments import PlaceKind
from .beside_fleet import LARGER, LORRIES, LORRIES_SHARE, OUTLIER_CALLED, OUTLIER_SHARE, left_out
from .observed import Confusion

ANY_PLACE = 0.1  # of the places tell nothing of their country: a depot of vans, a dealer's yard; judged


def country_likelihoods(
    called: np.ndarray, fleets: Sequence[Fleet], prior: np.ndarray, confusion: Confusion
) -> np.ndarray:
    """(F,) how likely it is, in each of `fleets`, that vehicles are called so; 1 on average over the `prior` (F,).

    called : (N, 4) shares of `boxes.KINDS` that each is called, zeros where nobody looked. Of a fleet without classes
    it is not known what stands there, so nothing tells against it, nor for it: 1.
    """
    counts = called.sum(0)
    known = np.array([len(fleet.classes) > 1 for fleet in fleets])
    if not known.any():
        return np.ones(len(fleets))
    log = np.array([_of_fleet(counts, fleet, confusion) for fleet, has in zip(fleets, known, strict=True) if has])
    relative = np.exp(log - log.max())
    out = np.ones(len(fleets))
    out[known] = ANY_PLACE + (1 - ANY_PLACE) * relative * prior[known].sum() / (relative @ prior[known])
    return out


def _of_fleet(counts: np.ndarray, fleet: Fleet, confusion: Confusion) -> float:
    """Log probability that so many (4,) are called each of `boxes.KINDS`, but for what is alike for all fleets."""
    each = [np.log(place.probability) + _at(counts, fleet, place, confusion) for place in fleet.place_vehicles]
    return float(np.logaddexp.reduce(each))


def _at(counts: np.ndarray, fleet: Fleet, place: PlaceKind, confusion: Confusion) -> float:
    """The same at one kind of places: of a Dirichlet-multinomial distribution that has the mean and the variance of the
    shares there. They stray for the place's mix of vehicles, and for what the measurer calls those of a kind there."""
    classes = fleet.told_apart_by_kind
    own = np.array([c.weight for c in classes]) / sum(c.weight for c in classes)
    larger = left_out(classes)
    vehicles = 1 - OUTLIER_SHARE
    shares = vehicles * np.array(
        [*(1 - LORRIES_SHARE) * (1 - larger) * place.shares(own), (1 - LORRIES_SHARE) * larger, LORRIES_SHARE]
    )
    kinds = np.array([c.kinds for c in (*classes, LARGER, LORRIES)])
    names = kinds @ confusion.shares  # (K + 2, 4) what those of each class are called
    mean = shares @ names + OUTLIER_SHARE * OUTLIER_CALLED
    of_mix = (vehicles * (shares @ names**2) - (shares @ names) ** 2) / (place.vehicles + 1)
    of_names = (shares @ kinds) ** 2 @ (confusion.shares * (1 - confusion.shares)) / (confusion.vehicles + 1)
    strayed = (of_mix + of_names).sum() / (mean * (1 - mean)).sum()
    before = mean * (1 / strayed - 1)
    after = before + counts
    return float(gammaln(before.sum()) - gammaln(after.sum()) + (gammaln(after) - gammaln(before)).sum())
