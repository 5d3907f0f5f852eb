"""A place whose vehicles are all of one model: a rank of taxis, a dealer's yard, the pickups of an authority.

Its sizes scatter as little as those of the narrowest class of a fleet, whichever model it is, so a mix of classes would
be sure of that class. One model tells only that it is one of the fleet's: the scale is then no better known than the
size of one vehicle drawn from the fleet.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, logit

from ..boxes import KINDS
from ..fleet import Fleet
from ..market_segments import Class, PlaceKind
from .beside_fleet import LARGER, left_out
from .mixture import fit
from .observed import Seen
from .posterior import Posterior
from .problem import Mix, believed, combine

# Share of places that hold one model, or hardly any other; judged: none of 16 real places and 52 of chips does.
PLACES_OF_ONE = 0.02
# Relative spread of length, width and height between the vehicles of one model [1]: between its versions it is 0.9 % of
# length and 0.8 % of width (`registrations.VERSIONS`), and as much again between its generations; judged.
WITHIN_MODEL = np.array([0.02, 0.015, 0.02])
LENGTH_WITH_WIDTH = 0.6  # correlation between the two within a model; as within a segment of the market
# One sigma of each of the two scales beforehand, with which the sizes of the model are found: much more than fleets
# allow, so that it does not move them. Each class is compared with them afterwards.
ANY_SIZE = 0.5
ALL_PLACES = (PlaceKind(20.0, 1.0),)  # how closely one class follows its country's mix tells nothing
LENGTH_LESS_WIDTH = np.array([1.0, -1.0])


@dataclass(frozen=True)
class OneModel:
    """The scale if all vehicles are of one model. log_evidence : comparable with that of `mixture.Fits`."""

    posterior: Posterior
    log_evidence: float

    def probability(self, log_evidence: float) -> float:
        """That all vehicles are of one model, where a mix of classes has this `log_evidence`."""
        return float(expit(logit(PLACES_OF_ONE) + self.log_evidence - log_evidence))


def of_one_model(seen: Seen, fleet: Fleet, known: Mapping[str, np.ndarray]) -> OneModel | None:
    """The scale by the vehicles `seen` if they are of one model of `fleet`; None if they cannot be.

    Any class of the fleet, or of its candidates, may have the model, with the class's share as probability. known : by
    part of the uncertainty, the (2, 2) covariances of the errors common to all vehicles.
    """
    kinds = np.eye(len(KINDS)) if seen.called.size else np.ones((1, len(KINDS))) / len(KINDS)
    every = _sizes(seen, fleet, kinds)
    log_weight, mean, variance = [], [], []
    for one, probability in zip(fleet.candidates or (fleet,), fleet.prior or (1.0,), strict=True):
        country, larger = one.class_mean_covariance(one.classes), left_out(one.classes)
        own = (1 - larger) / sum(c.weight for c in one.classes)
        for part in (*one.classes, replace(LARGER, weight=larger / own)):
            of_kind = part.kinds if seen.called.size else [1.0]
            for share, sizes in zip(of_kind, every, strict=True):
                if share == 0 or sizes is None:
                    continue
                covariance = seen.shrinkage.covariance(part.log_covariance + country) + sizes.covariance
                covariance = believed(sum(known.values(), covariance))
                gap = seen.shrinkage.log_mean(part) - sizes.log_size
                weights = combine(covariance)
                log_weight.append(
                    np.log(probability * own * part.weight * share)
                    + sizes.log_evidence
                    + _log_normal(LENGTH_LESS_WIDTH @ gap, LENGTH_LESS_WIDTH @ covariance @ LENGTH_LESS_WIDTH)
                )
                mean.append(weights @ gap)
                variance.append(weights @ covariance @ weights)
    if not log_weight:
        return None
    log_evidence = float(np.logaddexp.reduce(log_weight))
    weight = np.exp(np.array(log_weight) - log_evidence)
    return OneModel(Posterior(weight, np.array(mean), np.sqrt(variance)), log_evidence)


@dataclass(frozen=True)
class _Sizes:
    """Length and width of the one model, whatever it is: log_size (2,) [log of the votes' unit], its covariance (2, 2).
    log_evidence : that the vehicles are of one model and kind, without what is expected of length against width."""

    log_size: np.ndarray
    covariance: np.ndarray
    log_evidence: float


def _sizes(seen: Seen, fleet: Fleet, kinds: np.ndarray) -> list[_Sizes | None]:
    """The sizes of the one model for each of `kinds` (K, 4) that it may be of, as in `Class.kinds`; None where it
    cannot be."""
    systematic = ANY_SIZE**2 * np.eye(2)
    model = Class("one model", 1.0, fleet.mean, WITHIN_MODEL * fleet.mean, LENGTH_WITH_WIDTH, np.zeros(3))
    mixes = [Mix((replace(model, kinds=kind),), systematic, combine(systematic), ALL_PLACES) for kind in kinds]
    out: list[_Sizes | None] = []
    for fits in fit(seen, mixes):
        if fits is None:
            out.append(None)
            continue
        log_scale = fits.weight @ fits.log_scale
        beforehand = _log_normal(LENGTH_LESS_WIDTH @ log_scale, LENGTH_LESS_WIDTH @ systematic @ LENGTH_LESS_WIDTH)
        out.append(_Sizes(seen.shrinkage.log_mean(model) - log_scale, fits.covariance, fits.log_evidence - beforehand))
    return out


def _log_normal(value: float, variance: float) -> float:
    """Log density of a normal distribution about zero."""
    return float(-0.5 * (np.log(2 * np.pi * variance) + value**2 / variance))
