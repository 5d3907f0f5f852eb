"""The country whose vehicles and standards apply to an input: that of the named fleet, else the one where it lies."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..core.fleet import Fleet
from ..core.source import Source
from ..countries import country_at, with_article
from ..fleets import load_fleet, local_fleet

if TYPE_CHECKING:
    from ..core.calibration import Calibration
    from .location import Location

NOWHERE = "fleet world: the country is not known; name it with --fleet, which makes the scale more certain"
UNIONS = {"EU"}  # two-letter codes of fleets that are not of one country


def named_fleet(name: str | Path | None, known: Calibration | None) -> Fleet | None:
    """The fleet that the user named, else the calibration's; None without either. Raises UsageError, InputError."""
    return local_fleet(known) if name is None else load_fleet(name)


def fleet_at(location: Location | None) -> tuple[Fleet, tuple[str, ...]]:
    """The fleet of the country at `location`, else the world's; and notes on this choice for the user."""
    if location is None:
        return load_fleet("world"), (NOWHERE,)
    code = country_at(location.longitude, location.latitude)
    if code is None:
        return load_fleet("world"), (f"{location.told_by} is not in any country: fleet world",)
    place = f"{location.told_by} is in {with_article(code)}"
    return load_fleet(code), (f"fleet {code}: {place}; choose another with --fleet",)


def country_of(source: Source, fleet: Fleet | None) -> str:
    """ISO code of the country whose standards apply in `source`: that of its `fleet`, else the one where it lies; empty
    if neither is known."""
    from .location import location_of

    code = "" if fleet is None else fleet.country
    if len(code) == 2 and code.isupper() and code not in UNIONS:
        return code
    location = location_of(source)
    return (None if location is None else country_at(location.longitude, location.latitude)) or ""
