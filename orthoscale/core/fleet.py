"""Fleets: how large the vehicles of a country are, how much they differ, and how well that is known.

The figures and the source of each lie in ``data/fleets.json``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, UsageError, shown
from ..formats.reading import checked, read_plain
from .market_segments import AXES, Class, classes_of, told_apart

# Correlation between the errors of a fleet's mean length and mean width: a country whose cars are longer than thought
# has wider ones too. Between the means of the table's 29 national fleets it is 0.92; taken a little lower, because each
# fleet's two means were also estimated apart.
MEAN_CORRELATION = 0.85

# How far the vehicles of one place (a car park, a district) stray from their country's mean, relative, one sigma, for
# length and width. An assumption: pickups being 10 % more or less frequent move the US means by 2.2 % and 0.9 %.
LOCAL_SD = np.array([0.025, 0.012])


FLEET_HINT = 'Expected {"name", "source", "length": [mean, sd], "width", "height", "mean_sd": [3]} in metres.'
AUTO = "auto"
WORLD = "WORLD"
# A place of which nothing is known has a country all the same. Half of the prior goes to the world's average, whose
# uncertainty is the scatter of the countries about it; half to the countries as they are: their vehicles' shapes may
# tell which it is. The average alone takes a country of small cars with some vans for one of ordinary cars.
AVERAGE_SHARE = 0.5
REGION = "R_"  # codes of regions, which stand in for their countries that have no row


@dataclass(frozen=True)
class Fleet:
    """The vehicles of one country or region.

    mean, sd : (3,) length, width, height [m]: mean, and spread between vehicles.
    mean_sd : (3,) one-sigma uncertainty of the means [m]; more vehicles do not shrink it.
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
    candidates: tuple[Fleet, ...] = ()  # fleets of which one stands here, not known which
    prior: tuple[float, ...] = ()  # probability of each candidate

    @classmethod
    def load(cls, name: str | Path) -> Fleet:
        """A fleet by country (``US``, ``DEU``, ``Schweiz``, ``Texas``; see `countries.country_code`), by a code of the
        table (``US_pickup``, ``world``), or from a JSON file of one such entry.

        A country without a fleet of its own takes its neighbours' or its region's, less certain, and its name says so.
        ``world`` and ``auto`` have the fleets of countries all over the world and its average as candidates (the table
        names them; to try every country moved the scales of 12 places by 2 % at most, and took three times as long):
        half of the prior is the average's, or all are equally likely. Raises UsageError for an unknown name, InputError
        for a file that is no fleet.
        """
        if str(name).upper() in (WORLD, AUTO.upper()):
            average = cls.from_entry(WORLD, _table()[WORLD])
            countries = [cls.from_entry(code, _table()[code]) for code in _document()["world"]]
            if str(name).upper() == WORLD:
                share = (AVERAGE_SHARE, *[(1 - AVERAGE_SHARE) / len(countries)] * len(countries))
                return replace(average, candidates=(average, *countries), prior=share)
            name, share = "found by the vehicles' shapes", (1 / (1 + len(countries)),) * (1 + len(countries))
            return replace(average, code=AUTO, name=name, candidates=(average, *countries), prior=share)
        known = {code.lower(): code for code in _table()}
        if str(name).lower() in known:
            code = known[str(name).lower()]
            return cls.from_entry(code, _table()[code])
        path = Path(name)
        if path.suffix != ".json":
            return cls._of_country(str(name))
        return cls.of_file(path)

    @classmethod
    def of_file(cls, path: Path) -> Fleet:
        """A fleet from a JSON file of one entry, as in ``data/fleets.json``. Raises InputError."""
        from ..formats.schemas import FleetEntry

        entry = read_plain(path, "a fleet", FLEET_HINT)
        checked(entry, FleetEntry, str(path), "a fleet", FLEET_HINT)
        unknown = [name for name in entry.get("shares", ()) if name not in _document()["segments"]]
        if unknown:
            known = ", ".join(_document()["segments"])
            raise InputError(f"{path}: not a fleet (no segment is called {shown(unknown[0])!r})", f"Known: {known}.")
        return cls.from_entry(path.stem, entry)

    @classmethod
    def _of_country(cls, text: str) -> Fleet:
        """The fleet of a country by any of its names; raises UsageError with the nearest ones for no country's."""
        from ..countries import country_code, country_name, nearest_names

        code = country_code(text)
        if code in _table():
            return cls.from_entry(code, _table()[code])
        stand_in = None if code is None else _document()["fallback"].get(code)
        if code is None or stand_in is None:
            near = nearest_names(text)
            hint = f"Did you mean {', '.join(near)}? " if near else ""
            raise UsageError(
                f"no fleet is called {text!r}",
                f"{hint}Give a country's name or ISO 3166 code, {AUTO}, world, or a .json file; "
                "`orthoscale fleets` lists them.",
            )
        fleet = cls.from_entry(stand_in, _table()[stand_in])
        # A neighbour's fleet is another country's; a region's spread between its countries is in its figures already.
        more = np.zeros(3) if stand_in.startswith(REGION) else np.array(_document()["fallback_add_sd"])
        name = f"{country_name(code)}: no fleet of its own, taken from {fleet.name}"
        return replace(fleet, code=code, name=name, mean_sd=np.hypot(fleet.mean_sd, more))

    @classmethod
    def from_entry(cls, code: str, entry: Mapping[str, Any]) -> Fleet:
        """From the plain values of an entry that fits `schemas.FleetEntry`."""
        mean, sd = np.array([entry[axis] for axis in AXES], float).T
        mean_sd = np.array(entry["mean_sd"], float)
        if "shares" in entry:
            classes = classes_of(entry["shares"], _document()["segments"], mean, mean_sd)
        else:
            parts = entry.get("mixture") or [{"class": "all", **entry}]
            total = sum(float(part.get("weight", 1.0)) for part in parts)
            classes = tuple(_class(part, total, mean_sd / mean, 0.3 if len(parts) > 1 else 0.8) for part in parts)
        source, shares = entry["source"], entry.get("shares_source", "")
        return cls(code, entry["name"], mean, sd, mean_sd, classes, int(entry.get("year", 0)), source, shares)

    @cached_property
    def told_apart(self) -> tuple[Class, ...]:
        """The classes as far as boxes show which is which, for the pooling."""
        return told_apart(self.classes)

    @property
    def log_mean(self) -> np.ndarray:
        """(2,) mean of log length and log width over the whole fleet."""
        return sum((c.weight * c.log_mean for c in self.classes), np.zeros(2)) / sum(c.weight for c in self.classes)

    @property
    def log_mean_covariance(self) -> np.ndarray:
        """(2, 2) covariance of the error of `log_mean`, for the fleet of one place: what is not known about it."""
        return _covariance(np.hypot(self.mean_sd[:2] / self.mean[:2], LOCAL_SD), MEAN_CORRELATION)

    def sample(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """(n, 3) length, width, height [m] of random vehicles of this fleet."""
        weights = np.array([c.weight for c in self.classes])
        pick = rng.choice(len(weights), size=n, p=weights / weights.sum())
        normal = rng.standard_normal((n, 3))
        sizes = np.empty((n, 3))
        for k, c in enumerate(self.classes):
            mine = normal[pick == k]
            mine[:, 1] = c.corr_lw * mine[:, 0] + np.sqrt(1 - c.corr_lw**2) * mine[:, 1]
            sizes[pick == k] = c.mean + c.sd * np.clip(mine, -2.5, 2.5)
        return sizes


def codes() -> list[str]:
    """The codes of the built-in fleets."""
    return list(_table())


def _class(part: Mapping[str, Any], total: float, mean_sd: np.ndarray, corr_lw: float) -> Class:
    """One entry of a mixture, whose weights have the sum `total`; its mean is as well known as the fleet's, relatively:
    `mean_sd` (3,)."""
    mean, sd = np.array([part[axis] for axis in AXES], float).T
    return Class(
        part["class"],
        float(part.get("weight", 1.0)) / total,
        mean,
        sd,
        float(part.get("corr_LW", corr_lw)),
        mean_sd * mean,
    )


def _table() -> dict[str, Any]:
    return _document()["fleets"]


@cache
def _document() -> dict[str, Any]:
    return read_plain(Path(__file__).parent.parent / "data" / "fleets.json", "the table of fleets")


def _covariance(sd: np.ndarray, correlation: float) -> np.ndarray:
    cross = correlation * sd[0] * sd[1]
    return np.array([[sd[0] ** 2, cross], [cross, sd[1] ** 2]])
