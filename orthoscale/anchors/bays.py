"""Rows of painted parking bays, by the pitch of their lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from ..core.anchors import BAYS, Anchor, Standard, holding
from ..core.measuring.parking import RECALLED_SD, documented
from ..formats.tables import standards as tables
from .ladders import Ladder, crowded, doubled, find_ladders, levels, refined
from .repeated import anchor_of
from .rules import ruled, sizes, within_reach
from .strokes import Strokes, find_strokes, paint_light, painted

FOOT = 0.3048  # [m]
BAY_BUILT = 0.013  # relative 1 sigma of a row's mean pitch about its rule; American lots: 2.55 to 2.64, 2.69 to 2.78 m
BAY_PLACE_SD = 0.05  # [m] one sigma of a place's bays about its country's mean, added to that of the table

# Of 21 American city and county codes, found by a search for stall dimensions without a width, 19 require 9 ft and two
# 8.5 ft (seen 2026: amlegal.com, ecode360.com, elaws.us); two more require 10 ft. Codes give minimum widths, and older
# lots follow older codes: a third is left to other widths.
SHARES = {8.5: 0.2, 9.0: 0.65, 9.5: 0.05, 10.0: 0.1}
IN_FEET = tuple(
    Standard(
        f"bays of {feet:g} ft",
        feet * FOOT,
        BAY_BUILT,
        "9 ft in 19 of 21 city and county codes, 8.5 in two (amlegal.com, ecode360.com, elaws.us, 2026); 10 ft in "
        "Madison IL and Wellington OH, 9.5 and 10 beside 9 in Simi Valley CA",
        share,
        ("US",),
    )
    for feet, share in SHARES.items()
)

BAY_FALSE = 0.03  # of 37 rows on 62 Mpx of American chips none was false; one false row is assumed
# The same where the country, and so the scale, is less well known: with 0.8 times the true scale given to the finders,
# 2 of 29 rows on chips, eight orthophotos and training frames were not car bays (boats, bays of coaches).
BAY_FALSE_ROUGH = 0.1

BAY_LINE_SIGMA = 0.09  # [m] one sigma of the ridge filter: lines are 0.10 to 0.15 m wide
BAY_THINNEST = 0.8  # [px] least value of that sigma
BAY_SHORTEST, BAY_LONGEST = 2.2, 13.0  # [m] line lengths: partly under a vehicle; shared by two rows nose to nose
BAY_FEWEST = 6  # lines
# [m] and [px] between the two lines of double ones (hairpins): 16 in in Thousand Oaks CA (sec. 9-4.2404, amlegal.com)
DOUBLE_LEAST, DOUBLE_MOST, DOUBLE_LEAST_PX = 0.25, 0.75, 1.5
DOUBLE_UNEVEN = 0.15  # of that distance: most it may scatter within a row, one sigma
BAY_REGULAR = 4.5  # least `Row.regularity`: natural logarithm of the likelihood ratio of a row to chance
BAY_FILLED = 0.7  # least share of the row's places that have a line
BAY_UNEVEN = 0.35  # of the median length: most that the lengths may scatter, one sigma
BAY_CROWDED = 0.15  # most bays that may have a line through their middle, as a share
BAY_ASKEW = 0.3  # of their length: most that lines may be shifted along themselves, rms; vehicles hide ends
BAY_FANNED = np.sin(np.radians(6))  # sine of the most that lines may turn along the row: rows in a bend have no pitch
BAY_AMONG = 0.7  # least curvature, as a share of the mean around: vehicles' edges are stronger than lines
BAY_SAME_GROUND = 0.5  # of the contrast: most that the ground past one end (the aisle) may differ from that beside
BAY_CONTRAST = 8.0  # [grey levels] least contrast of lines to the ground beside them
BAY_ASIDE, BAY_PAST = 0.45, 1.2  # [m] from the lines and from their ends to where that ground is sampled


@cache
def bay_standards() -> tuple[Standard, ...]:
    """The American standards in feet, and those of the table for other countries; the table's world entry applies
    everywhere."""
    rows = [
        Standard(
            f"bays of {row['width']:.2f} m",
            row["width"],
            float(np.hypot(row["width_sd"], BAY_PLACE_SD if documented(row) else RECALLED_SD) / row["width"]),
            row["source"],
            countries=tuple(row.get("countries", (code,))),
            documented=documented(row),
        )
        for code, row in tables().stalls.items()
        if code != "US"
    ]
    return (*IN_FEET, *rows)


@dataclass(frozen=True)
class ParkingBays:
    """Finds rows of painted parking bays (an `AnchorFinder`) of any of the `standards`."""

    standards: tuple[Standard, ...] = field(default_factory=bay_standards)
    kind = BAYS
    extent = 60.0
    finest = 0.10
    coarsest = 0.36

    def find(self, image: np.ndarray, gsd: float, gsd_sd: float, country: str) -> Sequence[Anchor]:
        """See `AnchorFinder.find`."""
        # Without a known country the standards of all countries are kept, so that it can be seen later which fit.
        rough = not country and not ruled(self.standards, country)
        standards = self.standards if rough else holding(self.standards, country)
        if min(image.shape[:2]) < BAY_SHORTEST / gsd:
            return []
        low, high = sizes(standards, gsd, gsd_sd)
        light = paint_light(image)
        strokes = find_strokes(light, max(BAY_LINE_SIGMA / gsd, BAY_THINNEST), BAY_SHORTEST / gsd, BAY_AMONG)
        strokes = strokes[strokes.length < BAY_LONGEST / gsd]
        found = []
        for ladder in _rows(strokes, low, high, gsd):
            reached = within_reach(standards, ladder.row.period, gsd, gsd_sd)
            if reached and crowded(ladder, strokes) <= BAY_CROWDED and _are_bays(image, ladder, gsd):
                meant, false = (standards, BAY_FALSE_ROUGH) if rough else (reached, BAY_FALSE)
                row = refined(light, ladder, max(BAY_ASIDE / gsd, 2.0))
                found.append(anchor_of(row, self.kind, tuple(meant), false))
        return found


def _rows(strokes: Strokes, low: float, high: float, gsd: float) -> Iterator[Ladder]:
    """Rows of double lines, then rows of single lines that share none with them: within a row of double lines, some
    left and some right lines make a false row of another pitch."""
    doubles = doubled(strokes, max(DOUBLE_LEAST / gsd, DOUBLE_LEAST_PX), DOUBLE_MOST / gsd)
    rows = [row for row in find_ladders(doubles, low, high, BAY_FEWEST) if _evenly_double(row)]
    yield from rows
    for row in find_ladders(strokes, low, high, BAY_FEWEST):
        if not any(row.shares(other) for other in rows):
            yield row


def _evenly_double(row: Ladder) -> bool:
    return bool(np.std(row.strokes.apart) < DOUBLE_UNEVEN * row.apart)  # type: ignore[arg-type]


def _are_bays(image: np.ndarray, ladder: Ladder, gsd: float) -> bool:
    """Whether its lines are equal and painted, with the same ground left, right and in the aisle."""
    if ladder.row.filled < BAY_FILLED or ladder.row.regularity < BAY_REGULAR or ladder.fanned > BAY_FANNED:
        return False
    if np.std(ladder.strokes.length) > BAY_UNEVEN * ladder.length or ladder.askew > BAY_ASKEW:
        return False
    seen = levels(image, ladder, BAY_ASIDE / gsd, BAY_PAST / gsd)
    paint, sides, past = (np.median(place, axis=-2) for place in (seen.paint, seen.beside, seen.beyond))
    contrast = (paint - sides)[:, :2].mean(1).min()
    aisle = np.abs(past - sides.mean(0))[:, :2].mean(1).min() < BAY_SAME_GROUND * contrast
    return contrast > BAY_CONTRAST and bool(aisle) and all(painted(paint, side) for side in sides)
