"""A raster that is stored mirrored, as the ground is seen from above."""

from __future__ import annotations

import numpy as np

from .raster import RasterSource


class FromLastRow:
    """A raster with its last row first: of one that shows the ground mirrored, the ground as it is seen from above."""

    def __init__(self, source: RasterSource):
        self.source = source
        self.path, self.name, self.files = source.path, source.name, source.files
        self.width, self.height = source.width, source.height

    def read(self, x: int, y: int, width: int, height: int, out_width: int, out_height: int) -> np.ndarray:
        """As of `RasterSource`, of rows that are counted from the last."""
        pixels = self.source.read(x, self.height - y - height, width, height, out_width, out_height)
        return np.ascontiguousarray(pixels[::-1])

    def fingerprint(self) -> str:
        """Another than that of the raster itself: what is kept of its pixels lies elsewhere. Raises InputError."""
        return f"{self.source.fingerprint()}, last row first"
