"""Reads depth maps from files: NumPy arrays, TIFF of one band, PNG of 16 bits."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import InputError
from ...formats.reading import check_regular
from ...system.budget import require

MAP_ENDINGS = (".npy", ".tif", ".tiff", ".png")
MAP_HINT = "Give one depth for each pixel: an array (.npy), a TIFF of one band, or a PNG of 16 bit."


def read_depth(path: Path, factor_told: bool) -> np.ndarray:
    """(H, W) float32 in the file's own unit; NaN where there is no depth, which files write as 0, NaN or no-data.

    factor_told : whether the user gave the unit; without it, whole numbers are refused. Raises InputError.
    """
    check_regular(path, MAP_HINT)
    values = _array(path) if path.suffix.lower() == ".npy" else _band(path)
    if values.dtype.kind in "ui" and not factor_told:
        raise InputError(
            f"{path}: its depths are whole numbers, and nothing states their unit",
            "Give the metres per unit: --depth-factor 0.001 for millimetres.",
        )
    depth = values.astype(np.float32)
    depth[~(np.isfinite(depth) & (depth > 0))] = np.nan
    if not np.isfinite(depth).any():
        raise InputError(f"{path}: no depth above 0 in it", MAP_HINT)
    return depth


def _array(path: Path) -> np.ndarray:
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError, SyntaxError) as error:
        raise InputError(f"{path}: not a readable NumPy array", MAP_HINT) from error
    values = values.reshape([n for n in values.shape if n != 1]) if values.size else values
    if values.ndim != 2 or values.dtype.kind not in "fui":
        raise InputError(f"{path}: an array of shape {values.shape} and type {values.dtype}, not a depth map", MAP_HINT)
    require(8 * values.size, f"{path}")
    return values


def _band(path: Path) -> np.ndarray:
    from ...sources.gdal import open_dataset, reading

    with reading(path, "cannot be read as a depth map", MAP_HINT), open_dataset(path) as raster:
        if raster.count != 1 or raster.dtypes[0] not in ("uint16", "int16", "uint32", "int32", "float32", "float64"):
            what = f"{raster.count} bands" if raster.count > 1 else raster.dtypes[0]
            raise InputError(f"{path}: {what}: a picture of a depth, not the depth itself", MAP_HINT)
        require(8 * raster.width * raster.height, f"{path}")
        return raster.read(1, masked=True).filled(0)
