"""The protocol `Geometry`: how the boxes of one kind of picture relate to vehicles on the ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ..anchors import AnchorVote
from ..boxes import Boxes
from ..ruler import Ruler
from ..scale import Scale
from ..votes import Votes
from .measurement import Findings
from .surroundings import Standards
from .systematic import Systematic


@dataclass(frozen=True)
class Observation:
    """What M boxes measure, if a unit of the source is so many metres as the geometry was told.

    size : (M, 2) length and width of the vehicles on the ground [source units], NaN where no vehicle gives the box.
    ruler : what is left of the detector's ruler to take off, and how well that is known.
    systematic : by what all of them err alike.
    ground : (M,) relative one-sigmas of the sizes by what is not known of the ground's height under each box.
    """

    size: np.ndarray
    ruler: Ruler
    systematic: Systematic = Systematic()
    ground: np.ndarray | None = None

    @cached_property
    def solved(self) -> np.ndarray:
        """(M,) bool, whether a vehicle on the ground explains the box."""
        return np.isfinite(self.size).all(1)


def larger_by(other: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(2,) by how much the lengths and widths `other` (M, 2) are larger than `size` (log, median); 0 where no box has a
    size of both: that of boxes which no vehicle gives is NaN, or below 0."""
    ok = ((size > 0) & (other > 0)).all(1)
    return np.median(np.log(other[ok] / size[ok]), axis=0) if ok.any() else np.zeros(2)


class Geometry(Protocol):
    """M boxes of one source, and what they measure on its ground.

    unit : of its lengths, as a scale's. projection : what it is called, one of `method.PROJECTIONS`.
    boxes : M of them, all that can be measured. called : what these are, for people.
    picture : (M,) name of the picture of each. pixel : (M,) ground size of one detector pixel [source units].
    place : (M, D) where they stand [source units]. lost : boxes that cannot be measured, by reason.
    repeated : whether pictures show vehicles again, so that boxes in one place are one vehicle.
    typical_length : median length of the boxes [source units], with which the rounds begin.
    rounds : of measuring and pooling, at most. settled : relative change of the scale at which they end.
    """

    @property
    def unit(self) -> str: ...
    @property
    def projection(self) -> str: ...
    @property
    def boxes(self) -> Boxes: ...
    @property
    def called(self) -> str: ...
    @property
    def picture(self) -> np.ndarray: ...
    @property
    def pixel(self) -> np.ndarray: ...
    @property
    def place(self) -> np.ndarray: ...
    @property
    def lost(self) -> Mapping[str, int]: ...
    @property
    def repeated(self) -> bool: ...
    @property
    def typical_length(self) -> float: ...
    @property
    def rounds(self) -> int: ...
    @property
    def settled(self) -> float: ...

    def observe(self, metres_per_unit: float) -> Observation:
        """What the boxes measure; the scale enters through the vehicles' height."""
        ...

    def shown(self, place: np.ndarray) -> np.ndarray | None:
        """(N,) number of pictures that were looked at and have the places (N, D) in view; None where one shows all."""
        ...

    def surroundings(
        self, seen: Observation, vehicles: Votes, metres_per_unit: float, standards: Standards, country: str
    ) -> Sequence[AnchorVote]:
        """What else the pictures show of the scale; `vehicles` are the votes without the detector's margin."""
        ...

    def refined(self, seen: Observation, votes: Votes, scale: Scale) -> Geometry:
        """The same after what the vehicles tell of it themselves, for the next round."""
        ...

    def findings(self, seen: Observation, vehicles: Votes, scale: Scale) -> Findings:
        """What the boxes tell besides the scale."""
        ...
