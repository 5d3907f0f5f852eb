"""Georeferencing: the position and pixel size that a raster file claims, and those that its copy gets."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyproj
from rasterio.control import GroundControlPoint
from rasterio.crs import CRS
from rasterio.errors import RasterioError
from rasterio.io import DatasetReader
from rasterio.transform import Affine, from_gcps

from ..core.affine import transformed
from ..errors import InputError
from ..formats.degrees import near_on_map, to_degrees
from ..formats.reading import LARGE, is_there, read_bytes
from .gdal import open_dataset, read_projection, world_files

LINE = 1e-6  # width over length up to which points count as lying on a line
MOST_MISFIT = 0.02
"""Share of the image's diagonal that ground control may be off its affine fit: then the pixel size is off as much."""
# [deg] deviation from a right angle from which pixels, and with them vehicles, are parallelograms on the ground.
# EPSG:3035, an equal-area projection of a continent, has 2.4 at its edges; maps of the world, and rotated ones in
# degrees, have tens.
MOST_LEANING = 5.0
NO_GEOREFERENCE = "not georeferenced"  # `Claim.why` of a picture that says nothing of its place and scale
NEARLY_SQUARE = 0.01  # relative difference of a pixel's sides
LEAST_STRETCH = 0.05  # from which on leaving it out is a mistake of its own: conformal national maps stretch by 0.1 %
SAME_PIXEL = 0.01  # relative difference of pixel sizes up to which two files say the same
LOCAL_CRS = (
    'LOCAL_CS["orthoscale local metres",LOCAL_DATUM["unknown",32767],UNIT["metre",1,AUTHORITY["EPSG","9001"]],'
    'AXIS["Easting",EAST],AXIS["Northing",NORTH]]'
)
"""The engineering CRS of written copies: metres, but nowhere on Earth."""


@dataclass(frozen=True)
class Claim:
    """The scale that a raster's own georeferencing states.

    gsd_m : ground metres per pixel at the image's centre, measured on the ellipsoid (the geometric mean of both axes);
        if nothing ties the image to the Earth, its figures taken as metres; None without any figure.
    usable : True if it comes from a real coordinate reference system and may be compared with a measured scale.
    why : text for people, to follow the figure: where it comes from, or why there is none or it cannot be trusted.
    crs, transform : the georeferencing behind it, from ground control points if there is no geotransform; None
        without any.
    aspect : width over height of a pixel on the ground; 1 if it is square or unknown.
    unit_known : False if nothing gives the unit of the figures.
    unread : names of files beside the raster that were to say more, but are not understood.
    mistakes : that this georeferencing invites, with truth over `gsd_m` where they were made.
    """

    gsd_m: float | None
    usable: bool
    why: str
    crs: CRS | None = None
    transform: Affine | None = None
    aspect: float = 1.0
    unit_known: bool = True
    unread: Sequence[str] = ()
    mistakes: Sequence[tuple[float, str]] = ()

    @property
    def mirrored(self) -> bool:
        """Whether the picture shows the ground mirrored: its rows go north, or its columns west."""
        return self.transform is not None and self.transform.determinant > 0


@dataclass(frozen=True)
class CopyGeoreference:
    """The georeferencing of a copy with the measured scale. said : what became of the input's own, for people."""

    crs: str | CRS
    transform: Affine
    said: str


def claim_of(dataset: DatasetReader, projection: Path | None = None) -> Claim:
    """The claim of the georeferencing of `dataset`, or of its world file and its ``.prj`` (`projection`), and whether
    it can be trusted; within `gdal.guarded`. Never raises for strange georeferencing."""
    try:
        return _claim_of(dataset, projection)
    except pyproj.exceptions.CRSError as error:
        return Claim(None, False, f"its coordinate reference system is not understood ({error})")


