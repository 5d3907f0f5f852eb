"""Where an input lies on a georeferenced map of another date, and the georeferencing that its copy takes from there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.evidence import Evidence
from ..core.source import Placement


@dataclass(frozen=True)
class OnMap:
    """What a map says.

    evidence : one piece, or none where the input was not found on it. notes : what a user should know.
    crs, affine : the map's coordinates, and (2, 3) into them from an orthophoto's pixels, to which it gives `gsd_m`
    [m/px]; None for a reconstruction, and where nothing was found. size : of the orthophoto [px]. name : of the map.
    """

    evidence: tuple[Evidence, ...] = ()
    notes: tuple[str, ...] = ()
    crs: Any = None
    affine: np.ndarray | None = None
    gsd_m: float = 0.0
    size: tuple[int, int] = (0, 0)
    name: str = ""

    def place(self, metres_per_pixel: float) -> Placement | None:
        """The georeferencing of a copy of this scale: the map's direction, and its place for the orthophoto's middle;
        None without one."""
        if self.affine is None:
            return None
        from rasterio.transform import Affine

        from .georeference import CopyGeoreference

        linear, shift = self.affine[:, :2], self.affine[:, 2]
        middle = np.array(self.size) / 2
        grown = linear * (metres_per_pixel / self.gsd_m)
        matrix = np.column_stack([grown, linear @ middle + shift - grown @ middle])
        return CopyGeoreference(self.crs, Affine(*matrix.ravel()), f"place and direction by its match with {self.name}")
