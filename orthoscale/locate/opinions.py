"""The two measurements of a photo's scale: by its vehicles, and by the map with which it was matched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.evidence import BY_MAP, CONFLICT_LIMIT, Evidence
from ..core.pooling.combining import combined
from ..core.pooling.posterior import Posterior
from ..core.scale import PER_PIXEL
from ..photos.measure import Interval90
from .claimed import BY_WORD, ClaimedScale


@dataclass(frozen=True)
class Opinions:
    """Average GSDs of one photo [m/px], each with its 90 % interval.

    claimed : before the search, from `by` (vehicles or a given GSD). matched : by the map. together : both combined,
    None where they contradict. sigmas : the distance between them.
    """

    claimed: Interval90
    by: str
    matched: Interval90
    together: Interval90 | None
    sigmas: float

    @property
    def contradict(self) -> bool:
        """Whether they cannot both be right."""
        return self.sigmas > CONFLICT_LIMIT

    @property
    def said(self) -> str:
        """Whether the two agree, in words."""
        verb = "contradict each other" if self.contradict else "agree"
        ratio = self.claimed.value / self.matched.value
        who = "given GSD" if self.by == BY_WORD else self.by
        return f"the {who} and the map {verb}: ratio {ratio:.3f}, {self.sigmas:.1f} sigmas apart"


def opinions(claimed: ClaimedScale, factor: float, factor_sd: float) -> Opinions:
    """The two scales of a photo whose ground is `factor` times as large as claimed, with relative one sigma
    `factor_sd`."""
    value = claimed.gsd.value * factor
    matched = Interval90.log_normal(value, factor_sd)
    before = Posterior.normal(float(np.log(claimed.gsd.value)), claimed.sd)
    evidence = Evidence(BY_MAP, value, factor_sd, "the map's scale, by the match")
    both = combined(before, {claimed.by: claimed.sd}, [evidence], PER_PIXEL)
    sigmas = abs(float(np.log(factor))) / float(np.hypot(claimed.sd, factor_sd))
    together = None if both.conflict else Interval90(*both.summary)
    return Opinions(claimed.gsd, claimed.by, matched, together, sigmas)
