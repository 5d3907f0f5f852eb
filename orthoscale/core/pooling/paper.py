"""The paper's estimator (arXiv 2603.07535), as published: a trimmed mean of the scales of single vehicles."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.special import stdtrit

from ...errors import TooLittleEvidence
from ..fleet import Fleet
from ..normal import Z90
from ..remarks import CAUTION, Remark
from ..scale import Scale
from ..verdicts import verdict
from ..votes import Votes
from .usable import MIN_VEHICLES

NARROW = "the paper's estimator: its interval leaves out the uncertainty of fleet, margin and geometry"
MIN_SCORE = 0.5
WHISKER = 1.5  # interquartile ranges beyond the quartiles within which a value counts


@dataclass(frozen=True)
class PaperScale:
    """Metres per unit of the source, by the paper's estimator.

    value : the mean of the scales that count.
    interval90 : 90 % interval of that mean, from the scatter between vehicles alone (Student's t). It leaves out the
        uncertainty of the fleet, the boxes' margin and the geometry: with many vehicles it is far too narrow.
    used : (N,) bool, which scales count.
    """

    value: float
    interval90: tuple[float, float]
    used: np.ndarray = field(repr=False)

    @property
    def vehicles_used(self) -> int:
        """How many vehicles are left within the whiskers."""
        return int(self.used.sum())


def pool_iqr(
    scales: np.ndarray, scores: np.ndarray, min_score: float = MIN_SCORE, min_vehicles: int = MIN_VEHICLES
) -> PaperScale:
    """One scale from `scales` (N,), metres per unit by each vehicle, whose boxes have `scores` (N,) in 0..1.

    Only scores above `min_score` count. The scale is the mean of their values within ``[Q1 - 1.5 IQR, Q3 + 1.5 IQR]``,
    quartiles interpolated linearly. Scales that are not finite do not count. Raises TooLittleEvidence for fewer than
    `min_vehicles` such scores.
    """
    scales, scores = np.asarray(scales, float), np.asarray(scores, float)
    confident = (scores > min_score) & np.isfinite(scales)
    count = int(confident.sum())
    if count < max(min_vehicles, 1):
        raise TooLittleEvidence(
            f"{count} of {len(scales)} vehicles have a score above {min_score:g}, {min_vehicles} are needed"
        )
    q1, q3 = np.percentile(scales[confident], [25, 75])
    reach = WHISKER * (q3 - q1)
    used = confident & (scales >= q1 - reach) & (scales <= q3 + reach)
    kept = scales[used]
    value = float(kept.mean())
    half = float(stdtrit(len(kept) - 1, 0.95) * kept.std(ddof=1) / np.sqrt(len(kept))) if len(kept) > 1 else np.inf
    return PaperScale(value, (value - half, value + half), used)


def pool_paper(votes: Votes, fleet: Fleet, unit: str) -> Scale:
    """The paper's scale from `votes`: each vehicle gives the mean of the scales by its length and by its width, with
    the mean size of `fleet` (``PAPER`` has the paper's own). No margin is taken off the boxes.

    Raises TooLittleEvidence.
    """
    by_side = fleet.mean[:2] / votes.size
    each = by_side.mean(1)
    found = pool_iqr(each, votes.score)
    low, high = found.interval90
    if not low > 0:
        raise TooLittleEvidence(f"the vehicles scatter so much that the mean of {found.used.sum()} gives no scale")
    sd = (high - low) / (2 * Z90 * found.value)
    reasons = ["" if u else f"score of {MIN_SCORE:g} or less" for u in found.used]
    for k in np.flatnonzero(~found.used & (votes.score > MIN_SCORE)):
        reasons[k] = "beyond the whiskers, too " + ("small" if each[k] > found.value else "large")
    length, width = by_side[found.used].mean(0)
    return Scale(
        value=found.value,
        unit=unit,
        interval90=found.interval90,
        parts={"sampling": sd},
        checks={"length": float(length), "width": float(width)},
        weights=(0.5, 0.5),
        tension=0.0,
        fleet=fleet.code,
        verdict=verdict(sd, odd_shape=False, conflict=False),
        used=found.used,
        reasons=reasons,
        remarks=(Remark(CAUTION, NARROW),),
        fleets={fleet.code: 1.0},
    )
