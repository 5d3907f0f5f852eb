"""The outcome of measuring: the scale, the vehicles, and further findings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..anchors import AnchorVote
from ..boxes import Boxes
from ..pooling.agreement import Agreement
from ..projection.own_ruler import OwnRuler
from ..projection.self_calibration import Trends
from ..remarks import INFO, Remark
from ..ruler import Ruler
from ..scale import Scale
from ..votes import Votes
from .drift import Drift
from .model_drift import ModelDrift
from .systematic import Systematic
from .vehicles import vehicle_table

LEAST = 0.1  # of a box's side that is taken for the vehicle's at least, however large the margin


@dataclass(frozen=True)
class SelfCalibration:
    """ruler : as fitted to the vehicles' own views. card : as in the detector's card. trends : what remains with either
    ruler, None for too few views."""

    ruler: OwnRuler
    card: OwnRuler
    trends: Trends | None


@dataclass(frozen=True)
class Findings:
    """What the boxes of one geometry show beside the scale, where they can. shared : as in `systematic.Systematic`."""

    calibration: SelfCalibration | None = None
    drift: Drift | ModelDrift | None = None
    shared: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Pooled:
    """The inputs of pooling other than the votes, the fleet and the method.

    ruler : the part that the votes still contain. systematic : errors common to all sizes, from the source's geometry.
    noise : (N, 2) one-sigmas of the votes, as shares of their vehicles' sizes (`Measurement.size`). more : evidence on
    the scale in the boxes themselves. By default that of no votes.
    """

    ruler: Ruler = Ruler()
    systematic: Systematic = Systematic()
    noise: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    more: Sequence[AnchorVote] = ()


@dataclass(frozen=True)
class Measurement:
    """What the vehicles of one source say.

    boxes : all that were measured, M of them. picture : (M,) name of the picture of each. lost : boxes that never
    became votes, by reason. size : (N, 2) of the votes' vehicles, the margin taken off [source units].
    projection : how they were seen. found : what they tell besides the scale.
    pooled : what with.
    modes : by name, each way in which a posed set was measured; empty for other sources.
    agreement : of two ways, where there were two. notes : what could not be done.
    """

    boxes: Boxes
    picture: np.ndarray
    votes: Votes
    scale: Scale
    lost: dict[str, int]
    size: np.ndarray
    projection: str
    found: Findings = field(default_factory=Findings)
    pooled: Pooled = field(default_factory=Pooled)
    modes: Mapping[str, Measurement] = field(default_factory=dict)
    agreement: Agreement | None = None
    notes: tuple[str, ...] = ()

    @cached_property
    def vehicles(self) -> np.ndarray:
        """(N,) one row for each of the votes' vehicles, in metres too, see `vehicles.VEHICLE`."""
        return vehicle_table(self.votes, self.size, self.scale, self.boxes, self.picture)

    @property
    def drift(self) -> Drift | ModelDrift | None:
        """How the scale changes from place to place, if there are enough vehicles to tell."""
        return self.found.drift

    @property
    def rejected_boxes(self) -> dict[str, int]:
        """Boxes that never became votes, by reason."""
        return {reason: count for reason, count in self.lost.items() if count}

    @property
    def remarks(self) -> list[Remark]:
        """The remarks on the scale, the most serious first."""
        return [*self.scale.remarks, *(Remark(INFO, note) for note in self.notes)]


def tight(votes: Votes, margin: Sequence[float] | np.ndarray) -> np.ndarray:
    """(N, 2) sizes of the vehicles behind the votes, less the boxes' `margin` (2,) [detector px]; always positive."""
    return np.maximum(votes.size - np.asarray(margin) * votes.pixel[:, None], LEAST * votes.size)
