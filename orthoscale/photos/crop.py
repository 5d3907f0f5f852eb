"""Satellite crops as large as a photo's footprint, for cross-view retrieval (arXiv 2603.07535, scale-adaptive crops).

A photo of ``footprint`` metres covers ``footprint / GSD_sat`` pixels of a satellite picture. Windows of that size are
cut over a search area, each shifted by half of its size, and resampled to the photo's size. So a network that does not
handle scale compares pictures of one scale.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.progress import Progress
from ..core.source import Picture
from ..errors import UsageError
from ..formats.names import write_json
from ..formats.pictures import write_jpeg
from ..option import positive
from ..sources.satellite import Satellite

CROP_FORMAT = "orthoscale crop 1"
MOST_WINDOWS = 100_000
QUALITY = 95  # of the JPEGs
CROP_STRIDE = 0.5  # of a window's size by which the next one is shifted, by default; as in the paper
CROP_COLUMNS = ("file", "longitude", "latitude", "column_px", "row_px", "width_px", "height_px", "width_m", "height_m")


@dataclass(frozen=True)
class Crops:
    """Windows (n, 4) x, y, width, height of the satellite picture [px], each `size` (2,) metres on the ground, to be
    resampled to `out` (width, height) px; `pixel` (2,) is the satellite picture's pixel size [m]; `query` is the part
    of the photo to compare (x, y, width, height) [px]."""

    satellite: Satellite
    windows: np.ndarray
    size: np.ndarray
    pixel: np.ndarray
    out: tuple[int, int]
    query: tuple[int, int, int, int]


def plan_crops(
    satellite: Satellite,
    gsd: float,
    photo_size: tuple[int, int],
    at: tuple[float, float] | None = None,
    radius: float | None = None,
    square: bool = False,
    stride: float | None = None,
    out_px: int | None = None,
) -> Crops:
    """Windows as large as the footprint of a photo with `photo_size` px at `gsd` metres per pixel.

    at : longitude and latitude of the search area's middle; the whole picture by default. radius : half of its side
    [m]; one window at `at` by default. square : cut squares of the photo's shorter side, for networks that need
    squares.
    stride : share of its size by which each window is shifted, by default CROP_STRIDE. out_px : longer side of the
    crops [px], the photo's own by default.
    Raises UsageError for a place or a footprint that the satellite picture does not hold, a stride of less than a
    pixel, more than MOST_WINDOWS windows.
    """
    _check_search(gsd, at, radius, stride)
    width, height = photo_size
    query = (0, 0, width, height)
    if square:
        side = min(photo_size)
        query = ((width - side) // 2, (height - side) // 2, side, side)
    whole = np.array([satellite.source.width, satellite.source.height], float)
    middle = whole / 2
    if at is not None:
        middle = satellite.pixel_of(*at)
        if not ((middle >= 0) & (middle <= whole)).all():
            raise UsageError(f"{at[0]:g}, {at[1]:g} is not in {satellite.source.name}", satellite.extent_in_words())
    pixel = satellite.pixel_size(middle)
    size = gsd * np.array(query[2:], float)
    window = np.maximum(np.rint(size / pixel).astype(int), 1)
    if (window > whole).any():
        raise UsageError(
            f"the photo shows {size[0]:.0f} x {size[1]:.0f} m, {window[0]} x {window[1]} px of "
            f"{satellite.source.name}, which has {whole[0]:.0f} x {whole[1]:.0f}",
            "Give a larger satellite picture.",
        )
    if stride is not None and (shift := stride * int(window.min())) < 1:
        raise UsageError(
            f"--stride {stride:g} shifts crops by {shift:.2g} px of {satellite.source.name}, less than a pixel",
            f"Give {1 / window.min():.2g} or more.",
        )
    reach = (radius or 0.0) / pixel
    low, high = (np.zeros(2), whole) if at is None else (middle - reach, middle + reach)
    windows = _windows(window, low, high, whole, stride or CROP_STRIDE)
    zoom = 1.0 if out_px is None else out_px / max(query[2:])
    out = max(1, round(query[2] * zoom)), max(1, round(query[3] * zoom))
    return Crops(satellite, windows, window * pixel, pixel, out, query)


def _check_search(gsd: float, at: tuple[float, float] | None, radius: float | None, stride: float | None) -> None:
    """Raise UsageError for arguments of `plan_crops` that make no sense, alone or together."""
    if stride is not None and not 0 < stride <= 1:
        raise UsageError(f"--stride must lie between 0 and 1, not {stride:g}")
    if radius is not None and at is None:
        raise UsageError("--radius needs the middle of the search area", "Give --at LON,LAT.")
    if radius is None and at is not None and stride is not None:
        raise UsageError("--stride does nothing here: --at without --radius is one crop", "Give --radius METRES.")
    positive("--gsd", gsd)
    if radius is not None:
        positive("--radius", radius)


def _windows(window: np.ndarray, low: np.ndarray, high: np.ndarray, whole: np.ndarray, stride: float) -> np.ndarray:
    """(n, 4) windows of the size `window` (2,) within a picture of the size `whole` (2,), as in `Crops`. Their centres
    cover the area from `low` to `high` (2,) evenly, a share of `stride` of the size apart [px]. Raises UsageError for
    more than MOST_WINDOWS."""
    first, last = np.clip([low - window / 2, high - window / 2], 0, whole - window)
    shifts = np.maximum(stride * window, 1)
    steps = np.ceil((last - first) / shifts - 1e-9).astype(int)
    count = math.prod((steps + 1).tolist())  # counted before any is made
    if count > MOST_WINDOWS:
        raise UsageError(f"{count} windows are too many", "Limit the search area: --at LON,LAT --radius METRES.")
    starts = [np.unique(np.rint(np.linspace(first[k], last[k], steps[k] + 1)).astype(int)) for k in (0, 1)]
    x, y = (a.ravel() for a in np.meshgrid(*starts))
    return np.column_stack([x, y, np.full(len(x), window[0]), np.full(len(x), window[1])])


def write_crops(
    crops: Crops,
    photo: Picture,
    told: dict[str, Any],
    folder: Path,
    progress: Progress | None = None,
) -> None:
    """Write into the empty `folder`: query.jpg, gallery/*.jpg, manifest.csv with a line per crop, and crop.json with
    what was done.

    told : entries of crop.json on the photo. Raises OutputError, InputError.
    """
    source = crops.satellite.source
    centres = crops.satellite.lon_lat(crops.windows[:, :2] + crops.windows[:, 2:] / 2)
    digits = max(4, len(str(len(crops.windows))))
    (folder / "gallery").mkdir()
    x, y, width, height = crops.query
    write_jpeg(folder / "query.jpg", photo.read(x, y, width, height, *crops.out), QUALITY)
    with (folder / "manifest.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(CROP_COLUMNS)
        in_file = crops.satellite.in_file(crops.windows).tolist()
        for k, ((x, y, width, height), stored, (lon, lat)) in enumerate(
            zip(crops.windows.tolist(), in_file, centres, strict=True)
        ):
            name = f"gallery/{k:0{digits}d}.jpg"
            write_jpeg(folder / name, source.read(x, y, width, height, *crops.out), QUALITY)
            metres = [f"{v:.3f}" for v in crops.size]
            table.writerow([name, f"{lon:.8f}", f"{lat:.8f}", *stored, *metres])
            if progress:
                progress("Cutting crops", k + 1, len(crops.windows))
    write_json(document(crops, told), folder / "crop.json")


def document(crops: Crops, told: dict[str, Any]) -> dict[str, Any]:
    """What was cut, as plain values, together with `told`."""
    return {
        "format": CROP_FORMAT,
        **told,
        "satellite": str(crops.satellite.source.path),
        "satellite_pixel_m": crops.pixel.tolist(),
        "window_px": crops.windows[0, 2:].tolist(),
        "window_m": crops.size.tolist(),
        "out_px": list(crops.out),
        "query_px": list(crops.query),
        "crops": len(crops.windows),
    }
