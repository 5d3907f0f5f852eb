"""A georeferenced satellite picture or orthophoto: the place of its pixels on Earth, and their size on the ground."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
from rasterio.transform import Affine

from ..core.affine import transformed
from ..errors import UsageError
from ..formats.degrees import about_meridian, near_on_map, to_degrees, turned_to
from .raster import RasterSource
from .raster_mirrored import FromLastRow


@dataclass(frozen=True)
class Satellite:
    """A georeferenced satellite picture. Open it with `Satellite.open`. If the file shows the ground mirrored (such as
    south-up), rows count from its last, so that the picture always shows the ground as it is."""

    source: RasterSource | FromLastRow
    transform: Any
    crs: pyproj.CRS

    @classmethod
    def open(cls, path: Path) -> Satellite:
        """Open the picture at `path`. Raises InputError if it is not a picture, UsageError if it has no place on
        Earth."""
        source = RasterSource.open(path)
        claim = source.claimed
        if not claim.usable or claim.transform is None:
            raise UsageError(f"{path} has no place on Earth: {claim.why}", "Give a georeferenced satellite picture.")
        crs = pyproj.CRS.from_user_input(claim.crs)
        if claim.mirrored:
            t, height = claim.transform, source.height
            up = Affine(t.a, -t.b, t.c + t.b * height, t.d, -t.e, t.f + t.e * height)
            return cls(FromLastRow(source), up, crs)
        return cls(source, claim.transform, crs)

    def in_file(self, windows: np.ndarray) -> np.ndarray:
        """`windows` (n, 4), x, y, width and height, in pixels of the file as it is stored."""
        x, y, width, height = np.asarray(windows).T
        mirrored = isinstance(self.source, FromLastRow)
        return np.column_stack([x, self.source.height - y - height if mirrored else y, width, height])

    @cached_property
    def _to_degrees(self) -> pyproj.Transformer:
        return to_degrees(self.crs)

    def coordinates(self, pixels: np.ndarray) -> np.ndarray:
        """(n, 2) pixels to coordinates of `crs`."""
        return transformed(np.reshape(pixels, (-1, 2)), self.transform)

    def degrees(self, coordinates: np.ndarray) -> np.ndarray:
        """(n, 2) coordinates of `crs` to longitude, -180 to 180, and latitude [deg]; infinite where there is no such
        place."""
        longitude, latitude = self._to_degrees.transform(*np.asarray(coordinates, float).reshape(-1, 2).T)
        return np.column_stack([turned_to(longitude, 0.0), latitude])

    def in_crs(self, lon_lat: np.ndarray) -> np.ndarray:
        """(n, 2) longitude and latitude [deg] to coordinates of `crs`, infinite where the projection has none. If the
        picture extends beyond the 180th meridian, so do these coordinates."""
        longitude, latitude = np.asarray(lon_lat, float).reshape(-1, 2).T
        there = np.column_stack(self._to_degrees.transform(longitude, latitude, direction="INVERSE"))
        middle = self.coordinates(np.array([self.source.width, self.source.height]) / 2)[0]
        return near_on_map(there, self.crs, middle[0])

    def lon_lat(self, pixels: np.ndarray) -> np.ndarray:
        """(n, 2) pixels to longitude and latitude [deg]."""
        return self.degrees(self.coordinates(pixels))

    def pixel_of(self, lon: float, lat: float) -> np.ndarray:
        """(2,) the pixel at a place, which may lie outside of the picture; NaN if the projection has none."""
        pixel = transformed(self.in_crs(np.array([lon, lat])), ~self.transform)[0]
        return np.where(np.isfinite(pixel), pixel, np.nan)

    def extent_in_words(self) -> str:
        """Its range of longitudes and latitudes, as a sentence."""
        width, height = self.source.width, self.source.height
        corners = about_meridian(self.lon_lat(np.array([[0, 0], [width, 0], [width, height], [0, height]])))
        low, high = corners.min(0), corners.max(0)
        return f"It goes from {low[0]:.6f}, {low[1]:.6f} to {high[0]:.6f}, {high[1]:.6f} (longitude, latitude)."

    def pixel_size(self, pixel: np.ndarray) -> np.ndarray:
        """(2,) true size on the ground of one pixel near `pixel`, across and down [m]: projections stretch by place."""
        half = 50.0
        (west, east), (up, down) = (self.lon_lat(pixel + np.outer([-half, half], axis)) for axis in np.eye(2))
        geod = pyproj.Geod(ellps="WGS84")
        return np.array([geod.inv(*west, *east)[2], geod.inv(*up, *down)[2]]) / (2 * half)