def _claim_of(dataset: DatasetReader, projection: Path | None) -> Claim:
    """As `claim_of`. Raises CRSError."""
    t, crs = dataset.transform, dataset.crs
    if (t.b, t.d, t.c) == (0, 0, 0) and abs(t.a) == abs(t.e) == 1 and t.f in (0, dataset.height):
        if dataset.gcps[0]:
            return _claim_of_gcps(dataset)
        if dataset.rpcs:
            return Claim(None, False, "only rational polynomials (RPC), no geotransform (gdalwarp makes one)")
        path = Path(dataset.name)
        unread = _damaged_sidecar(path) + [name for name in world_files(path) if is_there(path.with_name(name))][:1]
        return Claim(None, False, NO_GEOREFERENCE + _left_aside(": ", unread), unread=tuple(unread))
    across, down = math.hypot(t.a, t.d), math.hypot(t.b, t.e)
    size = math.sqrt(abs(t.determinant))
    if size == 0 or not math.isfinite(across * down):
        return Claim(None, False, "a geotransform without area")
    told_by, unread = "", _damaged_sidecar(Path(dataset.name)) if crs is None else []
    if crs is None and projection is not None:
        try:
            crs, told_by = read_projection(projection), f" ({projection.name})"
        except InputError:
            unread.append(projection.name)
    if crs is None:
        beside = [Path(f).name for f in dataset.files[1:]]
        aspect = _aspect(across, down)
        shape = "square" if aspect == 1 else f"{aspect:.4g} times as wide as high"
        why = (
            f"{across:.6g} x {down:.6g} of an unknown unit per pixel{f' ({beside[0]})' if beside else ''}: "
            f"there is no coordinate reference system{_left_aside(', and ', unread)}; pixels are {shape}"
        )
        return Claim(size, False, why + _attitude(t), None, t, unit_known=False, unread=tuple(unread))
    system = pyproj.CRS.from_user_input(crs)
    if system.type_name == "Engineering CRS":
        size *= system.axis_info[0].unit_conversion_factor
        why = f"in local coordinates ({system.name}{told_by}), which nothing ties to the ground"
        return Claim(size, False, why + _attitude(t), crs, t, _aspect(across, down))  # copies may have oblong pixels
    if (t.c, t.f) == (0, 0):
        # OpenDroneMap without GPS: UTM zone 30N, geotransform (0, .1, 0, 0, 0, -.1).
        return Claim(None, False, f"a placeholder: {system.name}{told_by} with its origin at exactly (0, 0)", crs, t)
    return _claim_on_earth(dataset, crs, t, f"on the ground, from {system.name}{told_by}")


def _damaged_sidecar(path: Path) -> list[str]:
    """The name of the ``.aux.xml`` beside the picture `path`, if there is one that is no XML: GDAL leaves it aside, and
    says nothing."""
    sidecar = path.with_name(f"{path.name}.aux.xml")
    if not is_there(sidecar):
        return []
    try:
        ElementTree.fromstring(read_bytes(sidecar, "", LARGE))
    except (InputError, ElementTree.ParseError, LookupError, ValueError):  # the last two of unknown encodings
        return [sidecar.name]
    return []


def _left_aside(joint: str, names: list[str]) -> str:
    """That the files called `names` beside the picture say nothing, after `joint`; '' if there are none."""
    return f"{joint}GDAL does not understand {' and '.join(names)} beside it" if names else ""


def other_claims(path: Path, dataset: DatasetReader, claim: Claim) -> list[str]:
    """Other pixel sizes, in words, if a TIFF or JPEG 2000 file and the files beside it contradict each other; within
    `guarded`. GDAL takes ``.aux.xml`` first, then the file, then the world file."""
    beside = {"PAM": (f"{path.name}.aux.xml",), "INTERNAL": (path.name,), "WORLDFILE": world_files(path)}
    there = {source: [n for n in names if is_there(path.with_name(n))] for source, names in beside.items()}
    if dataset.driver not in ("GTiff", "JP2OpenJPEG") or not claim.usable or not (there["PAM"] or there["WORLDFILE"]):
        return []
    said = []
    for source, (name, *_) in ((source, names) for source, names in there.items() if names):
        with open_dataset(path, dataset.driver, GEOREF_SOURCES=source) as file:
            if (t := file.transform) != Affine.identity():
                with suppress(pyproj.exceptions.CRSError):
                    other = _claim_on_earth(file, file.crs or claim.crs, t, "").gsd_m
                    if other is not None and claim.gsd_m is not None and abs(other / claim.gsd_m - 1) > SAME_PIXEL:
                        said.append(f"{name}{' itself' if source == 'INTERNAL' else ''} says {other:.4g} m/px")
    return said


