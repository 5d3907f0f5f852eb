"""Measures vehicles in a plan: an orthophoto shows footprints, so a box less its margin has the size of a vehicle."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..anchors import AnchorVote
from ..boxes import Boxes
from ..detections import Detections
from ..projection.planar import ground_size
from ..ruler import Ruler
from ..scale import Scale
from ..source import Plan
from ..votes import Votes
from .drift import drift
from .geometry import Geometry, Observation
from .measurement import Findings
from .surroundings import Standards, objects_in_plan, rows_in_plan
from .systematic import Systematic
from .vehicles import vehicle_table

# Relative one-sigma of sizes per unit of log aspect of the plan's pixels: the error that `ground_size` leaves. In
# pixels that are not square, a vehicle at an angle is not a rectangle, and the networks were not trained on such
# shapes. Four orthophotos warped to degrees (aspects of 0.53 to 0.87) are left with an error of 0.1 per unit.
SQUEEZED_SD = 0.15


@dataclass(frozen=True)
class PlanGeometry:
    """A `Geometry` whose unit is the plan's pixel; if pixels are not square, a square one of the same area.

    size : width and height of the plan [px]. aspect : how many times as wide as high a pixel is on the ground.
    objects : boxes of other classes than vehicles, by class. zoom : detector pixels per picture pixel.
    """

    boxes: Boxes
    picture: np.ndarray
    unit: str
    size: tuple[int, int]
    aspect: float
    zoom: float
    ruler: Ruler
    objects: Mapping[str, Boxes]
    lost: Mapping[str, int]
    projection: str = "planar"
    called: str = "usable vehicles"
    repeated: bool = False
    rounds: int = 1  # footprints have no height
    settled: float = 0.0

    @classmethod
    def of(cls, source: Plan, found: Detections) -> PlanGeometry:
        """The geometry of the boxes `found` in an orthophoto."""
        boxes = found.boxes.get(source.name, Boxes.empty())
        return cls(
            boxes=boxes,
            picture=np.full(len(boxes), source.name),
            unit=source.unit,
            size=(source.width, source.height),
            aspect=source.claimed.aspect,
            zoom=found.zoom,
            ruler=found.ruler,
            objects=found.objects.get(source.name, {}),
            lost=found.uncounted,
        )

    @property
    def pixel(self) -> np.ndarray:
        """(M,) picture pixels per detector pixel, the same everywhere."""
        return np.full(len(self.boxes), 1 / self.zoom)

    @property
    def place(self) -> np.ndarray:
        """(M, 2) centres of the boxes [px of the picture]."""
        return self.boxes.centre

    @property
    def typical_length(self) -> float:
        """Median length of the boxes [px of the picture]."""
        return float(np.median(self.boxes.length))

    def observe(self, metres_per_unit: float) -> Observation:
        """The sizes of the boxes as they are, in square pixels."""
        left = SQUEEZED_SD * abs(math.log(self.aspect))
        return Observation(ground_size(self.boxes, self.aspect), self.ruler, Systematic(np.array([left, left])))

    def shown(self, place: np.ndarray) -> None:
        """None: the one picture shows every place."""

    def surroundings(
        self, seen: Observation, vehicles: Votes, metres_per_unit: float, standards: Standards, country: str
    ) -> Sequence[AnchorVote]:
        """Rows of parked vehicles, and objects of standard size; nothing where pixels are not square."""
        if self.aspect != 1:
            return []
        return [
            *rows_in_plan(vehicles, self.boxes.along, standards, country),
            *objects_in_plan(self.objects, self.zoom, standards),
        ]

    def refined(self, seen: Observation, votes: Votes, scale: Scale) -> Geometry:
        """There is nothing to refine."""
        return self

    def findings(self, seen: Observation, vehicles: Votes, scale: Scale) -> Findings:
        """The drift of the scale."""
        table = vehicle_table(vehicles, vehicles.size, scale, self.boxes, self.picture)
        return Findings(drift=drift(table, *self.size, scale.value, self.aspect))
