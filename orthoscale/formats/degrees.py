"""Longitude and latitude: from map coordinates, also across the 180th meridian."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pyproj

WGS_84 = "EPSG:4326"  # longitude and latitude, as GPS and GeoJSON have them
SAME_TURN = 1e-6  # tolerance for rounding of coordinates on one meridian, as a share of a turn


def to_degrees(crs: Any) -> pyproj.Transformer:
    """The transformer from map coordinates in `crs`, x or east first, to longitude and latitude (WGS 84). Raises
    pyproj's errors if there is none."""
    import pyproj

    return pyproj.Transformer.from_crs(pyproj.CRS.from_user_input(crs), WGS_84, always_xy=True)


def turn_of(crs: Any) -> float:
    """The period of x in map coordinates in `crs`, once around the Earth: 360 in degrees, 40,075,017 m in Web Mercator;
    0 if x is not periodic, as in UTM, or PROJ cannot transform it to degrees."""
    import pyproj

    try:
        return _turn_of(crs)
    except pyproj.exceptions.ProjError:
        return 0.0


@lru_cache
def _turn_of(crs: Any) -> float:
    """As `turn_of`, but raises pyproj's errors, which `lru_cache` does not remember: they may be temporary, as when the
    process has no file handle left for PROJ's database."""
    import pyproj

    system = pyproj.CRS.from_user_input(crs)
    base = system.geodetic_crs
    if base is None or not base.is_geographic:
        return 0.0
    quarter = math.pi / 2 / base.axis_info[0].unit_conversion_factor  # of a turn, in the unit of its degrees
    east, north = np.meshgrid(np.arange(4) * quarter, np.array([0.0, 0.5]) * quarter)
    x, y = pyproj.Transformer.from_crs(base, system, always_xy=True).transform(east, north)
    if not np.isfinite([*x, *y]).all():
        return 0.0
    turn = 4 * float(np.median(np.diff(x)))
    # If x depends on longitude alone, meridians are straight, parallel and equally spaced.
    off = turned_to(x - x[0, 0] - np.arange(4) / 4 * turn, 0.0, turn) if turn else x
    return abs(turn) if max(np.abs(off).max(), np.ptp(y, axis=1).max()) < SAME_TURN * abs(turn) else 0.0


def turned_to(longitudes: np.ndarray, about: float, turn: float = 360.0) -> np.ndarray:
    """(K,) `longitudes` [deg] shifted by whole turns to within half a `turn` of `about`; infinite ones stay."""
    turns = np.round((longitudes - about) / turn)
    return longitudes - turn * np.where(np.isfinite(turns), turns, 0.0)


def near_on_map(places: np.ndarray, crs: Any, about: float) -> np.ndarray:
    """(K, 2) map coordinates in `crs` of the same `places` (K, 2), with x shifted by whole turns around the Earth as
    close as possible to `about`: pictures and maps may extend across the 180th meridian, where transformed coordinates
    jump."""
    turn = turn_of(crs)
    return np.column_stack([turned_to(places[:, 0], about, turn), places[:, 1]]) if turn else places


def about_meridian(places: np.ndarray, about: float = 0.0) -> np.ndarray:
    """(K, 2) longitudes and latitudes [deg] of one shape, continuous beyond 180 degrees instead of jumping; its middle
    lies within 180 degrees of the longitude `about`. For shapes narrower than half of the Earth."""
    east, north = np.asarray(places, float)[:, :2].T
    east = turned_to(east, east[0])  # the same for the first and last of a ring
    return np.column_stack([east - 360 * np.round((east.mean() - about) / 360), north])
