"""Fields of American football, by their lines every five yards, from side line to side line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.anchors import Anchor, Standard, holding
from .combs import Block, Comb, comb_anchor, find_combs, pitch
from .ridges import lightness
from .rules import sizes, within_reach

YARD = 0.9144  # [m]
YARD_LINES = Standard(
    "lines every 5 yards",
    5 * YARD,
    0.004,
    "NFL, NCAA and NFHS football rules, rule 1: lines of 4 in every 5 yards, field 53 1/3 yards wide; Canadian rule 1: "
    "65 yards wide; the spread is ours",
)
WIDTHS = 9.6, 14.5  # limits in pitches: fields are 10.7 wide, in Canada 13, plus a white border of a yard or two
GRID_FALSE = 0.03
FEWEST_YARDS, MOST_YARDS = 8, 27  # lines
YARD_BLOCK = 3.0  # [m] length of a block along the lines
ACROSS_FIELD = 62.0  # [m] of the cross section to either side
YARD_LINE = 0.1  # [m] of paint


@dataclass(frozen=True)
class Gridirons:
    """Finds the yard lines of American football (an `AnchorFinder`) of any of the `standards`."""

    standards: tuple[Standard, ...] = (YARD_LINES,)
    kind = "gridiron"
    extent = 80.0
    finest = 0.12
    coarsest = 0.5

    def find(self, image: np.ndarray, gsd: float, gsd_sd: float, country: str) -> Sequence[Anchor]:
        """See `AnchorFinder.find`."""
        standards = holding(self.standards, country)
        comb = Comb(
            *sizes(standards, gsd, gsd_sd), FEWEST_YARDS, MOST_YARDS, YARD_BLOCK / gsd, ACROSS_FIELD / gsd,
            YARD_LINE / gsd,
        )  # fmt: skip
        found = []
        for blocks in find_combs(image, lightness(image), comb):
            meant = within_reach(standards, pitch(blocks), gsd, gsd_sd)
            if meant and _is_as_wide_as_a_field(blocks):
                found.append(comb_anchor(blocks, self.kind, meant, GRID_FALSE))
        return found


def _is_as_wide_as_a_field(blocks: Sequence[Block]) -> bool:
    """Whether the lines, in units of their pitch, are as long as fields are wide; this needs no scale."""
    ends = np.array([blocks[0].place, blocks[-1].place])
    block = np.linalg.norm(blocks[1].place - blocks[0].place)
    width = (np.linalg.norm(ends[1] - ends[0]) + block) / pitch(blocks)
    return bool(WIDTHS[0] < width < WIDTHS[1])
