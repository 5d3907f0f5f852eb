"""Segments of the car market; a fleet is a mixture of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import entr

from .by_value import ByValue

AXES = ("length", "width", "height")
# Classes are merged while that loses at most this much of what a vehicle's box tells of its class [nats]. At 0.05
# China's and Brazil's minis were lost among small cars. A lower limit separates classes whose shares no car park can
# tell, takes longer, and gives no better scales.
TOLD_APART = 0.03
# An odd place, such as a campus of minis or a lot of pickups, has its vehicles for a reason of its own. So a fifth of
# them are expected to follow the country's shares, and the others to be of any class with equal probability. This is a
# judgement, for no survey counts odd places. A class that is rare in the country may then dominate a place: 7 % of
# Germany's cars are minis, and half or more of a place's cars at 1 place of 240 by the country's shares alone, at 1 of
# 100 by these.
ANY_CLASS = 0.8


class PlaceKind(NamedTuple):
    """A kind of places, by how closely their vehicles follow their country's mix.

    vehicles : concentration of the Dirichlet process that draws a place's mix: the fewer, the more mixes differ.
    probability : that a place is of this kind.
    even : share of the expected vehicles that are of all classes with equal probability, not as in the country.
    left_out : the share of larger vehicles beside the fleet (`pooling.beside_fleet.LARGER`) is known as if counted on
        so many vehicles.
    """

    vehicles: float
    probability: float
    even: float = 0.0
    left_out: float = 20.0

    def shares(self, country: np.ndarray) -> np.ndarray:
        """(K,) expected shares of the classes at such a place, from the shares in the `country` (K,)."""
        return country + self.even * (country.sum() / len(country) - country)


# A place (a car park, a district, a campus) has its own mix of vehicles: most places are much like their country, some
# hardly. With the country's shares, the means of places scatter about the country's with `place_scatter` times the
# covariance of its vehicles: 2.9 % of length in Germany, 3.1 % in the USA; ANY_CLASS adds 0.2 %. On 12 places read by
# eye the scatter was 1.6 % (0 to 6 %), the uncertainty of the countries included (training/between_places.py). Twelve
# places cannot tell how often one is odd. Vans are 0 to 25 % at real places, but there are depots of them: at odd
# places their share is known as if counted on 8 vehicles, not 20.
PLACE_VEHICLES = (PlaceKind(20.0, 0.8), PlaceKind(3.0, 0.2, ANY_CLASS, 8.0))
# Share of a typical class, used where one figure says how well all shares of a country are known: boxes can tell about
# five classes of a fleet apart.
USUAL_SHARE = 0.2
BOX_NOISE = 0.05  # relative noise of a box's length and width: usual for the shipped detector
CARS = (1.0, 0.0, 0.0, 0.0)
# The vehicles of a class as shares of `boxes.KINDS`, where they are not all cars. Seen from above, a people carrier
# with a bonnet is a car, and one without is a van: judged from the models of those segments. No measurer has learnt
# which kind to call a three-wheeler.
KINDS_OF = {
    "pickup": (0.0, 1.0, 0.0, 0.0),
    "van": (0.7, 0.0, 0.3, 0.0),
    "MPV/van": (0.5, 0.0, 0.5, 0.0),
    "three-wheeler": (0.25, 0.25, 0.25, 0.25),
    "all": (0.8, 0.08, 0.1, 0.02),
}


@dataclass(frozen=True, eq=False)
class Class(ByValue):
    """One part of a fleet, normal in (length, width, height): `weight` is its share of the vehicles."""

    name: str
    weight: float
    mean: np.ndarray  # (3,) length, width, height [m]
    sd: np.ndarray  # (3,) between vehicles [m]
    corr_lw: float  # correlation of length and width
    mean_sd: np.ndarray  # (3,) one-sigma uncertainty of the mean [m]
    kinds: np.ndarray = field(default_factory=lambda: np.array(CARS))  # (4,) shares of `boxes.KINDS`

    @property
    def covariance(self) -> np.ndarray:
        """(3, 3) [m2]; heights are taken to be independent of the rest."""
        out = np.diag(self.sd**2)
        out[0, 1] = out[1, 0] = self.corr_lw * self.sd[0] * self.sd[1]
        return out

    @property
    def log_mean(self) -> np.ndarray:
        """(2,) mean of log length and log width, to second order in the relative spread."""
        return np.log(self.mean[:2]) - 0.5 * (self.sd[:2] / self.mean[:2]) ** 2

    @property
    def log_covariance(self) -> np.ndarray:
        """(2, 2) covariance of log length and log width, to first order."""
        return self.covariance[:2, :2] / np.outer(self.mean[:2], self.mean[:2])


def shares_of(classes: Sequence[Class]) -> np.ndarray:
    """(K,) share of each of `classes` in the vehicles of all of them."""
    return np.array([c.weight for c in classes]) / sum(c.weight for c in classes)


def place_vehicles(shares_sd: float) -> tuple[PlaceKind, ...]:
    """PLACE_VEHICLES for a country whose shares of the classes are known to `shares_sd` (one sigma, relative).

    A share p of a Dirichlet process with n vehicles has the variance p (1 - p) / (n + 1). The uncertainty of the
    country's share adds (shares_sd p)^2 to it, which is equivalent to fewer vehicles.
    """
    country = shares_sd**2 * USUAL_SHARE / (1 - USUAL_SHARE)
    return tuple(kind._replace(vehicles=1 / (1 / (kind.vehicles + 1) + country) - 1) for kind in PLACE_VEHICLES)


def place_scatter(kinds: Sequence[PlaceKind]) -> float:
    """The covariance of the means of places, as a share of the covariance of the country's vehicles."""
    return sum(kind.probability / (1 + kind.vehicles) for kind in kinds)


