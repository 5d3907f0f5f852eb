"""The facilities that can be placed: standard ones with their sources, parking by country, or those of a user's file.

The figures of each and their source are in ``data/facilities.json``, whose ``about`` describes the format; the sizes of
parking bays are in ``data/stalls.json``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np

from ..core.angles import unit_vector
from ..core.fleet import WORLD
from ..errors import InputError, UsageError, shown
from ..formats.reading import checked, read_plain, reason, shipped
from ..formats.tables import standards

CATALOGUE_HINT = 'Expected {"facilities": {CODE: {"name", "length", "width", "ends", "sides", "source"}}} in metres.'
ARC_STEP = 6.0  # [deg] between the points of a drawn arc
USUAL_BAYS = 10  # of a car park, if no number is given


@dataclass(frozen=True)
class Facility:
    """One kind of facility, about its own centre: x along its length, y to the left [m].

    length, width : of the playing area. ends, sides : run-off beyond its short and its long lines [m].
    north_south : whether its length should point north, so that nobody looks into a low sun.
    stadium : whether its ends are half circles. lines : what is painted, (n, 2) each.
    look : in words, for a generative renderer. colour : RGB. open_ends : whether vehicles drive in at its short ends,
    which are then not painted.
    """

    code: str
    name: str
    length: float
    width: float
    ends: float
    sides: float
    north_south: bool
    stadium: bool
    lines: tuple[np.ndarray, ...]
    look: str
    colour: tuple[int, int, int]
    source: str
    open_ends: bool = False

    @property
    def full_length(self) -> float:
        """Length with the run-off at both ends [m]."""
        return self.length + 2 * self.ends

    @property
    def full_width(self) -> float:
        """Width with the run-off at both sides [m]."""
        return self.width + 2 * self.sides

    @property
    def outline(self) -> np.ndarray:
        """(n, 2) corners of the playing area [m]."""
        if self.stadium:
            return _stadium(self.length - self.width, self.width / 2)[:-1]
        return _rectangle(0, 0, self.length, self.width)[:-1]

    @property
    def edges(self) -> tuple[np.ndarray, ...]:
        """The playing area's painted edges: all round, or with `open_ends` only along the long sides."""
        ring = np.concatenate([self.outline, self.outline[:1]])
        return (ring[:2], ring[2:4]) if self.open_ends else (ring,)


@dataclass(frozen=True)
class Request:
    """One facility to place; `centre` (in the CRS or pixels) and `bearing` [deg] if its place is given."""

    facility: Facility
    centre: tuple[float, float] | None = None
    bearing: float | None = None


def parse_requests(texts: Sequence[str], catalogue: Path | None = None) -> list[Request]:
    """The requests in ``CODE``, ``CODE:COUNT``, ``CODE@X,Y`` or ``CODE@X,Y,BEARING``; parking is ``parking-COUNTRY`` or
    ``parking-COUNTRY:BAYS``.

    BEARING is that of the long side [deg], clockwise from north; 0 by default. Raises UsageError, InputError.
    """
    kinds = load(catalogue)
    requests: list[Request] = []
    for text in texts:
        match = re.fullmatch(r"([A-Za-z0-9_-]+)(?::(\d{1,9}))?(?:@([^@]+))?", text.strip())
        if not match:
            said = f"--facility {shown(text)} is not understood"
            raise UsageError(said, "Give CODE, CODE:COUNT or CODE@X,Y,BEARING.")
        code, count, place = match[1], int(match[2] or 1), match[3]
        if not 1 <= count <= 1000:
            raise UsageError(f"--facility {text!r}: a count of {count}", "Give a count from 1 to 1000.")
        if code.lower().startswith("parking"):
            facility, count = parking(code, int(match[2] or USUAL_BAYS)), 1
        elif code.lower() in kinds:
            facility = kinds[code.lower()]
        else:
            raise UsageError(
                f"no facility is called {code!r}",
                f"Known are {', '.join(kinds)}, and parking-COUNTRY:BAYS; or give a --catalogue of your own.",
            )
        centre, bearing = _place(place, text) if place else (None, None)
        requests += [Request(facility, centre, bearing)] * count
    return requests


def _place(place: str, text: str) -> tuple[tuple[float, float], float]:
    try:
        x, y, *rest = (float(v) for v in place.split(","))
        (bearing,) = rest or (0.0,)
        if not (math.isfinite(x) and math.isfinite(y) and abs(bearing) <= 360):
            raise ValueError
    except ValueError:
        raise UsageError(f"--facility {text!r}: no place in {place!r}", "Give CODE@X,Y or CODE@X,Y,BEARING.") from None
    return (x, y), bearing