def _claim_of_gcps(dataset: DatasetReader) -> Claim:
    points, crs = dataset.gcps
    if crs is None or len(points) < 3:
        return Claim(None, False, f"only {len(points)} ground control points, without what ties them to the ground")
    if not np.isfinite([(p.col, p.row, p.x, p.y) for p in points]).all():
        return Claim(None, False, f"{len(points)} ground control points, not all of them finite numbers")
    # Coordinates of an image across the 180th meridian continue beyond it.
    east = near_on_map(np.array([(p.x, p.y) for p in points]), crs, points[0].x)[:, 0]
    points = [GroundControlPoint(p.row, p.col, x, p.y, p.z) for p, x in zip(points, east.tolist(), strict=True)]
    # GDAL fits a transform to points on a line, too, but the result depends on rounding.
    flat = (_on_a_line([(p.col, p.row) for p in points]), _on_a_line([(p.x, p.y) for p in points]))
    try:
        t = Affine(0, 0, 0, 0, 0, 0) if any(flat) else from_gcps(points)
    except (RasterioError, ValueError):
        t = Affine(0, 0, 0, 0, 0, 0)
    if not abs(t.determinant) > 0:
        return Claim(None, False, f"{len(points)} ground control points that span no area")
    off = _misfit(points, t)
    why = f"{len(points)} ground control points"
    if off > MOST_MISFIT * math.hypot(dataset.width, dataset.height):
        return Claim(None, False, f"{why} that contradict each other: an affine fit misses them by {off:.3g} px")
    fits = f", which an affine fit misses by {off:.3g} px" if off >= 0.1 else ""
    return _claim_on_earth(dataset, crs, t, f"on the ground, from {why}{fits}")


def _misfit(points: list[GroundControlPoint], t: Affine) -> float:
    """[px] distance between the points by `t` and their pixels, root mean square."""
    away = transformed(np.array([(p.x, p.y) for p in points]), ~t) - [(p.col, p.row) for p in points]
    return math.sqrt((away**2).sum(1).mean())


def _on_a_line(points: list[tuple[float, float]]) -> bool:
    spread = np.linalg.svd(np.array(points) - np.mean(points, axis=0), compute_uv=False)
    return bool(spread[1] <= LINE * spread[0])


def _claim_on_earth(dataset: DatasetReader, crs: CRS, t: Affine, why: str) -> Claim:
    system = pyproj.CRS.from_user_input(crs)
    if system.is_geocentric:
        return Claim(None, False, f"{system.name} is geocentric: no picture can lie in it")
    try:
        across, down, leaning = _ground_steps(dataset.width, dataset.height, t, system)
    except pyproj.exceptions.ProjError as error:
        return Claim(None, False, f"its place cannot be found on Earth from {system.name} ({error})")
    gsd = math.sqrt(across * down)
    if gsd == 0:
        return Claim(None, False, f"pixels without size on the ground, in {system.name}")
    if leaning > MOST_LEANING:
        meet = f"its rows and columns meet at {90 - leaning:.0f} degrees on the ground"
        return Claim(None, False, f"{meet}, in {system.name} (gdalwarp to UTM puts that right)", crs, t)
    size = math.sqrt(abs(t.determinant))
    unit = system.axis_info[0].unit_name if system.axis_info else "unit"
    if system.is_geographic:
        why += f"; {size:.6g} degrees per pixel"
    elif abs(size / gsd - 1) > 0.002:  # feet, or a projection that stretches: Mercator by 1/cos(latitude)
        why += f"; {size:.6g} {unit} per pixel there"
    if (aspect := _aspect(across, down)) != 1:
        why += f"; its pixels are {across:.6g} m wide and {down:.6g} m high"
    return Claim(gsd, True, why + _attitude(t), crs, t, aspect, mistakes=_of_stretching(system, size / gsd))


def _of_stretching(system: pyproj.CRS, ratio: float) -> list[tuple[float, str]]:
    """The mistake that a map invites which stretches the ground: `ratio` of its units show a metre there."""
    if not system.is_projected:
        return []
    stretch = ratio * system.axis_info[0].unit_conversion_factor
    why = f"the pixel size is that on the ground, and {system.name} needs it {stretch:.3g} times as large there"
    return [(stretch, why)] if abs(stretch - 1) > LEAST_STRETCH else []


