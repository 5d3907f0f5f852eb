"""How boxes become a scale: the projection, the estimator, and the evidence besides the vehicles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..anchors import AnchorVote, Standard
from ..evidence import Evidence
from ..fleet import Fleet
from ..pooling.paper import pool_paper
from ..pooling.robust import pool
from ..projection import decoupled
from ..ruler import Ruler
from ..scale import Scale
from ..votes import Votes
from .surroundings import Standards

# The variant of the decoupled projection by the projection's name, as in the paper; None for the others. Only frames
# have a choice: an orthophoto's projection is always planar.
VARIANTS_BY_NAME = {
    "exact": None,
    "planar": None,  # on the true ground, but for vehicles without height
    "decoupled": decoupled.TEXT,
    "program": decoupled.PROGRAM,
    "naive": decoupled.NAIVE,
}


@dataclass(frozen=True)
class Method:
    """projection : of VARIANTS_BY_NAME; None for the one that fits the source. estimator : ``robust``, or the paper's
    ``iqr``.

    evidence : what is known of the scale besides the vehicles. anchors : those found in the pictures. standards : sizes
    of parking stalls and other objects, so that boxes of these count as well; None leaves them out. country : ISO code
    of two letters, whose standards anchors follow; empty where not known. own : the user's standards by kind, which
    replace others. `requests.EstimateRequest` has validated all of this.
    """

    projection: str | None = None
    estimator: str = "robust"
    evidence: tuple[Evidence, ...] = ()
    anchors: tuple[AnchorVote, ...] = ()
    standards: Standards | None = None
    country: str = ""
    own: Mapping[str, tuple[Standard, ...]] = field(default_factory=dict)

    @property
    def vehicles_only(self) -> bool:
        """Whether only vehicles enter the scale, as with the paper's estimator."""
        return self.estimator == "iqr"

    def pool(
        self,
        votes: Votes,
        fleet: Fleet,
        ruler: Ruler,
        unit: str,
        of_geometry: np.ndarray,
        more: Sequence[AnchorVote],
    ) -> Scale:
        """The scale. of_geometry : (2, 2) relative covariance of lengths and widths, of errors common to all sizes.
        more : anchors that the boxes themselves show."""
        if self.vehicles_only:
            return pool_paper(votes, fleet, unit)
        seen = [vote.of(self.own.get(vote.anchor.kind)) for vote in (*self.anchors, *more)]
        return pool(votes, fleet, ruler, unit, of_geometry, self.evidence, seen, self.country)
