"""The ground of an orthophoto: conversion between pixels, metres east and north, and the coordinates of its CRS."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import shapely
from rasterio.transform import Affine
from shapely.geometry.base import BaseGeometry

from ..core.affine import transformed
from ..core.scale import PER_PIXEL
from ..errors import InputError, UsageError, shown
from ..formats.degrees import WGS_84, about_meridian, near_on_map, to_degrees
from ..formats.names import first_few
from ..formats.plain_path import readable
from ..formats.reading import LARGE, check_regular, read, read_plain, refuse_pipes_beside
from ..sources.gdal import reason
from ..sources.raster import RasterSource

MOST_OFF = 10.0  # largest ratio between an end of an interval and its scale: no true report has more
SAME_GSD = 1.02  # a map projection distorts by less within a picture; another scale is hardly ever so near
AREA_HINT = "Give the polygon of the area as GeoJSON, GeoPackage ..."
FARTHEST_M = 1e9  # of a polygon's coordinates, whatever their unit


@dataclass(frozen=True)
class MetricOrthophoto:
    """An orthophoto with metres.

    pixel : (2,) true ground size of one pixel, across and down [m].
    north : direction of north in the picture, clockwise from its top, if its pixels were square [deg].
    transform, crs : as the file claims, from ground control points if it has no geotransform; crs is None without one.
    interval : (low, high), the 90 % interval of the scale divided by its value; None if it is not known.
    notes : on all of this, for the user.
    """

    source: RasterSource
    pixel: np.ndarray
    north: float
    transform: Affine
    crs: Any
    interval: tuple[float, float] | None
    notes: tuple[str, ...]

    @property
    def gsd(self) -> float:
        """Ground sampling distance [m/px], the geometric mean of both axes."""
        return float(np.sqrt(self.pixel.prod()))

    @property
    def _axes(self) -> np.ndarray:
        """(2, 2) rows east and north, as (right, up) on the picture."""
        a = math.radians(self.north)
        north = np.array([math.sin(a), math.cos(a)])
        east = north[::-1] * (1, -1)
        # If rows go north, or columns west, the file has the ground's mirror image.
        return np.array([-east if self.source.claimed.mirrored else east, north])

    def to_metres(self, pixels: np.ndarray) -> np.ndarray:
        """(n, 2) pixels to metres east and north of the picture's lower left corner."""
        right_up = (np.asarray(pixels, float) * (1, -1) + (0, self.source.height)) * self.pixel
        return right_up @ self._axes.T

    def to_pixels(self, metres: np.ndarray) -> np.ndarray:
        """(n, 2) the inverse of `to_metres`."""
        right_up = np.asarray(metres, float) @ self._axes / self.pixel
        return (right_up - (0, self.source.height)) * (1, -1)

    def to_crs(self, metres: np.ndarray) -> np.ndarray:
        """(n, 2) metres to coordinates of the file's CRS."""
        return transformed(self.to_pixels(metres), self.transform)

    def from_crs(self, coordinates: np.ndarray) -> np.ndarray:
        """(n, 2) the inverse of `to_crs`."""
        return self.to_metres(transformed(coordinates, ~self.transform))

    @property
    def longitude(self) -> float | None:
        """Longitude of its middle [deg]; None without a place on Earth."""
        if not self.source.claimed.usable:
            return None
        try:
            there = to_degrees(self.crs)
        except pyproj.exceptions.ProjError:  # a CRS of the Moon, say
            return None
        return float(there.transform(*self.middle)[0])

    @property
    def middle(self) -> np.ndarray:
        """(2,) coordinates of its middle in the file's CRS."""
        return transformed(np.array([[self.source.width / 2, self.source.height / 2]]), self.transform)[0]


