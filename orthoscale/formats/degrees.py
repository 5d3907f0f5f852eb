"""Longitude and latitude on Earth: from the coordinates of maps, and beyond the 180th meridian."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pyproj

WGS_84 = "EPSG:4326"  # longitude and latitude, as GPS and GeoJSON have them


def to_degrees(crs: Any) -> pyproj.Transformer:
    """From map coordinates in `crs`, x or east first, to longitude and latitude (WGS 84). Raises pyproj's errors where
    there is none."""
    import pyproj

    return pyproj.Transformer.from_crs(pyproj.CRS.from_user_input(crs), WGS_84, always_xy=True)


def turned_to(longitudes: np.ndarray, about: float) -> np.ndarray:
    """(K,) `longitudes` [deg] by whole turns, each within 180 degrees of the longitude `about`; infinite ones stay."""
    turns = np.round((longitudes - about) / 360)
    return longitudes - 360 * np.where(np.isfinite(turns), turns, 0.0)


def about_meridian(places: np.ndarray, about: float = 0.0) -> np.ndarray:
    """(K, 2) longitudes and latitudes [deg] of one shape that goes on beyond 180 degrees instead of around the Earth;
    its middle lies within 180 degrees of the longitude `about`. For shapes of less than half of the Earth."""
    east, north = np.asarray(places, float)[:, :2].T
    east = turned_to(east, east[0])  # the same for the first and last of a ring
    return np.column_stack([east - 360 * np.round((east.mean() - about) / 360), north])
