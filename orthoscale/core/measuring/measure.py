"""The measuring loop: project boxes onto the ground, merge them into votes and pool these, until the scale settles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...errors import TooLittleEvidence
from ..anchors import AnchorVote
from ..fleet import Fleet
from ..pooling.usable import MIN_VEHICLES, vote_noise
from ..remarks import amount
from ..votes import Sightings, gather
from .geometry import Geometry
from .measurement import Measurement, Pooled, without_margin
from .method import Method

NO_HULL = "no vehicle on the ground gives this box"


def measure(geometry: Geometry, fleet: Fleet, method: Method | None = None) -> Measurement:
    """The scale at which the boxes of `geometry` are vehicles of `fleet`. Raises TooLittleEvidence.

    The size of a box on the ground depends on the vehicle's height, and so on the scale that is sought. The height's
    share of a box is small, so a few rounds of measuring and pooling suffice.
    """
    method = method or Method()
    boxes = geometry.boxes
    if len(boxes) < MIN_VEHICLES:
        raise TooLittleEvidence(f"{amount(len(boxes), geometry.called)}, {MIN_VEHICLES} are needed")
    metres_per_unit = float(fleet.mean[0] / geometry.typical_length)
    for rounds_left in reversed(range(geometry.rounds)):
        seen = geometry.observe(metres_per_unit)
        solved = seen.solved
        if solved.sum() < MIN_VEHICLES:
            raise TooLittleEvidence(
                f"{amount(int(solved.sum()), 'boxes')} that fit a vehicle, {MIN_VEHICLES} are needed"
            )
        sightings = Sightings(
            size=seen.size,
            pixel=geometry.pixel,
            place=geometry.place,
            score=boxes.score,
            sigma=boxes.sigma,
            kinds=boxes.kinds,
            lasting=seen.lasting,
            picture=geometry.picture,
        )
        votes = gather(sightings[solved], geometry.repeated)
        votes = replace(votes, shown=geometry.shown(votes.place))
        vehicles = replace(votes, size=without_margin(votes, seen.ruler.margin))
        more: Sequence[AnchorVote] = ()
        if method.standards is not None:
            country = method.country or fleet.code
            more = geometry.surroundings(seen, vehicles, metres_per_unit, method.standards, country)
        scale = method.pool(votes, fleet, seen.ruler, geometry.unit, seen.systematic.covariance, more)
        change = abs(np.log(scale.value / metres_per_unit))
        metres_per_unit = scale.value
        if change < geometry.settled or not rounds_left:
            break
        geometry = geometry.refined(seen, votes, scale)
    return Measurement(
        boxes=boxes[solved],
        picture=geometry.picture[solved],
        votes=votes,
        scale=scale,
        lost={**geometry.lost, NO_HULL: int((~solved).sum())},
        size=vehicles.size,
        projection=geometry.projection,
        findings=geometry.findings(seen, vehicles, scale),
        pooled=Pooled(seen.ruler, seen.systematic, vote_noise(votes, seen.ruler) / vehicles.size, more),
    )