def open_ground(path: Path, scale_error: float | None = None) -> MetricOrthophoto:
    """The orthophoto at `path`. Raises InputError if it has no scale in metres, or
    another one than the report beside it.

    scale_error : half of the scale's 90 % interval, as a share; by default from the report that `orthoscale fix` wrote
    beside the file.
    """
    source = RasterSource.open(path)
    gsd, transform, crs = source.claimed.gsd_m, source.claimed.transform, source.claimed.crs
    if gsd is None or transform is None:
        raise InputError(
            f"{path} has no scale in metres: {source.claimed.why}",
            "Give it its scale first: orthoscale fix ORTHO --out SCALED.tif",
        )
    across, down = math.hypot(transform.a, transform.d), math.hypot(transform.b, transform.e)
    # A transform in degrees does not give the shape of pixels on the ground.
    aspect = math.sqrt(source.claimed.aspect if source.claimed.usable else across / down)
    pixel = gsd * np.array([aspect, 1 / aspect])
    north, notes = _north(source, transform, pixel)
    interval, told = _interval(path, scale_error, gsd, source.width * source.height)
    return MetricOrthophoto(source, pixel, north, transform, crs, interval, (*notes, *told))


def _north(source: RasterSource, transform: Affine, pixel: np.ndarray) -> tuple[float, tuple[str, ...]]:
    """`MetricOrthophoto.north` of a picture with this transform and ground size of a `pixel`, and notes on it."""
    middle = np.array([[source.width / 2, source.height / 2]])
    x, y = transformed(middle, transform)[0]
    notes: tuple[str, ...] = ()
    if source.claimed.usable:
        there = to_degrees(source.claimed.crs)
        lon, lat = there.transform(x, y)
        ahead = np.array([there.transform(lon, lat + 1e-4, direction="INVERSE")])
        ahead = near_on_map(ahead, source.claimed.crs, x)
    else:
        ahead = np.array([[x, y + 1]])
        notes = ("north is assumed along the picture's own y axis: nothing ties it to the ground",)
    right, down = (transformed(ahead, ~transform) - middle)[0] * pixel
    return math.degrees(math.atan2(right, -down)), notes


def _interval(
    path: Path, scale_error: float | None, gsd: float, area: int
) -> tuple[tuple[float, float] | None, tuple[str, ...]]:
    """`MetricOrthophoto.interval` of a picture of `area` pixels with `gsd` m/px, and notes on it. Raises InputError if
    it would be that of another scale."""
    if scale_error is not None:
        if not 0 <= scale_error < 1:
            raise UsageError("--scale-error must lie between 0 and 100 per cent")
        return (1 - scale_error, 1 + scale_error), ()
    report = path.with_name(path.name + ".json")
    from ..formats.schemas.report import ReportOfPictures

    unknown = f"the uncertainty of the scale is not known: no {report.name} states it (or give --scale-error PERCENT)"
    try:
        told = read(report, ReportOfPictures, "a report of orthoscale", "Write it again with `fix`.", LARGE)
    except InputError:  # there is none, or it is another program's file
        return None, (unknown,)
    low, high = (v / told.scale for v in told.interval90)
    if told.unit != PER_PIXEL or not 1 / MOST_OFF <= low <= 1 <= high <= MOST_OFF:
        return None, (unknown,)
    # The picture may have been cropped or resampled since.
    expected = [told.scale, *(told.scale * math.sqrt(w * h / area) for w, h in told.pictures.values())]
    if min(abs(math.log(gsd / each)) for each in expected if each > 0) > math.log(SAME_GSD):
        raise InputError(
            f"{path} has {100 * gsd:.4g} cm/px, but the scale in {report.name} is {100 * told.scale:.4g} cm/px",
            "One of them was changed or is of another picture: run `orthoscale fix` again, or give --scale-error.",
        )
    return (low, high), ()


