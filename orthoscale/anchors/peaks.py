"""Peaks between samples, and the centres of circles by votes."""

from __future__ import annotations

import cv2
import numpy as np


def peak_shift(left: np.ndarray, middle: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Distance of the vertex of the parabola through three samples from the `middle` one, in sample steps, positive
    towards `right`; at most one step, and 0 where there is no maximum. All arrays have one shape."""
    bend = left - 2 * middle + right
    shift = np.where(bend < 0, 0.5 * (left - right) / np.where(bend < 0, bend, -1), 0)
    return np.clip(shift, -1, 1)


def circle_centres(
    place: tuple[np.ndarray, np.ndarray],
    normal: tuple[np.ndarray, np.ndarray],
    radius: float,
    shape: tuple[int, int],
    cell: int,
    least: float,
) -> np.ndarray:
    """(K, 4) x, y, `radius` [px] and votes of the centres of circles: cells with at least `least` votes, and no fewer
    than those around. The votes of a cell are the points that lie `radius` from a centre in it or in a cell next to it,
    as a share of the circumference (Hough; Duda and Hart 1972). place : x and y (N,) [px], normal : x and y (N,) of
    the unit vectors across the circle there. shape : (H, W) of the picture [px]. cell : side of a cell [px]."""
    (x, y), (nx, ny) = place, normal
    height, width = (-(-side // cell) for side in shape)
    cells = np.zeros(height * width, np.float32)
    for side in (-1, 1):
        column = np.floor((x + side * radius * nx + 0.5) / cell).astype(int)
        row = np.floor((y + side * radius * ny + 0.5) / cell).astype(int)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        cells += np.bincount(row[inside] * width + column[inside], minlength=len(cells)).astype(np.float32)
    about = cv2.boxFilter(cells.reshape(height, width), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    votes = about / np.float32(2 * np.pi * radius)
    row, column = np.nonzero((votes >= least) & (votes >= cv2.dilate(votes, np.ones((5, 5), np.uint8))))
    middle = (np.stack([column, row], 1) + 0.5) * cell - 0.5
    return np.column_stack([middle, np.full(len(row), radius), votes[row, column]])
