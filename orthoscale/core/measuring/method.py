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

# How each projection is done, by the names that the paper gives. For frames; an orthophoto's is always planar.
VARIANTS_BY_NAME = {
    "exact": None,
    "planar": None,  # on the true ground, but without a height
    "decoupled": decoupled.TEXT,
    "program": decoupled.PROGRAM,
    "naive": decoupled.NAIVE,
}


@dataclass(frozen=True)
class Method:
    """projection : of VARIANTS_BY_NAME; None is what fits the source. estimator : ``robust``, or the paper's ``iqr``.

    evidence : what is known of the scale besides the vehicles. anchors : what was found in the pictures.
    standards : by which parking rows and objects of standard size count, where the boxes show them;
    None leaves them out. country : ISO code of two letters, by which anchors are told apart; empty where not known.
    own : a user's standards by kind, which take the place of others.
    `requests.EstimateRequest` has checked them.
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
        """Whether nothing but vehicles enters the scale: by the paper's estimator."""
        return self.estimator == "iqr"

    def pool(
        self,
        votes: Votes,
        fleet: Fleet,
        ruler: Ruler,
        unit: str,
        geometry: np.ndarray | None = None,
        more: Sequence[AnchorVote] = (),
    ) -> Scale:
        """The scale; `more` are anchors that the boxes themselves show."""
        if self.vehicles_only:
            return pool_paper(votes, fleet, unit)
        seen = [vote.of(self.own.get(vote.anchor.kind)) for vote in (*self.anchors, *more)]
        return pool(votes, fleet, ruler, unit, geometry, self.evidence, seen, self.country)
