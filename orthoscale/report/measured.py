"""A measured source: what was found in it, and how."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ..core.detections import Detections
from ..core.fleet import Fleet
from ..core.measuring.anchors import FoundAnchors
from ..core.measuring.measurement import Measurement
from ..core.measuring.method import Method
from ..core.remarks import SEVERITIES, Remark, informing
from ..core.source import Source
from ..sources.on_map import OnMap


@dataclass(frozen=True, repr=False)
class MeasuredSource:
    """All that a report says about one source.

    seconds : duration. settings : the options as plain values, to repeat the measurement. anchors : those that were
    found. on_map : where the source lies on the map of --against. given : the files and folders that the options name.
    created : when it was measured, which all its reports say alike.
    """

    source: Source
    fleet: Fleet
    detections: Detections
    seconds: float
    measured: Measurement = field(repr=False)
    method: Method = field(default_factory=Method)
    settings: dict[str, Any] = field(default_factory=dict)
    anchors: FoundAnchors = field(default_factory=FoundAnchors, repr=False)
    on_map: OnMap = field(default_factory=OnMap, repr=False)
    given: Sequence[Path] = ()
    created: datetime = field(default_factory=lambda: datetime.now(UTC), repr=False, compare=False)

    @property
    def remarks(self) -> list[Remark]:
        """What a reader should know besides the figures, the gravest first; those of one severity in this order: of the
        core, from opening the source, from finding vehicles."""
        said = [*self.measured.remarks, *self.source.notes, *informing(self.detections.notes)]
        return sorted(said, key=lambda remark: SEVERITIES.index(remark.severity))