def classes_of(
    shares: Mapping[str, float], segments: Mapping[str, Any], mean: np.ndarray, mean_sd: np.ndarray
) -> tuple[Class, ...]:
    """The classes (mini, small, compact, mid, large, SUV, pickup, van) of a fleet, from the `shares` of its segments.

    `segments` are those of ``data/fleets.json``. Segments of one class are merged into one normal distribution of the
    same mean and covariance. Then all classes are scaled by the same factor along each axis, so that the whole has the
    fleet's `mean` (3,) [m], known to `mean_sd` (3,) [m]: the segments' sizes are those of the models on the road
    everywhere, and a country's are older or newer. The uncertainty of a class's mean is that of the fleet's, and that
    of which of its models are present. Raises KeyError for a segment that is not in the table.
    """
    merged: dict[str, Class] = {}
    for name, share in shares.items():
        segment = segments[name]
        middle, sd = np.array([segment[axis] for axis in AXES], float).T
        own = Class(
            segment["class"], float(share), middle, sd, float(segment["corr_LW"]), sd / np.sqrt(segment["models"]),
            kinds_of(segment["class"]),
        )  # fmt: skip
        before = merged.get(own.name)
        merged[own.name] = replace(_two(before, own), name=own.name) if before else own
    total = sum(c.weight for c in merged.values())
    factor = mean / (sum((c.weight * c.mean for c in merged.values()), np.zeros(3)) / total)
    return tuple(
        replace(
            c,
            weight=c.weight / total,
            mean=c.mean * factor,
            sd=c.sd * factor,
            mean_sd=np.hypot(c.mean_sd / c.mean, mean_sd / mean) * c.mean * factor,
        )
        for c in merged.values()
    )


def kinds_of(name: str) -> np.ndarray:
    """(4,) shares of `boxes.KINDS` among the vehicles of the class `name`."""
    return np.array(KINDS_OF.get(name, CARS))


def told_apart(classes: Sequence[Class], by_kind: bool = False) -> tuple[Class, ...]:
    """The classes of a fleet that boxes can tell apart: others are merged, the two that differ least first.

    The loss by a merger is Runnalls' bound of the Kullback-Leibler divergence between the mixtures before and after
    (IEEE Trans. Aerosp. Electron. Syst. 43 (2007) 989), in log length and log width with BOX_NOISE, and in kind if
    that is seen as well (`by_kind`). The mean and the covariance of the whole stay the same, and the shares of kinds.
    """

    def entropy(part: Class) -> float:
        """Entropy of what is seen of its vehicles, up to a constant, times its weight [nats]."""
        return part.weight * (_log_volume(part) + (float(entr(part.kinds).sum()) if by_kind else 0.0))

    left = list(classes)
    while len(left) > 1:
        pairs = [(i, k) for k in range(len(left)) for i in range(k)]
        merged = [_two(left[i], left[k]) for i, k in pairs]
        loss = [entropy(m) - entropy(left[i]) - entropy(left[k]) for (i, k), m in zip(pairs, merged, strict=True)]
        least = int(np.argmin(loss))
        if loss[least] > TOLD_APART * sum(c.weight for c in classes):
            break
        i, k = pairs[least]
        left[i] = merged[least]
        del left[k]
    return tuple(left)


def _log_volume(part: Class) -> float:
    return float(0.5 * np.linalg.slogdet(part.log_covariance + BOX_NOISE**2 * np.eye(2))[1])


def _two(a: Class, b: Class) -> Class:
    """Two classes merged into one, with the mean and the covariance of both together."""
    weight = a.weight + b.weight
    mean = (a.weight * a.mean + b.weight * b.mean) / weight
    covariance = sum(
        (c.weight / weight * (c.covariance + np.outer(c.mean - mean, c.mean - mean)) for c in (a, b)), np.zeros((3, 3))
    )
    sd = np.sqrt(np.diag(covariance))
    corr = float(covariance[0, 1] / (sd[0] * sd[1]))
    known = np.hypot(a.weight * a.mean_sd, b.weight * b.mean_sd) / weight
    kinds = (a.weight * a.kinds + b.weight * b.kinds) / weight
    return Class(f"{a.name}, {b.name}", weight, mean, sd, corr, known, kinds)