def _attitude(t: Affine) -> str:
    """What is unusual about the image's orientation, in words."""
    words = []
    turned = math.degrees(math.atan2(t.d, t.a))
    if t.determinant > 0 and abs(turned) > 90:
        words.append("mirrored (its first column is the easternmost)")
        turned += 180
    elif t.determinant > 0:
        words.append("south-up (its first row is the southernmost)")
    turned = (turned + 180) % 360 - 180
    if abs(turned) > 0.01:
        words.append(f"rotated by {turned:.4g} degrees")
    return "".join(f"; {word}" for word in words)


def local_place(claim: Claim, height: int, gsd_m: float) -> CopyGeoreference:
    """Local metres, north up, origin at the lower left corner of the image of `height` px.

    An image that shows the ground mirrored (its first row is the southernmost, or its first column the easternmost) is
    placed with rows that go north: otherwise the copy would show mirrored ground.
    Pixels that are not square on the ground stay so; `gsd_m` is the geometric mean of their sides.
    """
    wide, high = gsd_m * math.sqrt(claim.aspect), gsd_m / math.sqrt(claim.aspect)
    said = "local metres, origin at the lower left corner"
    if claim.usable:
        said += f"; the georeferencing of the input ({claim.why}) is not kept (--keep-origin keeps its place)"
    elif claim.why != NO_GEOREFERENCE:
        said += f"; the georeferencing of the input is neither used nor kept: {claim.why}"
    if claim.mirrored:
        return CopyGeoreference(
            LOCAL_CRS, Affine(wide, 0, 0, 0, high, 0), said + "; rows go north: it is mirrored like the input"
        )
    return CopyGeoreference(LOCAL_CRS, Affine(wide, 0, 0, 0, -high, high * height), said)


def kept_place(claim: Claim, height: int, gsd_m: float) -> CopyGeoreference:
    """The input's own coordinate reference system, first corner and direction, with pixels of the measured size.

    One factor on the geotransform achieves this in metres, feet and degrees, in any projection. If there is no place to
    keep, it is `local_place`.
    """
    t = claim.transform
    if t is None or claim.gsd_m is None:
        place = local_place(claim, height, gsd_m)
        return CopyGeoreference(place.crs, place.transform, f"{place.said}; there was no origin to keep")
    k = gsd_m / claim.gsd_m
    transform = Affine(t.a * k, t.b * k, t.c, t.d * k, t.e * k, t.f)
    name = pyproj.CRS.from_user_input(claim.crs).name if claim.crs is not None else "local metres"
    return CopyGeoreference(
        claim.crs or LOCAL_CRS,
        transform,
        f"{name}; the first corner is where it was, pixels are {k:.5g} times as large",
    )


def _aspect(across: float, down: float) -> float:
    """`Claim.aspect` of pixels `across` wide and `down` high; 1 for nearly square ones, since Web Mercator treats the
    ellipsoid as a sphere, which stretches one axis by up to 0.7 %."""
    return 1.0 if abs(across / down - 1) < NEARLY_SQUARE else across / down


def _ground_steps(width: int, height: int, t: Affine, system: pyproj.CRS) -> tuple[float, float, float]:
    """Ground length of one pixel step across and down at the image's centre, along geodesics [m], and by how much the
    two deviate from a right angle [deg].

    One method for metres, feet, degrees, stretched projections and rotated images. Raises ProjError if the centre is
    not a place on Earth.
    """
    x, y = width / 2, height / 2
    # Wide enough for rounding in inverse projections (some 10 nm) not to matter, narrow enough to be local.
    half = min(100.0, x, y)
    steps = np.array([[x - half, y], [x + half, y], [x, y - half], [x, y + half]])
    x, y = transformed(steps, t).T
    lon, lat = to_degrees(system).transform(x, y, errcheck=True)
    if not all(math.isfinite(a) and abs(b) <= 90 for a, b in zip(lon, lat, strict=True)):
        raise pyproj.exceptions.ProjError("outside of longitude and latitude")
    geod = pyproj.Geod(ellps="WGS84")
    azimuth, _, distance = geod.inv([lon[0], lon[2]], [lat[0], lat[2]], [lon[1], lon[3]], [lat[1], lat[3]])
    leaning = abs((azimuth[1] - azimuth[0]) % 180 - 90)
    return distance[0] / (2 * half), distance[1] / (2 * half), leaning
