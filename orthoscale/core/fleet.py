"""Fleets: how large the vehicles of a country are, how much they differ, and how well that is known.

The figures, and the source of each, are in ``data/fleets.json``, which `orthoscale.fleets` reads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from .by_value import ByValue
from .market_segments import AXES, Class, PlaceKind, classes_of, kinds_of, place_scatter, place_vehicles, told_apart

# Correlation between the errors of a fleet's mean length and mean width: a country whose cars are longer than thought
# has wider ones too. Between the means of the table's 29 national fleets it is 0.92; taken a little lower, because each
# fleet's two means were also estimated apart.
MEAN_CORRELATION = 0.85
# Share of a class at a place where most vehicles are of it, and its one sigma as a share of it. A judgement: half to
# nine tenths is what people call most.
MOSTLY, MOSTLY_SD = 0.7, 0.25
WORLD = "WORLD"  # code of the fleet of a place whose country is not known


@dataclass(frozen=True, eq=False)
class Fleet(ByValue):
    """The vehicles of one country or region.

    mean, sd : (3,) length, width, height [m]: mean, and spread between vehicles.
    mean_sd : (3,) one-sigma uncertainty of the means [m]; more vehicles do not shrink it.
    shares_sd : relative one sigma of the share of a class: how well the country's mix is known.
    three_wheelers : passenger three-wheelers, which stand among the cars of some countries; `mean` and `classes` do
        not include them, and their weight is their share of all small vehicles.
    """

    code: str
    name: str
    mean: np.ndarray
    sd: np.ndarray
    mean_sd: np.ndarray
    classes: tuple[Class, ...]
    year: int
    source: str
    shares_source: str = ""  # where the classes' shares come from
    candidates: tuple[Fleet, ...] = ()  # fleets of which one is present, unknown which
    prior: tuple[float, ...] = ()  # probability of each candidate
    shares_sd: float = 0.0
    three_wheelers: Class | None = None
    of_country: str = ""  # ISO code that a user's own fleet names, whose own code is none

    @classmethod
    def from_entry(cls, code: str, entry: Mapping[str, Any], segments: Mapping[str, Any] | None = None) -> Fleet:
        """From the plain values of an entry as in ``data/fleets.json``.

        segments : that table's market segments, for an entry that gives only their shares.
        """
        mean, sd = np.array([entry[axis] for axis in AXES], float).T
        mean_sd = np.array(entry["mean_sd"], float)
        if "shares" in entry:
            classes = classes_of(entry["shares"], segments or {}, mean, mean_sd)
        else:
            parts = entry.get("mixture") or [{"class": "all", **entry}]
            total = sum(float(part.get("weight", 1.0)) for part in parts)
            classes = tuple(_class(part, total, mean_sd / mean, 0.3 if len(parts) > 1 else 0.8) for part in parts)
        source, shares = entry["source"], entry.get("shares_source", "")
        year, country = int(entry.get("year", 0)), entry.get("country", "")
        return cls(code, entry["name"], mean, sd, mean_sd, classes, year, source, shares, of_country=country)

    @cached_property
    def told_apart(self) -> tuple[Class, ...]:
        """The classes that boxes can tell apart, three-wheelers last, for the pooling."""
        return self._told_apart(by_kind=False)

    @cached_property
    def told_apart_by_kind(self) -> tuple[Class, ...]:
        """The same if the vehicles' kinds are seen as well."""
        return self._told_apart(by_kind=True)

    def _told_apart(self, by_kind: bool) -> tuple[Class, ...]:
        if self.three_wheelers is None:
            return told_apart(self.classes, by_kind)
        return (*told_apart(self.every_class[:-1], by_kind), self.three_wheelers)

    @property
    def every_class(self) -> tuple[Class, ...]:
        """The classes, weighted by their shares of all small vehicles, three-wheelers last."""
        if self.three_wheelers is None:
            return self.classes
        total, left = sum(c.weight for c in self.classes), 1 - self.three_wheelers.weight
        return (*(replace(c, weight=left * c.weight / total) for c in self.classes), self.three_wheelers)

    @property
    def place_vehicles(self) -> tuple[PlaceKind, ...]:
        """How closely places follow this fleet's mix: see `market_segments.PLACE_VEHICLES`."""
        return place_vehicles(self.shares_sd)

    @property
    def country(self) -> str:
        """The ISO code that it names; else the beginning of its own code, which is an ISO code for the fleet of a
        country or of a part of one (``US`` of ``US_TX``)."""
        return self.of_country or self.code.split("_")[0]

    def with_share(self, name: str, share: float) -> Fleet:
        """The same with another `share` of the class `name`, the others in proportion."""
        own = np.array([c.weight if c.name == name else 0.0 for c in self.classes])
        rest = np.array([c.weight for c in self.classes]) - own
        weights = share * own / own.sum() + (1 - share) * rest / rest.sum()
        means, sds = (np.array([getattr(c, of) for c in self.classes]) for of in ("mean", "sd"))
        mean = weights @ means
        return replace(
            self,
            mean=mean,
            sd=np.sqrt(weights @ (sds**2 + (means - mean) ** 2)),
            classes=tuple(replace(c, weight=float(w)) for c, w in zip(self.classes, weights, strict=True)),
            shares_source=f"{self.name}, {name} {100 * share:.0f} %",
        )

    def mostly(self, name: str) -> Fleet:
        """The vehicles of a place of which most are of the class `name`, and the others as in this fleet.

        Which models of that class stand there is as open as at any place of the country, where it has only its usual
        share of the vehicles that are drawn (`PlaceKind.vehicles`).
        """
        own = next(c for c in self.classes if c.name == name)
        drawn = self.place_vehicles[0].vehicles * own.weight / sum(c.weight for c in self.classes)
        return replace(
            self.with_share(name, MOSTLY),
            code=f"{self.code}:{name}",
            name=f"{self.name}, a place where most are of the class {name}",
            mean_sd=np.hypot(self.mean_sd, MOSTLY * own.sd / np.sqrt(drawn + 1)),
            shares_sd=float(np.hypot(self.shares_sd, MOSTLY_SD)),
            of_country=self.country,
        )

    @cached_property
    def log_mean(self) -> np.ndarray:
        """(2,) mean of log length and log width over the whole fleet."""
        return sum((c.weight * c.log_mean for c in self.classes), np.zeros(2)) / sum(c.weight for c in self.classes)

    @property
    def log_mean_covariance(self) -> np.ndarray:
        """(2, 2) covariance of the error of `log_mean`, for the vehicles of one place: the uncertainty of the country's
        mean, and the scatter of the means of places about it."""
        return self._country_covariance + self.log_covariance * place_scatter(self.place_vehicles)

    def class_mean_covariance(self, classes: Sequence[Class]) -> np.ndarray:
        """(2, 2) the part of `log_mean_covariance` that fitted shares of `classes` do not explain."""
        total = sum(c.weight for c in classes)
        within = sum((c.weight / total * c.log_covariance for c in classes), np.zeros((2, 2)))
        return self._country_covariance + within * place_scatter(self.place_vehicles)

    @cached_property
    def log_covariance(self) -> np.ndarray:
        """(2, 2) covariance of log length and log width between the vehicles of the whole fleet."""
        total = sum(c.weight for c in self.classes)
        out = np.zeros((2, 2))
        for c in self.classes:
            apart = c.log_mean - self.log_mean
            out += c.weight / total * (c.log_covariance + np.outer(apart, apart))
        return out

    @property
    def _country_covariance(self) -> np.ndarray:
        return _covariance(self.mean_sd[:2] / self.mean[:2], MEAN_CORRELATION)

    def sample(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """(n, 3) length, width, height [m] of random vehicles of this fleet."""
        return self.sample_of_classes(rng, n)[0]

    def sample_of_classes(self, rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) length, width, height [m] of random vehicles of this fleet; (n,) the index of each one's class."""
        weights = np.array([c.weight for c in self.classes])
        pick = rng.choice(len(weights), size=n, p=weights / weights.sum())
        normal = rng.standard_normal((n, 3))
        sizes = np.empty((n, 3))
        for k, c in enumerate(self.classes):
            mine = normal[pick == k]
            mine[:, 1] = c.corr_lw * mine[:, 0] + np.sqrt(1 - c.corr_lw**2) * mine[:, 1]
            sizes[pick == k] = c.mean + c.sd * np.clip(mine, -2.5, 2.5)
        return sizes, pick


def class_of(part: Mapping[str, Any], weight: float) -> Class:
    """The class, with the given `weight`, of an entry with its own ``mean_sd``, such as that of three-wheelers in
    ``data/fleets.json``."""
    mean, sd = np.array([part[axis] for axis in AXES], float).T
    mean_sd = np.array(part["mean_sd"], float)
    return Class(part["class"], weight, mean, sd, float(part["corr_LW"]), mean_sd, kinds_of(part["class"]))


def _class(part: Mapping[str, Any], total: float, mean_sd: np.ndarray, corr_lw: float) -> Class:
    """The class of one entry of a mixture whose weights sum to `total`. mean_sd : (3,) relative one sigma of its mean,
    which is the fleet's. corr_lw : used if the entry has none."""
    mean = np.array([part[axis][0] for axis in AXES], float)
    return class_of({"corr_LW": corr_lw, **part, "mean_sd": mean_sd * mean}, float(part.get("weight", 1.0)) / total)


def _covariance(sd: np.ndarray, correlation: float) -> np.ndarray:
    cross = correlation * sd[0] * sd[1]
    return np.array([[sd[0] ** 2, cross], [cross, sd[1] ** 2]])
