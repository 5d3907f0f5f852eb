"""The table of fleets, from which a fleet is found by a country's name or by a code; and fleets from files."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from .core.calibration import Calibration
from .core.fleet import WORLD, Fleet, class_of
from .errors import InputError, UsageError, shown
from .formats.reading import checked, read_plain, shipped
from .system.paths import path_of

FLEET_HINT = (
    'Expected {"name", "source", "length": [mean, sd], "width", "height", "mean_sd": [3]} in metres. '
    "A calibration with a local fleet is given by --calibration."
)
OF_ANY_COUNTRY = (WORLD, "AUTO")  # names of the fleet for an unknown country
# The prior over countries for a place of which nothing is known. It lies in some country, so the candidates are the
# fleets of countries: the world's average, with its many sizes, is the fleet of none. All that is known is that there
# are vehicles, so most of the prior is proportional to the countries' vehicles. The rest is proportional to people, for
# pictures that are taken where people live, and even, for pictures of one country after the other
# (benchmarks/results/places.md compares other shares). The average has a share for countries unlike all candidates.
AVERAGE_SHARE = 0.1
REASONS = 0.7, 0.15, 0.15  # weights of the priors: by vehicles, by people, even
REGION = "R_"  # prefix of the codes of regions, whose fleets stand in for countries without a row


def load_fleet(name: str | Path) -> Fleet:
    """A fleet by the name of a country or a part of one (``US``, ``DEU``, ``Schweiz``, ``Texas``; see
    `countries.country_code`), by a code of the table (``US_pickup``, ``world``), or from a JSON file with one entry.
    ``DE:mini`` is the fleet of a place in Germany where most vehicles are of the class mini.

    A country without a fleet of its own takes a neighbour's or its region's, with a larger uncertainty, and the fleet's
    name says so. ``world``, or ``auto``, has as candidates the world's average and the fleets of countries, weighted by
    their vehicles and people. Inhabitants are those of 2022 (United Nations, World Population Prospects 2022), vehicles
    those in use about then (rounded; `world_source`).
    Raises UsageError for an unknown name, InputError for a file that is not a fleet.
    """
    if str(name).upper() in OF_ANY_COUNTRY:
        average, vehicles = _row(WORLD), _document()["world"]
        people = [_document()["people"][code] for code in vehicles]
        reasons = np.array([list(vehicles.values()), people, np.ones(len(people))], float)
        share = np.array(REASONS) @ (reasons / reasons.sum(1, keepdims=True))
        prior = (AVERAGE_SHARE, *((1 - AVERAGE_SHARE) * share).tolist())
        return replace(average, candidates=(average, *(_row(code) for code in vehicles)), prior=prior)
    known = {code.lower(): code for code in (*fleet_codes(), *_document()["parts"])}
    if str(name).lower() in known:
        return _own(known[str(name).lower()])
    path = path_of(name, "a country, or the path of a fleet.json")
    if path.suffix.lower() == ".json":
        return read_fleet(path)
    country, _, wanted = str(name).rpartition(":")
    if len(country) < 2:  # no class, or the drive of a path
        return _of_country(str(name))
    if ":" in country and Path(country).suffix.lower() != ".json":
        raise UsageError(f"fleet {str(name)!r} names more than one class", "Name one: COUNTRY:CLASS, such as DE:mini.")
    return _mostly(load_fleet(country), wanted.strip())


def read_fleet(path: Path) -> Fleet:
    """A fleet from a JSON file of one entry, as in ``data/fleets.json``. Raises InputError."""
    from .formats.schemas.fleets import FleetEntry

    entry = read_plain(path, "a fleet", FLEET_HINT)
    checked(entry, FleetEntry, str(path), "a fleet", FLEET_HINT)
    segments = _document()["segments"]
    unknown = [name for name in entry.get("shares", ()) if name not in segments]
    if unknown:
        raise InputError(
            f"{path}: not a fleet (no segment is called {shown(unknown[0])!r})", f"Known: {', '.join(segments)}."
        )
    return Fleet.from_entry(path.stem, entry, segments)


def local_fleet(known: Calibration | None) -> Fleet | None:
    """The fleet at the place where a calibration was measured, None where the calibration does not have it."""
    if known is None or known.fleet_entry is None:
        return None
    return Fleet.from_entry("local", known.fleet_entry, _document()["segments"])


def fleet_codes() -> list[str]:
    """The codes of the built-in fleets."""
    return list(_document()["fleets"])


def _of_country(text: str) -> Fleet:
    """The fleet of a country by any of its names; raises UsageError with similar names for an unknown one."""
    from .countries import country_code, country_name, namesake

    code = country_code(text)
    if code is None:
        raise _unknown(text)
    if not _has_fleet(code):
        raise _unknown(text)
    if code not in _document()["fallback"]:
        return _own(code)
    stand_in = _document()["fallback"][code]
    fleet = _row(stand_in)
    # A neighbour's fleet is another country's, so it is less certain. A region's figures already include the spread
    # between its countries.
    more = np.zeros(3) if stand_in.startswith(REGION) else np.array(_document()["fallback_add_sd"])
    name = f"{country_name(code)}: no fleet of its own, taken from {fleet.name}"
    if state := namesake(code):
        name += f"; the state of the USA is {state}"
    return _with_three_wheelers(replace(fleet, code=code, name=name, mean_sd=np.hypot(fleet.mean_sd, more)))


def _has_fleet(code: str) -> bool:
    """Whether there is a fleet for the country, or part of one, with that code."""
    return code in fleet_codes() or code in _document()["parts"] or code in _document()["fallback"]


def _unknown(text: str) -> UsageError:
    from .countries import are_several, nearest_names

    near = nearest_names(text, _has_fleet)
    hint = f"Did you mean {', '.join(near)}? " if near else ""
    if text.lower().endswith(".csv"):
        hint = "`orthoscale fleets --registrations` makes a fleet from a register. "
    elif are_several(text):
        hint = "All vehicles are measured by one fleet, of one country. "
    return UsageError(
        f"no fleet is called {text!r}",
        f"{hint}Give a country's name or ISO 3166 code, world, or a .json file; `orthoscale fleets` lists them.",
    )


def _own(code: str) -> Fleet:
    """The fleet with that code, of a country, a region or a part of a country."""
    return _part(code) if code in _document()["parts"] else _row(code)


@cache
def _row(code: str) -> Fleet:
    entry = _document()["fleets"][code]
    fleet = Fleet.from_entry(code, entry, _document()["segments"])
    return _with_three_wheelers(replace(fleet, shares_sd=_document()["shares_sd"].get(entry.get("trust"), 0.0)))


def _part(code: str) -> Fleet:
    """The fleet of a part of a country, in which one class has another share than in the whole country."""
    part, source = _document()["parts"][code], _document()["parts_source"]
    country = _row(part["of"]).with_share(part["class"], part["share"])
    return replace(country, code=code, name=part["name"], shares_source=f"{country.shares_source}: {source}")


def _mostly(fleet: Fleet, wanted: str) -> Fleet:
    """`Fleet.mostly` for the class `wanted`, in any case. Raises UsageError."""
    names = {c.name.lower(): c.name for c in fleet.classes}
    if fleet.candidates or len(names) < 2:
        raise UsageError(f"the vehicles of fleet {fleet.code} are not divided into classes", "Name a country.")
    if wanted.lower() not in names:
        raise UsageError(f"fleet {fleet.code} has no class {wanted!r}", f"Its classes: {', '.join(names.values())}.")
    return fleet.mostly(names[wanted.lower()])


def _with_three_wheelers(fleet: Fleet) -> Fleet:
    """`fleet` with its country's share of three-wheelers; they are modelled apart from its classes."""
    table = _document()["three_wheelers"]
    share = table["shares"].get(fleet.country, 0.0)
    return replace(fleet, three_wheelers=class_of(table, share) if share else None)


def _document() -> dict[str, Any]:
    return shipped("fleets")
