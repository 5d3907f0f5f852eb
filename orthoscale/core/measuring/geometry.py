"""The protocol `Geometry`: how the boxes of one kind of picture relate to vehicles on the ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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
    """The sizes of M boxes on the ground, at an assumed scale.

    size : (M, 2) length and width of the vehicles on the ground [source units], NaN where no vehicle on the ground fits
    the box. ruler : the part of the detector's ruler that has not been corrected for in `size`, with its uncertainty.
    systematic : the errors common to all sizes. lasting : (M, 2) relative one-sigmas of the errors that do not average
    out over the views of one vehicle: from the ground's height under it, and from how high its boxes reach.
    """

    size: np.ndarray
    ruler: Ruler
    systematic: Systematic = field(default_factory=Systematic)
    lasting: np.ndarray | None = None

    @cached_property
    def solved(self) -> np.ndarray:
        """(M,) bool, whether a vehicle on the ground explains the box."""
        return np.isfinite(self.size).all(1)


def larger_by(other: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(2,) median log ratio of the lengths and widths `other` (M, 2) to `size` (M, 2), over the boxes that have both; 0
    without any. A box that no vehicle fits has a size of NaN, or below 0."""
    ok = ((size > 0) & (other > 0)).all(1)
    return np.median(np.log(other[ok] / size[ok]), axis=0) if ok.any() else np.zeros(2)


class Geometry(Protocol):
    """M boxes of one source, and their projection onto the ground.

    unit : of the scale ("m/px"). projection : its name, of `method.VARIANTS_BY_NAME`. boxes : all M that can be
    measured. called : what messages call them. picture : (M,) name of the picture of each. pixel : (M,) ground size of
    one detector pixel [source units]. place : (M, D) positions [source units]. lost : number of boxes that cannot be
    measured, by reason. repeated : whether several pictures show the same vehicles, so that boxes in one place are one
    vehicle. typical_length : median length of the boxes [source units], from which the first scale is estimated.
    rounds : largest number of rounds of measuring and pooling. settled : relative change of the scale below which they
    end.
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
        """The sizes of the boxes on the ground; they depend on the scale through the vehicles' height."""
        ...

    def shown(self, place: np.ndarray) -> np.ndarray | None:
        """(N,) number of processed pictures that show each place (N, D); None where one picture shows all."""
        ...

    def surroundings(
        self, seen: Observation, vehicles: Votes, metres_per_unit: float, standards: Standards, country: str
    ) -> Sequence[AnchorVote]:
        """Other evidence of the scale in the boxes; `vehicles` are the votes without the detector's margin."""
        ...

    def refined(self, seen: Observation, votes: Votes, scale: Scale) -> Geometry:
        """The geometry after self-calibration by the vehicles, for the next round."""
        ...

    def findings(self, seen: Observation, vehicles: Votes, scale: Scale) -> Findings:
        """What the boxes show besides the scale."""
        ...
