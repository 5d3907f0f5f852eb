"""A raster that is stored mirrored, turned into the ground as seen from above."""

from __future__ import annotations

import numpy as np

from .raster import RasterSource


class FromLastRow:
    """A raster with its last row first. If the raster shows the ground mirrored, this shows it as seen from above."""

    def __init__(self, source: RasterSource):
        self.source = source
        self.path, self.name, self.files = source.path, source.name, source.files
        self.width, self.height = source.width, source.height

    def read(self, x: int, y: int, width: int, height: int, out_width: int, out_height: int) -> np.ndarray:
        """See `RasterSource.read`; rows count from the last."""
        pixels = self.source.read(x, self.height - y - height, width, height, out_width, out_height)
        return np.ascontiguousarray(pixels[::-1])

    def fingerprint(self) -> str:
        """Differs from that of the raster itself, since pixel positions in cached results differ. Raises InputError."""
        return f"{self.source.fingerprint()}, last row first"
