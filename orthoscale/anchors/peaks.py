"""Peaks between samples, and votes for the centres of circles."""

from __future__ import annotations

import numpy as np


def peak_shift(left: np.ndarray, middle: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Distance of the vertex of the parabola through three samples from the `middle` one, in sample steps, positive
    towards `right`; at most one step, and 0 where there is no maximum. All arrays have one shape."""
    bend = left - 2 * middle + right
    shift = np.where(bend < 0, 0.5 * (left - right) / np.where(bend < 0, bend, -1), 0)
    return np.clip(shift, -1, 1)


def circle_votes(
    place: tuple[np.ndarray, np.ndarray],
    normal: tuple[np.ndarray, np.ndarray],
    radius: float,
    shape: tuple[int, int],
    cell: int,
) -> np.ndarray:
    """(H / cell, W / cell) float32: how many points are `radius` [px] from a centre in each cell (Hough; Duda and Hart
    1972). place : x and y (N,) [px], normal : x and y (N,) of the unit vectors across the circle there. shape : (H, W)
    of the picture [px]. cell : side of a cell [px]."""
    (x, y), (nx, ny) = place, normal
    height, width = (-(-side // cell) for side in shape)
    cells = np.zeros(height * width, np.float32)
    for side in (-1, 1):
        column = np.floor((x + side * radius * nx + 0.5) / cell).astype(int)
        row = np.floor((y + side * radius * ny + 0.5) / cell).astype(int)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        cells += np.bincount(row[inside] * width + column[inside], minlength=len(cells)).astype(np.float32)
    return cells.reshape(height, width)
