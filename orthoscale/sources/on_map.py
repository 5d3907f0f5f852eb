"""Where an input lies on a georeferenced map of another date, and the georeferencing that its copy gets from there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.by_value import ByValue
from ..core.evidence import Evidence
from ..core.source import Placement


@dataclass(frozen=True, eq=False)
class OnMap(ByValue):
    """The result of matching an input with a map.

    evidence : one piece, or none if the input was not found on the map. notes : what a user should know.
    crs, affine : the map's coordinate system, and (2, 3) from an orthophoto's pixels into it; None for a
    reconstruction, and if nothing was found. gsd_m : of the orthophoto by the map [m/px]. size : of the orthophoto
    [px]. name : of the map.
    """

    evidence: tuple[Evidence, ...] = ()
    notes: tuple[str, ...] = ()
    crs: Any = None
    affine: np.ndarray | None = None
    gsd_m: float = 0.0
    size: tuple[int, int] = (0, 0)
    name: str = ""

    def place(self, metres_per_pixel: float) -> Placement | None:
        """The georeferencing of a copy with this scale: its direction and the place of its middle are those on the map;
        None if it was not found there."""
        if self.affine is None:
            return None
        from rasterio.transform import Affine

        from .georeference import CopyGeoreference

        linear, shift = self.affine[:, :2], self.affine[:, 2]
        middle = np.array(self.size) / 2
        grown = linear * (metres_per_pixel / self.gsd_m)
        matrix = np.column_stack([grown, linear @ middle + shift - grown @ middle])
        return CopyGeoreference(self.crs, Affine(*matrix.ravel()), f"place and direction by its match with {self.name}")
