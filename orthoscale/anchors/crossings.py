"""Zebra crossings, by the period of their stripes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.anchors import Anchor, Standard
from .ladders import Ladder, crowded, find_ladders, levels, refined
from .repeated import anchor_of
from .rules import holding, ruled, sizes, within_reach
from .strokes import find_strokes, paint_light, painted

ZEBRA_PAINTED = 0.015  # one sigma of a crossing's period about its rule: those of two Chinese towns, 0.98 to 1.01 m
ZEBRA_ABOUT = 0.03  # where the rule gives a range, or was only recalled

ZEBRA_STANDARDS = (
    Standard(
        "stripes 0.50 m, gaps 0.50 m",
        1.00,
        ZEBRA_PAINTED,
        "RMS (Germany), colliseum.eu; DPR 495/1992 art. 145 (Italy): stripes and gaps of 50 cm",
        countries=("DE", "IT"),
    ),
    Standard(
        "stripes 0.40 m, gaps 0.60 m",
        1.00,
        ZEBRA_PAINTED,
        "GB 5768.3 (China), hold-in.cn; CONTRAN (Brazil), euquerosabertudo.com",
        countries=("CN", "BR"),
    ),
    Standard(
        "stripes 0.45 m, gaps 0.45 m",
        0.90,
        ZEBRA_PAINTED,
        "order on road signs (Japan), sign 201: stripes and gaps of 45 to 50 cm",
        countries=("JP",),
    ),
    Standard(
        "stripes 0.50 m, gaps 0.50 m",
        1.00,
        ZEBRA_PAINTED,
        "order on road signs (Japan), sign 201: stripes and gaps of 45 to 50 cm",
        countries=("JP",),
    ),
    Standard(
        "stripes 0.50 m, gaps 0.50 m",
        1.00,
        ZEBRA_PAINTED,
        "IISR part 7 art. 118 (France): stripes of 0.50 m, 0.50 to 0.80 m apart",
        0.6,
        ("FR",),
    ),
    Standard(
        "stripes 0.50 m, gaps 0.60 to 0.80 m",
        1.20,
        0.05,
        "IISR part 7 art. 118 (France): stripes of 0.50 m, 0.50 to 0.80 m apart",
        0.4,
        ("FR",),
    ),
    Standard(
        "stripes 0.60 m, gaps 0.60 m",
        1.20,
        ZEBRA_PAINTED,
        "AS 1742 (Australia); New Zealand from 2021, Walking New Zealand 3/2021: stripes of 600 mm",
        countries=("AU", "NZ"),
    ),
    Standard("stripes and gaps of about 0.50 m", 1.00, ZEBRA_ABOUT, "most of the rules above", 0.8),
    Standard(
        "stripes and gaps of about 0.60 m", 1.20, ZEBRA_ABOUT, "rules of Australia and New Zealand, some of France", 0.2
    ),
)
ZEBRA_FREE = ("US", "CA", "GB", "IE", "MX")
"""Where the rules leave the period to the painter: MUTCD 3B.18 has bars of 12 to 24 inches, gaps of 12 to 60; TSRGD
has stripes of 500 to 715 mm. Nothing is searched there."""

ZEBRA_FALSE = 0.05  # three of 100 finds in 120 Mpx were louvres of one facade, seen askew, which are told apart since
ZEBRA_FOREIGN = 0.2  # where no rule of the country is known

STRIPE_SIGMA = 0.19  # of the ridges' smoothing [m]: a third to a half of a stripe
ZEBRA_SHORTEST, ZEBRA_LONGEST = 1.8, 11.0  # of stripes [m]
ZEBRA_FEWEST = 5  # stripes
ZEBRA_FILLED = 0.65  # of the places taken: vehicles hide stripes
ZEBRA_REGULAR = 1.5  # natural logarithm of how much likelier such a row is as one than by chance
ZEBRA_ASKEW = 0.25  # of their length: how far stripes are shifted along themselves, rms; facades seen askew
ZEBRA_CROWDED = 0.1  # of the gaps with a stripe between
ZEBRA_CONTRAST = 15.0  # grey levels between stripes and ground
ZEBRA_SAME_GROUND = 0.45  # of the contrast: how far the ground past the stripes may differ from that between
ZEBRA_PAST = 0.7  # of the ends, where that ground is seen [m]


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
    """Whether its stripes are painted on a road: bright, and the same ground between them as past both ends."""
    if ladder.row.filled < ZEBRA_FILLED or ladder.row.regularity < ZEBRA_REGULAR or ladder.askew > ZEBRA_ASKEW:
        return False
    seen = levels(image, ladder, ladder.row.period / 2, ZEBRA_PAST / gsd)
    paint, ground = np.median(seen.paint, axis=0), np.median(seen.ground, axis=0)
    contrast = float((paint - ground)[:2].mean())
    past = np.median(seen.beyond, axis=1)  # (2, 3)
    same = np.abs(past - ground)[:, :2].mean(1) < ZEBRA_SAME_GROUND * contrast
    return contrast > ZEBRA_CONTRAST and bool(same.all()) and painted(paint, ground)