def _polygons(path: Path, longitude: float | None = None) -> tuple[BaseGeometry, str | None, list[str]]:
    """All polygons in the first layer of a vector file as one shape, the file's CRS, and notes on what was not read.
    Coordinates in degrees are shifted by full turns to lie near the `longitude` of a picture, also beyond 180. Raises
    InputError."""
    import pyogrio

    if not path.is_dir():  # some formats are folders
        check_regular(path, AREA_HINT)
        refuse_pipes_beside([path])
    if path.suffix.lower() in (".geojson", ".json"):
        read_plain(path, "GeoJSON", AREA_HINT, LARGE)  # so that GDAL only gets sound files
    try:
        with readable(path) as place:
            names = [str(name) for name, kind in pyogrio.list_layers(place) if kind is not None]
            meta, _, shapes, _ = pyogrio.raw.read(place, layer=names[0] if names else None)
        flat = shapely.get_parts([shapely.force_2d(shapely.from_wkb(s)) for s in shapes if s is not None])
        if longitude is not None and meta["crs"] and pyproj.CRS.from_user_input(meta["crs"]).is_geographic:
            flat = [shapely.transform(p, lambda c: about_meridian(c, longitude)) if _degrees(p) else p for p in flat]
        area = shapely.union_all(_areas(shapely.make_valid(flat)))
        sound = not area.is_empty and bool((np.abs(shapely.get_coordinates(area)) < FARTHEST_M).all())
    except Exception as error:  # GDAL's and GEOS's errors share no base
        raise InputError(f"{path}: not a vector file that GDAL can read ({shown(reason(error))})", AREA_HINT) from error
    if not sound:
        raise InputError(f"{path}: no polygon in it", "Draw the area as a polygon.")
    notes = [f"{path.name}: its layer {names[0]} is read, and not {first_few(names[1:])}"] if len(names) > 1 else []
    return area, meta["crs"], notes


def _areas(shapes: Any) -> np.ndarray:
    """The polygons in one shape or in several. The lines and points that repairs and overlays leave where parts only
    touch are left out."""
    parts = shapely.get_parts(shapely.get_parts(shapes))  # a collection may hold multipolygons
    return parts[shapely.get_dimensions(parts) == 2]


def _degrees(shape: BaseGeometry) -> bool:
    """Whether its coordinates may be longitudes, which may exceed 180, and latitudes."""
    return bool((np.abs(shapely.get_coordinates(shape)) <= [360, 90]).all())


def read_area(
    path: Path, ground: MetricOrthophoto, pixels: bool = False, least_inside: float = 0.0
) -> tuple[BaseGeometry, tuple[str, ...]]:
    """The polygons of a vector file as one area in `ground`'s metres, and notes on how they were read.

    pixels : whether coordinates are columns and rows of the picture. Otherwise, if the picture has a place on Earth,
    coordinates of a file with its own CRS are transformed; for a picture in local metres they are taken as they are.
    least_inside : share of the area below which the picture is another place's. Raises InputError.
    """
    area, own, notes = _polygons(path, ground.longitude)
    if pixels:
        area = shapely.transform(area, ground.to_metres)
    else:
        # GeoJSON is always read as longitude and latitude, even if its coordinates are others.
        if ground.source.claimed.usable and own and not (own == WGS_84 and not _degrees(area)):
            try:
                there = pyproj.Transformer.from_crs(own, pyproj.CRS.from_user_input(ground.crs), always_xy=True)
                about = ground.middle[0]
                area = shapely.transform(
                    area, lambda c: near_on_map(np.column_stack(there.transform(*c.T)), ground.crs, about)
                )
            except pyproj.exceptions.ProjError as error:
                raise InputError(f"{path}: its coordinates do not fit the picture's", AREA_HINT) from error
        elif ground.source.claimed.usable:
            notes.append(f"{path.name}: its coordinates are taken for those of the picture's CRS")
        area = shapely.transform(area, ground.from_crs)
    if not np.isfinite(shapely.get_coordinates(area)).all():
        raise InputError(f"{path}: its coordinates have no place in the picture's", AREA_HINT)
    picture = shapely.transform(shapely.box(0, 0, ground.source.width, ground.source.height), ground.to_metres)
    inside = shapely.multipolygons(_areas(area.intersection(picture)))
    if not inside.area > least_inside * area.area:
        corners = ground.to_crs(shapely.get_coordinates(picture))
        ends = np.concatenate([corners.min(0), corners.max(0)])
        x0, y0, x1, y1 = np.round(ends, 8) + 0.0  # to a millimetre, also in degrees; of what is nearly 0 no -1e-28
        raise InputError(
            f"{path}: lies outside of {ground.source.name}",
            f"The picture goes from ({x0:.10g}, {y0:.10g}) to ({x1:.10g}, {y1:.10g}) in its own coordinates; "
            "for columns and rows add --lot-pixels.",
        )
    if inside.area < 0.999 * area.area:
        outside = min(round(100 * (1 - inside.area / area.area)), 99)
        notes.append(f"{path.name}: {outside} % lies outside of the picture, left out")
    return inside, tuple(notes)
