"""The outcome of measuring: the scale, the vehicles, and further findings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..anchors import AnchorVote
from ..boxes import Boxes
from ..by_value import ByValue
from ..pooling.agreement import Agreement
from ..projection.own_ruler import OwnRuler
from ..projection.self_calibration import Trends
from ..remarks import Remark, informing
from ..ruler import Ruler
from ..scale import Scale
from ..votes import Votes
from .drift import Drift
from .model_drift import ModelDrift
from .parts import Parts
from .systematic import Systematic
from .vehicles import vehicle_table

LEAST = 0.1  # share of a box's side that is left as the vehicle's, however large the margin


@dataclass(frozen=True)
class SelfCalibration:
    """ruler : fitted to the vehicles' own views. card : that of the detector's card. trends : how sizes still change
    from view to view with either ruler, None for too few views."""

    ruler: OwnRuler
    card: OwnRuler
    trends: Trends | None


@dataclass(frozen=True)
class Findings:
    """What the boxes of one geometry show besides the scale; None where they cannot show it."""

    calibration: SelfCalibration | None = None
    drift: Drift | ModelDrift | None = None


@dataclass(frozen=True, eq=False)
class Pooled(ByValue):
    """The inputs of pooling other than the votes, the fleet and the method.

    ruler : the part of the detector's ruler that has not been corrected for in the votes. systematic : errors common to
    all sizes, from the source's geometry. noise : (N, 2) one-sigmas of the votes, relative to their vehicles' sizes
    (`Measurement.size`). more : further evidence of the scale in the boxes themselves. The defaults are for no votes.
    """

    ruler: Ruler = Ruler()
    systematic: Systematic = field(default_factory=Systematic)
    noise: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    more: Sequence[AnchorVote] = ()


@dataclass(frozen=True, eq=False)
class Measurement(ByValue):
    """The scale of one source by its vehicles, and what it was computed from.

    boxes : all M that were measured. picture : (M,) name of the picture of each. lost : number of boxes that never
    became votes, by reason. size : (N, 2) of the votes' vehicles, the margin taken off [source units].
    projection : name of the projection used. findings : what else the boxes show. pooled : the other inputs of
    pooling. modes : the measurement in each mode of a posed set, by its name; empty for other sources.
    agreement : of the two modes, where both were measured. parts : those of a posed set that share no point, None
    without any. notes : what could not be done.
    """

    boxes: Boxes
    picture: np.ndarray
    votes: Votes
    scale: Scale
    lost: dict[str, int]
    size: np.ndarray
    projection: str
    findings: Findings = field(default_factory=Findings)
    pooled: Pooled = field(default_factory=Pooled)
    modes: Mapping[str, Measurement] = field(default_factory=dict)
    agreement: Agreement | None = None
    parts: Parts | None = None
    notes: tuple[str, ...] = ()

    @cached_property
    def vehicles(self) -> np.ndarray:
        """(N,) one row for each of the votes' vehicles, with its size in metres; see `vehicles.VEHICLE`."""
        return vehicle_table(self.votes, self.size, self.scale, self.boxes, self.picture)

    @property
    def drift(self) -> Drift | ModelDrift | None:
        """How the scale changes from place to place; None where that was not measured, or with too few vehicles."""
        return self.findings.drift

    @property
    def rejected_boxes(self) -> dict[str, int]:
        """Number of boxes that never became votes, by reason; reasons without any are left out."""
        return {reason: count for reason, count in self.lost.items() if count}

    @property
    def remarks(self) -> list[Remark]:
        """The remarks on the scale, the most serious first."""
        return [*self.scale.remarks, *informing(self.notes)]


def without_margin(votes: Votes, margin: Sequence[float] | np.ndarray) -> np.ndarray:
    """(N, 2) sizes of the votes' vehicles, less the boxes' `margin` (2,) [detector px]; always positive."""
    return np.maximum(votes.size - np.asarray(margin) * votes.pixel[:, None], LEAST * votes.size)
