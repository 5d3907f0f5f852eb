"""Rows of painted parking bays, by the pitch of their lines."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from ..core.anchors import Anchor, Standard
from ..tables import standards as tables
from .ladders import Ladder, crowded, find_ladders, levels, refined
from .rules import DISTORTION, holding, sizes, within_reach
from .strokes import find_strokes, paint_light, painted

FOOT = 0.3048  # [m]
BUILT = 0.013  # one sigma of a row's mean pitch about its feet: American lots, 2.55 to 2.64 m and 2.69 to 2.78 m
PLACE_SD = 0.05  # of one place's bays about its country's mean, beside what the table says [m]

IN_FEET = tuple(
    Standard(
        f"bays of {feet:g} ft",
        feet * FOOT,
        BUILT,
        "9 x 18 ft usual, 8.5 to 9 ft wide (easycivil.com); American lots of a foot per pixel show these four",
        share,
        ("US",),
    )
    for feet, share in ((8.5, 0.25), (9.0, 0.5), (9.5, 0.15), (10.0, 0.1))
)

LINE_SIGMA = 0.09  # of the ridges' smoothing [m]: lines are 0.10 to 0.15 m wide
THINNEST = 0.8  # of that smoothing [px]
SHORTEST, LONGEST = 2.2, 13.0  # of lines [m]: part of one under a vehicle, and two rows nose to nose
FEWEST = 6  # lines
REGULAR = 4.5  # natural logarithm of how much likelier such a row is as one than by chance
FILLED = 0.7  # of the places taken
UNEVEN = 0.35  # of their length: one sigma of the lines' lengths
CROWDED = 0.15  # of the bays with a line through their middle
FANNED = np.sin(np.radians(6))  # at most from the first line to the last: rows in a bend have no pitch
AMONG = 0.7  # of the mean curvature around: vehicles' edges are stronger than lines
SAME_GROUND = 0.5  # of the contrast, by which the ground past one end may differ from that beside: the aisle
CONTRAST = 8.0  # grey levels between lines and the ground beside them
ASIDE, PAST = 0.45, 1.2  # of the lines and of their ends, where that ground is seen [m]


@cache
def bay_standards() -> tuple[Standard, ...]:
    """Those in feet, and the table's of the other countries; the world's is everywhere's."""
    rows = [
        Standard(
            f"bays of {row['width']:.2f} m",
            row["width"],
            float(np.hypot(row["width_sd"], PLACE_SD) / row["width"]),
            row["source"],
            countries=() if code == "WORLD" else (code,),
        )
        for code, row in tables().stalls.items()
        if code != "US"
    ]
    return (*IN_FEET, *rows)


class ParkingBays:
    """Finds rows of painted parking bays (an `AnchorFinder`)."""

    kind = "parking bays"
    extent = 60.0
    finest = 0.10
    coarsest = 0.32

    def find(self, image: np.ndarray, gsd: float, gsd_sd: float, country: str) -> Sequence[Anchor]:
        """See `AnchorFinder.find`."""
        standards = holding(bay_standards(), country)
        if min(image.shape[:2]) < SHORTEST / gsd:
            return []
        low, high = sizes(standards, gsd, gsd_sd)
        light = paint_light(image)
        strokes = find_strokes(light, max(LINE_SIGMA / gsd, THINNEST), SHORTEST / gsd, AMONG)
        found = []
        for ladder in find_ladders(strokes[strokes.length < LONGEST / gsd], low, high, FEWEST):
            meant = within_reach(standards, ladder.row.period, gsd, gsd_sd)
            if meant and crowded(ladder, strokes) <= CROWDED and _are_bays(image, ladder, gsd):
                found.append(_anchor(refined(light, ladder, max(ASIDE / gsd, 2.0)), meant))
        return found


def _are_bays(image: np.ndarray, ladder: Ladder, gsd: float) -> bool:
    """Whether its lines are equal and painted, with the same ground left, right and in the aisle."""
    if ladder.row.filled < FILLED or ladder.row.regularity < REGULAR or ladder.fanned > FANNED:
        return False
    if np.std(ladder.strokes.length) > UNEVEN * ladder.length:
        return False
    seen = levels(image, ladder, ASIDE / gsd, PAST / gsd)
    paint, sides, past = (np.median(place, axis=-2) for place in (seen.paint, seen.beside, seen.beyond))
    contrast = (paint - sides)[:, :2].mean(1).min()
    aisle = np.abs(past - sides.mean(0))[:, :2].mean(1).min() < SAME_GROUND * contrast
    return contrast > CONTRAST and bool(aisle) and all(painted(paint, side) for side in sides)


def _anchor(ladder: Ladder, meant: tuple[Standard, ...]) -> Anchor:
    row = ladder.row
    return Anchor(
        kind=ParkingBays.kind,
        place=ladder.strokes.centre.mean(0),
        lines=ladder.lines(),
        pixels=row.period,
        relative_sd=float(np.hypot(ladder.relative_sd, DISTORTION)),
        residual=row.residual,
        standards=meant,
        false=0.05,
        count=len(row.number),
    )
