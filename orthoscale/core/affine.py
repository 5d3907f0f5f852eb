"""Affine transforms of the plane: from the pixels of a raster to map coordinates."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Affine(Protocol):
    """x' = a x + b y + c, y' = d x + e y + f: the six coefficients, named as in rasterio's transforms."""

    a: float
    b: float
    c: float
    d: float
    e: float
    f: float


def transformed(points: np.ndarray, t: Affine) -> np.ndarray:
    """(..., 2) `points` transformed by `t`: from (column, row) [px] to (x, y) of a map, for example."""
    x, y = np.moveaxis(np.asarray(points, float), -1, 0)
    return np.stack([t.a * x + t.b * y + t.c, t.d * x + t.e * y + t.f], -1)
