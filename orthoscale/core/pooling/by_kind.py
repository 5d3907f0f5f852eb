"""The kinds of a place's vehicles tell its country: a fifth of America's are pickups, in China hardly any.

This needs no sizes, so it holds where shapes mislead because all boxes are too wide or too long. The mix at a place and
the kinds that the measurer calls its vehicles both vary from place to place, so a thousand vehicles tell little more
than a hundred.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import gammaln

from ..fleet import Fleet
from ..market_segments import PlaceKind, shares_of
from .beside_fleet import LARGER, LORRIES, LORRIES_SHARE, OUTLIER_CALLED, OUTLIER_SHARE, left_out
from .observed import Confusion

ANY_PLACE = 0.1  # share of places that tell nothing of their country: a depot of vans, a dealer's yard; judged


def country_likelihoods(
    called: np.ndarray, fleets: Sequence[Fleet], prior: np.ndarray, confusion: Confusion
) -> np.ndarray:
    """(F,) likelihood of the kinds that vehicles are called, in each of `fleets`; 1 on average over the `prior` (F,).

    called : (N, 4) probability of each of `boxes.KINDS` for each vehicle, zeros where it was not assessed. The mix of a
    fleet without classes is not known, so its likelihood is 1.
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
    """Log probability of the `counts` (4,) of vehicles called each of `boxes.KINDS`, up to a constant common to all
    fleets."""
    each = [np.log(place.probability) + _at(counts, fleet, place, confusion) for place in fleet.place_vehicles]
    return float(np.logaddexp.reduce(each))


def _at(counts: np.ndarray, fleet: Fleet, place: PlaceKind, confusion: Confusion) -> float:
    """The same at one kind of places: by a Dirichlet-multinomial distribution with the mean and the variance of the
    shares there. They vary with the place's mix of vehicles, and with how the measurer confuses kinds there."""
    classes = fleet.told_apart_by_kind
    own, larger = place.shares(shares_of(classes)), left_out(classes)
    vehicles = 1 - OUTLIER_SHARE
    shares = vehicles * np.array(
        [*(1 - LORRIES_SHARE) * (1 - larger) * own, (1 - LORRIES_SHARE) * larger, LORRIES_SHARE]
    )
    kinds = np.array([c.kinds for c in (*classes, LARGER, LORRIES)])
    names = kinds @ confusion.shares  # (K + 2, 4) what vehicles of each class are called
    mean = shares @ names + OUTLIER_SHARE * OUTLIER_CALLED
    of_mix = (vehicles * (shares @ names**2) - (shares @ names) ** 2) / (place.vehicles + 1)
    of_names = (shares @ kinds) ** 2 @ (confusion.shares * (1 - confusion.shares)) / (confusion.vehicles + 1)
    strayed = (of_mix + of_names).sum() / (mean * (1 - mean)).sum()
    before = mean * (1 / strayed - 1)
    after = before + counts
    return float(gammaln(before.sum()) - gammaln(after.sum()) + (gammaln(after) - gammaln(before)).sum())
