"""The ground below a camera, from a digital surface model."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
from rasterio.windows import Window

from ..core.affine import transformed
from ..errors import InputError, shown
from ..formats.degrees import near_on_map, to_degrees
from ..sources.gdal import open_dataset, reading

RADIUS = 100.0  # [m] around the point below the camera, as in arXiv 2603.07535
LOWEST_SHARE = 0.10  # share of the heights there, from the lowest, whose mean is the ground: roofs and crowns lie above
# What models without a nodata value store where there is no height: Esri's and GDAL's -9999, DTED's -32767, SRTM's
# -32768; and the least height that counts as one [m]: no open pit is deeper below the sea (a judgement).
NO_HEIGHT, LEAST_HEIGHT = (-9999.0, -32767.0, -32768.0), -1000.0
# [m] units of heights, by the letters of their names in GDAL, PROJ and Esri's programs.
HEIGHT_UNITS = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("ft", "foot", "feet", "footintl", "internationalfoot", "internationalfeet"), 0.3048),
    **dict.fromkeys(("usft", "ftus", "footus", "ussurveyfoot", "ussurveyfeet"), 1200 / 3937),
}


class Surface:
    """A digital surface model. Open it with `Surface.open`, in a ``with`` block.

    note : what is assumed of the unit of its heights, for the user; empty if the model tells it.
    """

    def __init__(self, dataset: Any, crs: pyproj.CRS):
        self._dataset, self._crs = dataset, crs
        self._to_degrees = to_degrees(crs)
        self._unit, self.note = _unit(dataset, crs)

    @classmethod
    def open(cls, path: Path) -> Surface:
        """Open the model at `path`. Raises InputError if it is no raster, has no coordinate reference system, or
        heights in an unknown unit."""
        with reading(path, "is not a surface model that GDAL can read", "Give a GeoTIFF."):
            dataset = open_dataset(path)
        try:
            if dataset.crs is None:
                raise InputError(f"{path}: the surface model has no coordinate reference system", "Assign one to it.")
            return cls(dataset, pyproj.CRS.from_user_input(dataset.crs))
        except BaseException:
            dataset.close()
            raise

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
        stored = heights[near].compressed().astype(float)
        stored = stored[~np.isin(stored, NO_HEIGHT)]
        known = np.sort(self._unit * (stored * self._dataset.scales[0] + self._dataset.offsets[0]))
        known = known[np.isfinite(known) & (known > LEAST_HEIGHT)]
        if not len(known):
            return None
        return float(known[: max(1, round(LOWEST_SHARE * len(known)))].mean())


def _unit(dataset: Any, crs: pyproj.CRS) -> tuple[float, str]:
    """The unit of the heights [m]: the band's own, else that of the vertical axis, else metres; and what to say where
    these are assumed although the map is in another unit of length. Raises InputError."""
    if name := dataset.units[0]:
        unit = HEIGHT_UNITS.get(re.sub("[^a-z]", "", name.lower()))
        if unit is None:
            raise InputError(
                f"{dataset.name}: its heights are in {shown(name)!r}, which is no known unit",
                "Give them in metres or feet, and set the unit of its band to m, ft or us-ft.",
            )
        return unit, ""
    if len(crs.axis_info) > 2:
        return crs.axis_info[2].unit_conversion_factor, ""
    if not crs.is_projected or (across := crs.axis_info[0]).unit_conversion_factor == 1:
        return 1.0, ""
    return 1.0, (
        f"its map is in units of {across.unit_name}, and nothing tells that of its heights: taken for metres (if they "
        "are in feet, set the unit of its band to ft)"
    )
