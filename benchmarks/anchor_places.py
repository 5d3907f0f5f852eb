"""What vehicles and all anchors of a picture say together of its scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from orthoscale.core.anchors import Anchor
from orthoscale.core.evidence import combined
from orthoscale.core.measuring.anchors import votes_in_plan
from orthoscale.core.pooling.anchors import evidence_of
from orthoscale.core.pooling.posterior import Posterior

SAME_LOG = 0.01  # [ln] two scales that an anchor may mean are hardly two so near each other


class Place(NamedTuple):
    """Relative error of a scale, and of the lower and the upper end of its 90 % interval; whether the anchors were
    taken for what they come nearest to the truth as."""

    error: float
    low: float
    high: float
    right: bool


def place_of(anchors: Sequence[Anchor], gsd: float, told: float, told_sd: float, country: str) -> Place:
    """That of what `anchors` of one kind say, and vehicles that say `told` [m/px] with a relative one-sigma of
    `told_sd`, where `gsd` [m/px] is true."""
    vehicles = Posterior.normal(float(np.log(told)), told_sd)
    (evidence,) = evidence_of(votes_in_plan(anchors, 4 * told_sd), country)
    fused = combined(vehicles, {}, [evidence])
    value, low, high = fused.summary
    off = np.abs(evidence.own.mean - np.log(gsd))
    right = abs(np.log(fused.evidence[0].value / gsd)) <= off.min() + SAME_LOG
    return Place(value / gsd - 1, low / gsd - 1, high / gsd - 1, bool(right))


def held(places: np.ndarray) -> float:
    """Share of `places` (N, 4) whose 90 % interval has the truth."""
    return float(np.mean((places[:, 1] <= 0) & (places[:, 2] >= 0)))


def half_width(places: np.ndarray) -> float:
    """Median half width of the 90 % intervals of `places` (N, 4)."""
    return float(np.median(places[:, 2] - places[:, 1]) / 2)
