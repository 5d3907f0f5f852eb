"""From boxes to the scale: projection onto the ground, one vote per vehicle, pooling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ...evidence.surroundings import orthophoto_evidence
from ..boxes import Boxes
from ..detections import Detections
from ..fleet import Fleet
from ..projection.planar import ground_size
from ..scale import Scale
from ..votes import Votes, gather
from .method import Method
from .vehicles import vehicle_table

if TYPE_CHECKING:
    from ...sources.source import Source
    from ..pooling.agreement import Agreement


LEAST = 0.1  # of a box's side that is taken for the vehicle's at least, however large the margin


@dataclass(frozen=True)
class Measured:
    """What one way of measuring gives.

    boxes : all that were measured, M of them. picture : (M,) name of the picture of each. lost : boxes that never
    became votes, by reason. findings : what else the report should hold, as plain values by topic.
    size : (N, 2) of the votes' vehicles, the margin taken off [source units].
    agreement : with the other way to measure the same source, where there was one. notes : what could not be done.
    """

    boxes: Boxes
    picture: np.ndarray
    votes: Votes
    scale: Scale
    lost: dict[str, int]
    findings: dict[str, Any]
    size: np.ndarray
    agreement: Agreement | None = None
    notes: tuple[str, ...] = ()

    @cached_property
    def vehicles(self) -> np.ndarray:
        """(N,) one row for each of the votes' vehicles, in metres too, see `vehicles.VEHICLE`."""
        return vehicle_table(self.votes, self.size, self.scale, self.boxes, self.picture)


def measure(source: Source, found: Detections, fleet: Fleet, method: Method | None = None) -> Measured:
    """Measure the vehicles of one picture that shows the ground from straight above. Raises TooLittleEvidence."""
    method = method or Method()
    (name,) = source.picture_names
    boxes = found.boxes.get(name, Boxes.empty())
    votes = gather(
        ground_size(boxes), np.full(len(boxes), 1 / found.zoom), boxes.centre, boxes.score, False, boxes.spread
    )
    objects = found.objects.get(name, {})
    more = orthophoto_evidence(votes, boxes.angle, objects, found.zoom, found.ruler, fleet.code)
    scale = method.pool(votes, fleet, found.ruler, source.unit, more=more if method.surroundings else ())
    return Measured(boxes, np.full(len(boxes), name), votes, scale, doubts(found), {}, tight(votes, found.ruler.margin))


def tight(votes: Votes, margin: Sequence[float] | np.ndarray) -> np.ndarray:
    """(N, 2) sizes of the vehicles behind the votes, without the boxes' `margin` (2,) [detector px]; never nothing."""
    return np.maximum(votes.size - np.asarray(margin) * votes.pixel[:, None], LEAST * votes.size)


def doubts(found: Detections) -> dict[str, int]:
    """Boxes that were seen but not believed, by reason."""
    return {found.doubt: sum(map(len, found.doubtful.values()))}
