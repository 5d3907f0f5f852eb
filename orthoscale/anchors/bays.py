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
BAY_BUILT = 0.013  # one sigma of a row's mean pitch about its feet: American lots, 2.55 to 2.64 m and 2.69 to 2.78 m
BAY_PLACE_SD = 0.05  # of one place's bays about its country's mean, beside what the table says [m]

# Of 21 American city and county codes, met by asking for stall dimensions but no width, 19 ask for 9 ft and two for
# 8.5 (seen 2026: amlegal.com, ecode360.com, elaws.us); two more ask for 10 ft. That is what codes ask at least, and
# older lots have what theirs asked: a third is left to other widths.
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

BAY_FALSE = 0.03  # none of 37 rows on 62 Mpx of American chips was something else; one more is reckoned
# The same where the country is not known, and so the scale only roughly: where finders were told 0.8 of the true scale,
# 2 of 29 rows on chips, eight orthophotos and training frames were no bays of cars (boats, bays of coaches).
BAY_FALSE_ROUGH = 0.1

BAY_LINE_SIGMA = 0.09  # of the ridges' smoothing [m]: lines are 0.10 to 0.15 m wide
BAY_THINNEST = 0.8  # of that smoothing [px]
BAY_SHORTEST, BAY_LONGEST = 2.2, 13.0  # of lines [m]: part of one under a vehicle, and two rows nose to nose
BAY_FEWEST = 6  # lines
# [m] and [px] from line to line of double ones, as hairpins: 16 in in Thousand Oaks CA (sec. 9-4.2404, amlegal.com)
DOUBLE_LEAST, DOUBLE_MOST, DOUBLE_LEAST_PX = 0.25, 0.75, 1.5
DOUBLE_UNEVEN = 0.15  # of that: one sigma in one row
BAY_REGULAR = 4.5  # natural logarithm of how much likelier such a row is as one than by chance
BAY_FILLED = 0.7  # of the places taken
BAY_UNEVEN = 0.35  # of their length: one sigma of the lines' lengths
BAY_CROWDED = 0.15  # of the bays with a line through their middle
BAY_ASKEW = 0.3  # of their length: how far lines are shifted along themselves, rms; vehicles hide ends
BAY_FANNED = np.sin(np.radians(6))  # at most from the first line to the last: rows in a bend have no pitch
BAY_AMONG = 0.7  # of the mean curvature around: vehicles' edges are stronger than lines
BAY_SAME_GROUND = 0.5  # of the contrast, by which the ground past one end may differ from that beside: the aisle
BAY_CONTRAST = 8.0  # grey levels between lines and the ground beside them
BAY_ASIDE, BAY_PAST = 0.45, 1.2  # of the lines and of their ends, where that ground is seen [m]


@cache
def bay_standards() -> tuple[Standard, ...]:
    """Those in feet, and the table's of the other countries; the world's is everywhere's."""
    rows = [
        Standard(
            f"bays of {row['width']:.2f} m",
            row["width"],
            float(np.hypot(row["width_sd"], BAY_PLACE_SD if documented(code, row) else RECALLED_SD) / row["width"]),
            row["source"],
            countries=tuple(row.get("countries", (code,))),
            documented=documented(code, row),
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
        # Where the country is not known, all countries' bays are kept, so that it can be told whose they suit.
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
    """Rows of double lines, and of single ones: of a row of double ones, some left and some right lines make a row of
    another pitch."""
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
