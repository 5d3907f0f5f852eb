"""Whether a place may be one where most vehicles are of one class."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

import numpy as np

from ..fleet import MOSTLY, Fleet
from ..remarks import CAUTION, Remark, signed
from ..ruler import Ruler
from ..votes import Votes
from .of_fleets import FEW, of_fleets
from .usable import usable

# A place where most vehicles are of one class is proposed where that explains the sizes so many times better [nats]
# than the country's mix, and changes the scale by so much: at half of simulated lots with 60 % minis in Germany, 0 to 8
# % of usual ones, and wrongly at 3 of 190 real scenes (benchmarks/results/pooling.md, "Odd places").
PROPOSED, CHANGES = 2.0, 0.05
RARE = (0.025, 0.35)  # shares of a class that may be proposed: what is commoner dominates many places


def proposed_class(
    votes: Votes, fleet: Fleet, ruler: Ruler, of_geometry: np.ndarray | None = None, named: str = ""
) -> Iterator[Remark]:
    """The remark that most vehicles may be of one class that is rare in `fleet`, where their sizes suit that better.

    Only the user can say so: by sizes alone such a place hardly differs from one of other classes at another scale, and
    it is rare. named : what the user calls the fleet, if not by its code. Other arguments as of `robust.pool`, and the
    same error.
    """
    if fleet.candidates or any(c.weight >= MOSTLY for c in fleet.classes):
        return
    _, seen, known = usable(votes, ruler, of_geometry)
    names = [c.name for c in fleet.classes if RARE[0] < c.weight < RARE[1]]
    usual, *each = of_fleets(seen.few(FEW), [fleet, *map(fleet.mostly, names)], known)
    if usual is None:
        return
    found = {name: one for name, one in zip(names, each, strict=True) if one is not None}
    likeliest = max(found, key=lambda name: found[name].log_evidence, default="")
    if not likeliest or found[likeliest].log_evidence < usual.log_evidence + PROPOSED:
        return
    change = found[likeliest].posterior.centre - usual.posterior.centre
    if abs(change) > CHANGES:
        yield Remark(
            CAUTION,
            f"the sizes suit a place where most vehicles are of the class {likeliest} better than the mix of fleet "
            f"{fleet.code}, and that would change the scale by {signed(np.expm1(change))}: if the picture shows that "
            f"they are, name it with --fleet {shlex.quote(f'{named or fleet.code}:{likeliest}')}",
        )
