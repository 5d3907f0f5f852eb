"""The scale of a picture from its vehicles and all its anchors together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from orthoscale.core.anchors import Anchor
from orthoscale.core.evidence import combined
from orthoscale.core.measuring.anchors import votes_in_plan
from orthoscale.core.pooling.anchors import evidence_of
from orthoscale.core.pooling.posterior import Posterior

SAME_LOG = 0.01  # [ln] two possible scales of an anchor that are this near each other count as one


class Place(NamedTuple):
    """Relative error of a scale, and of the lower and the upper end of its 90 % interval; and whether the anchors were
    taken for the standard that is nearest to the truth."""

    error: float
    low: float
    high: float
    right: bool


def place_of(anchors: Sequence[Anchor], gsd: float, told: float, told_sd: float, country: str) -> Place:
    """The errors of the scale from `anchors` of one kind together with vehicles, whose scale is `told` [m/px] with a
    relative one sigma of `told_sd`; `gsd` [m/px] is the truth."""
    vehicles = Posterior.normal(float(np.log(told)), told_sd)
    (evidence,) = evidence_of(votes_in_plan(anchors, 4 * told_sd), country)
    fused = combined(vehicles, {}, [evidence])
    value, low, high = fused.summary
    off = np.abs(evidence.own.mean - np.log(gsd))
    right = abs(np.log(fused.evidence[0].value / gsd)) <= off.min() + SAME_LOG
    return Place(value / gsd - 1, low / gsd - 1, high / gsd - 1, bool(right))


def held(places: np.ndarray) -> float:
    """Share of `places` (N, 4) whose 90 % interval holds the truth."""
    return float(np.mean((places[:, 1] <= 0) & (places[:, 2] >= 0)))


def half_width(places: np.ndarray) -> float:
    """Median half width of the 90 % intervals of `places` (N, 4)."""
    return float(np.median(places[:, 2] - places[:, 1]) / 2)