def load(path: Path | None = None) -> dict[str, Facility]:
    """The built-in facilities by code in lower case, and those of the file at `path` (same format), which replace
    built-in ones. Raises InputError."""
    built_in = shipped("facilities")["facilities"]
    if path is None:
        return {code: _facility(code, entry, built_in) for code, entry in built_in.items()}
    from ..formats.schemas.standards import Catalogue

    own = read_plain(path, "a catalogue", CATALOGUE_HINT)
    checked(own, Catalogue, str(path), "a catalogue", CATALOGUE_HINT)
    entries = built_in | {code.lower(): entry for code, entry in own["facilities"].items()}
    facilities = {}
    for code, entry in entries.items():
        try:
            facilities[code] = _facility(code, entry, entries)
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{path}: not a catalogue (facilities.{shown(code)}: {reason(error)})", CATALOGUE_HINT
            ) from error
    return facilities


def parking(code: str, bays: int) -> Facility:
    """A car park of `bays` in two rows, at right angles to an aisle between them, for ``parking-DE`` and the like.
    Raises UsageError for a country whose bays are not known."""
    country = code.partition("-")[2].upper()
    stalls = {c: row for key, row in standards().stalls.items() for c in (key, *row.get("countries", ()))}
    del stalls[WORLD]
    if country not in stalls:
        raise UsageError(
            f"no parking bays are known for {country or code!r}",
            f"Give parking-COUNTRY:BAYS, with one of {', '.join(stalls)}.",
        )
    stall, aisles = stalls[country], shipped("facilities")["parking"]
    aisle = aisles.get(country, aisles[WORLD])
    per_row = math.ceil(bays / 2)
    length, width = per_row * stall["width"], 2 * stall["length"] + aisle["aisle"]
    lines = []
    for side, count in ((1, per_row), (-1, bays - per_row)):
        outer, inner = side * width / 2, side * aisle["aisle"] / 2
        across = [-length / 2 + k * stall["width"] for k in range(count + 1)]
        lines += [np.array([[x, outer], [x, inner]]) for x in across if count]
    return Facility(
        code=f"parking-{country}",
        name=f"car park of {bays} bays ({country})",
        length=length,
        width=width,
        ends=0.0,
        sides=0.0,
        north_south=False,
        stadium=False,
        lines=tuple(lines),
        look=f"an asphalt car park with {bays} marked bays in two rows along an aisle",
        colour=(120, 120, 125),
        source=f"bay: {stall['source']}; aisle: {aisle['source']}",
        open_ends=True,
    )


def _facility(code: str, entry: Mapping[str, Any], entries: Mapping[str, Mapping[str, Any]]) -> Facility:
    """The facility of an entry that fits `schemas.standards.FacilityEntry`. entries : all by code in lower case. Raises
    ValueError for lines or an infield that make no sense."""
    sizes = {name: float(entry.get(name, 0.0)) for name in ("length", "width", "ends", "sides")}
    both = [_points(line) for line in entry.get("both_ends", [])]
    lines = [*(_points(line) for line in entry.get("lines", [])), *both, *(-line for line in both)]
    if infield := entry.get("infield"):
        inner = infield.lower()
        if inner not in entries or entries[inner].get("infield"):
            raise ValueError(f"its infield {infield!r} is not known, or has one itself")
        lines += _facility(inner, entries[inner], entries).lines
    red, green, blue = (int(v) for v in entry.get("colour", (160, 160, 160)))
    return Facility(
        code=code,
        name=str(entry["name"]),
        length=sizes["length"],
        width=sizes["width"],
        ends=sizes["ends"],
        sides=sizes["sides"],
        north_south=bool(entry.get("north_south", False)),
        stadium=entry.get("shape") == "stadium",
        lines=tuple(lines) or (_rectangle(0, 0, sizes["length"], sizes["width"]),),
        look=str(entry.get("look", f"a {entry['name']}")),
        colour=(red, green, blue),
        source=str(entry["source"]),
    )


def _points(line: Sequence[Any]) -> np.ndarray:
    kind, *values = line
    if kind not in DRAWN or len(values) != len(signature(DRAWN[kind]).parameters) or str in map(type, values):
        raise ValueError(f"a line that is not one of {', '.join(DRAWN)} with its numbers")
    return DRAWN[kind](*(float(v) for v in values))


def _rectangle(cx: float, cy: float, length: float, width: float) -> np.ndarray:
    x, y = length / 2, width / 2
    return np.array([[cx + x, cy + y], [cx - x, cy + y], [cx - x, cy - y], [cx + x, cy - y], [cx + x, cy + y]])


def _line(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    return np.array([[x0, y0], [x1, y1]])


def _arc(cx: float, cy: float, radius: float, start: float, end: float) -> np.ndarray:
    angle = np.radians(np.linspace(start, end, max(2, math.ceil(abs(end - start) / ARC_STEP) + 1)))
    return radius * unit_vector(angle) + (cx, cy)


def _stadium(straight: float, radius: float) -> np.ndarray:
    right, left = _arc(straight / 2, 0, radius, -90, 90), _arc(-straight / 2, 0, radius, 90, 270)
    return np.concatenate([right, left, right[:1]])


DRAWN: dict[str, Callable[..., np.ndarray]] = {"rect": _rectangle, "line": _line, "arc": _arc, "stadium": _stadium}
