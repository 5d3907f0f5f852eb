"""Running tracks, by the width of their lanes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.anchors import Anchor, Standard, holding
from .combs import Block, Comb, comb_anchor, find_combs, pitch
from .ridges import lightness
from .rules import sizes, within_reach

LANE_BUILT = 0.008  # relative one sigma of a track's mean lane about its rule: World Athletics allows 0.01 m in 1.22

LANES = (
    Standard(
        "lanes of 1.22 m",
        1.22,
        LANE_BUILT,
        "World Athletics, Technical Rule 14.4: 1.22 m, to 0.01 m, with the line on the right",
    ),
    Standard("lanes of 1.25 m", 1.25, LANE_BUILT, "IAAF rule 160 until 2003: 1.22 to 1.25 m", 0.1),
    Standard("lanes of 1.22 m, US", 1.22, LANE_BUILT, "World Athletics, Technical Rule 14.4", 0.6, ("US",)),
    Standard("lanes of 42 in", 1.0668, LANE_BUILT, "NFHS Track and Field, rule 1-2: 42 in preferred", 0.4, ("US",)),
)

TRACK_FALSE = 0.1  # where only a straight is seen
TRACK_FALSE_ROUND = 0.03  # where a bend is seen, too

FEWEST_LINES, MOST_LINES = 6, 11
LANE_BLOCK = 3.0  # [m] length of a block along the lanes
TO_SIDES = 14.0  # [m] of the cross section to either side
LANE_LINE = 0.05  # [m] of paint
TRACK_BEND = 26.0, 60.0  # [m] limits of the radius of a bend: 36.5 at the kerb
ROUND_FOR = np.radians(40)  # least turn in all


@dataclass(frozen=True)
class RunningTracks:
    """Finds the lanes of running tracks (an `AnchorFinder`) of any of the `standards`."""

    standards: tuple[Standard, ...] = LANES
    kind = "running track"
    extent = 60.0
    finest = 0.08
    coarsest = 0.3

    def find(self, image: np.ndarray, gsd: float, gsd_sd: float, country: str) -> Sequence[Anchor]:
        """See `AnchorFinder.find`."""
        standards = holding(self.standards, country)
        comb = Comb(
            *sizes(standards, gsd, gsd_sd),
            FEWEST_LINES,
            MOST_LINES,
            LANE_BLOCK / gsd,
            TO_SIDES / gsd,
            LANE_LINE / gsd,
        )
        found = []
        for blocks in find_combs(image, lightness(image), comb):
            meant = within_reach(standards, pitch(blocks), gsd, gsd_sd)
            if meant:
                false = TRACK_FALSE_ROUND if _is_round(blocks, gsd) else TRACK_FALSE
                found.append(comb_anchor(blocks, self.kind, meant, false))
        return found


def _is_round(blocks: Sequence[Block], gsd: float) -> bool:
    """Whether the blocks go round a bend."""
    turn = np.diff(np.unwrap([2 * block.heading for block in blocks])) / 2
    step = np.linalg.norm(np.diff([block.place for block in blocks], axis=0), axis=1) * gsd
    low, high = TRACK_BEND
    bent = (np.abs(turn) * low < step) & (np.abs(turn) * high > step)
    return bool(np.abs(turn[bent].sum()) > ROUND_FOR)
