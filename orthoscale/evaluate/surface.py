"""The ground below a camera, from a digital surface model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyproj
from rasterio.windows import Window

from ..core.affine import transformed
from ..errors import InputError
from ..formats.degrees import near_on_map, to_degrees
from ..sources.gdal import open_dataset, reading

RADIUS = 100.0  # [m] around the point below the camera, as in arXiv 2603.07535
LOWEST_SHARE = 0.10  # share of the heights there, from the lowest, whose mean is the ground: roofs and crowns lie above


class Surface:
    """A digital surface model. Open it with `Surface.open`, in a ``with`` block."""

    def __init__(self, dataset: Any, crs: pyproj.CRS):
        self._dataset, self._crs = dataset, crs
        self._to_degrees = to_degrees(crs)

    @classmethod
    def open(cls, path: Path) -> Surface:
        """Open the model at `path`. Raises InputError if it is no raster, or has no coordinate reference system."""
        with reading(path, "is not a surface model that GDAL can read", "Give a GeoTIFF."):
            dataset = open_dataset(path)
        if dataset.crs is None:
            dataset.close()
            raise InputError(f"{path}: the surface model has no coordinate reference system", "Assign one to it.")
        return cls(dataset, pyproj.CRS.from_user_input(dataset.crs))

    def __enter__(self) -> Surface:
        return self

    def __exit__(self, *exc: object) -> None:
        self._dataset.close()

    def ground(self, lon: float, lat: float) -> float | None:
        """Mean of the lowest tenth of the heights within 100 m of a place [m]; None if the model has none there."""
        north = pyproj.Geod(ellps="WGS84").fwd(lon, lat, 0.0, RADIUS)
        east = pyproj.Geod(ellps="WGS84").fwd(lon, lat, 90.0, RADIUS)
        to_pixel = ~self._dataset.transform
        longitude, latitude = np.array([(lon, lat), north[:2], east[:2]]).T
        there = np.column_stack(self._to_degrees.transform(longitude, latitude, direction="INVERSE"))
        middle = (self._dataset.bounds.left + self._dataset.bounds.right) / 2
        (cx, cy), (nx, ny), (ex, ey) = transformed(near_on_map(there, self._crs, middle), to_pixel)
        if not np.isfinite([cx, cy, nx, ny, ex, ey]).all():
            return None
        axes = np.array([[ex - cx, nx - cx], [ey - cy, ny - cy]]) / RADIUS  # pixels per metre east and north
        reach = RADIUS * np.linalg.norm(axes, axis=1)
        x0, y0 = np.maximum(np.floor([cx - reach[0], cy - reach[1]]), 0).astype(int)
        x1, y1 = np.minimum(
            np.ceil([cx + reach[0], cy + reach[1]]), [self._dataset.width, self._dataset.height]
        ).astype(int)
        if x1 <= x0 or y1 <= y0:
            return None
        with reading(Path(self._dataset.name), "is damaged", "Copy it again."):
            heights = self._dataset.read(1, window=Window(x0, y0, x1 - x0, y1 - y0), masked=True)
        y, x = np.indices(heights.shape) + 0.5
        offset = np.linalg.solve(axes, np.stack([x.ravel() + x0 - cx, y.ravel() + y0 - cy]))
        near = (np.hypot(*offset) <= RADIUS).reshape(heights.shape)
        # Models without a nodata value have -32767 and the like where there is no height.
        known = np.sort(heights[near].compressed())
        known = known[np.isfinite(known) & (known > -1000)]
        if not len(known):
            return None
        return float(known[: max(1, round(LOWEST_SHARE * len(known)))].mean())
