"""Zebra crossings, by the period of their stripes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.anchors import Anchor, Standard, holding
from .ladders import Ladder, crowded, find_ladders, levels, refined
from .repeated import anchor_of
from .rules import ruled, sizes, within_reach
from .strokes import find_strokes, paint_light, painted
from .zebra_rules import ZEBRA_FREE, ZEBRA_LEFT_FREE, ZEBRA_STANDARDS

ZEBRA_FALSE = 0.05  # of 100 finds in 120 Mpx three were louvres of one facade, seen askew; now rejected
ZEBRA_FOREIGN = 1 - (1 - ZEBRA_FALSE) * (1 - ZEBRA_LEFT_FREE)  # where no rule is known: the country may prescribe none

STRIPE_SIGMA = 0.19  # [m] one sigma of the ridge filter: a third to a half of a stripe
ZEBRA_SHORTEST, ZEBRA_LONGEST = 1.8, 11.0  # [m] lengths of stripes
ZEBRA_FEWEST = 5  # stripes
ZEBRA_FILLED = 0.65  # least share of the row's places that have a stripe: vehicles hide some
ZEBRA_REGULAR = 1.5  # least `Row.regularity`: natural logarithm of the likelihood ratio of a row to chance
ZEBRA_ASKEW = 0.25  # of their length: most that stripes may be shifted along themselves, rms; against facades
ZEBRA_CROWDED = 0.1  # largest share of gaps with a stripe in between
ZEBRA_CONTRAST = 15.0  # [grey levels] least contrast of stripes to ground
ZEBRA_SAME_GROUND = 0.45  # of the contrast: most that the ground past the stripes may differ from that between
ZEBRA_PAST = 0.7  # [m] past the ends, where that ground is sampled


@dataclass(frozen=True)
class ZebraCrossings:
    """Finds zebra crossings (an `AnchorFinder`) of any of the `standards`."""

    standards: tuple[Standard, ...] = ZEBRA_STANDARDS
    kind = "zebra crossing"
    extent = 45.0
    finest = 0.10
    coarsest = 0.22

    def find(self, image: np.ndarray, gsd: float, gsd_sd: float, country: str) -> Sequence[Anchor]:
        """See `AnchorFinder.find`."""
        free = country in ZEBRA_FREE and self.standards is ZEBRA_STANDARDS
        standards = [] if free else holding(self.standards, country)
        if not standards or min(image.shape[:2]) < ZEBRA_SHORTEST / gsd:
            return []
        low, high = sizes(standards, gsd, gsd_sd)
        light = paint_light(image)
        strokes = find_strokes(light, STRIPE_SIGMA / gsd, ZEBRA_SHORTEST / gsd, 1.0)
        stripes = strokes[strokes.length < ZEBRA_LONGEST / gsd]
        false = ZEBRA_FALSE if ruled(self.standards, country) else ZEBRA_FOREIGN
        found = []
        for ladder in find_ladders(stripes, low, high, ZEBRA_FEWEST):
            meant = within_reach(standards, ladder.row.period, gsd, gsd_sd)
            if meant and crowded(ladder, strokes) <= ZEBRA_CROWDED and _is_crossing(image, ladder, gsd):
                found.append(anchor_of(refined(light, ladder, ladder.row.period / 2), self.kind, meant, false))
        return found


def _is_crossing(image: np.ndarray, ladder: Ladder, gsd: float) -> bool:
    """Whether the stripes are painted on a road: bright, with the same ground between them as past both ends."""
    if ladder.row.filled < ZEBRA_FILLED or ladder.row.regularity < ZEBRA_REGULAR or ladder.askew > ZEBRA_ASKEW:
        return False
    seen = levels(image, ladder, ladder.row.period / 2, ZEBRA_PAST / gsd)
    paint, ground = np.median(seen.paint, axis=0), np.median(seen.ground, axis=0)
    contrast = float((paint - ground)[:2].mean())
    past = np.median(seen.beyond, axis=1)  # (2, 3)
    same = np.abs(past - ground)[:, :2].mean(1) < ZEBRA_SAME_GROUND * contrast
    return contrast > ZEBRA_CONTRAST and bool(same.all()) and painted(paint, ground)
