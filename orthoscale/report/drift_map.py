"""A map of the local scale: cells coloured by the significance of their difference from the whole picture's."""

from __future__ import annotations

from collections.abc import Mapping
from math import log
from typing import Any

import cv2
import numpy as np

from ..core.normal import Z90
from ..formats.lettering import BLACK, WHITE, text_width, write_on
from .charts import strength
from .places import in_percent

SMALLER_RGB, NEUTRAL_RGB, LARGER_RGB = np.array([47, 127, 209]), np.array([250, 250, 250]), np.array([217, 115, 13])
SMALLEST_LETTERS = 8  # letters that can be read [px]
TITLE = 56  # height of the title above a map [px]
MOVES = 2000  # most times that overlapping squares are moved apart


def regions_panel(drift: Mapping[str, Any], scale: float, side: int) -> np.ndarray:
    """RGB picture `side` px wide of a model's regions from above, from the report's `drift` and its `scale`; coloured
    and labelled like the cells of `drift_panel`. Regions that would overlap are drawn side by side."""
    regions = drift["regions"]
    centres = np.array([region["centre_unit"] for region in regions]) * (1, -1)  # y up on the plan, down on paper
    square = side // 5
    zoom = (side - square) / np.maximum(np.ptp(centres, axis=0), 1e-12).max()
    corners = np.round(side_by_side((centres - centres.min(0)) * zoom, square)).astype(int)
    corners -= corners.min(0)
    # Squares that were moved apart may need more room than there is: then everything is drawn smaller.
    shrink = min(1.0, side / (corners[:, 0].max() + square))
    corners, square = (corners * shrink).astype(int), int(square * shrink)
    letters = max(SMALLEST_LETTERS, round(16 * shrink))
    panel = np.full((corners[:, 1].max() + square + TITLE, side, 3), 255, np.uint8)
    _entitle(panel)
    for region, corner in zip(regions, corners + (0, TITLE), strict=True):
        deviation, sd = log(region["scale"] / scale), region["sd"] / region["scale"]
        cv2.rectangle(panel, corner.tolist(), (corner + square - 2).tolist(), _colour(deviation, sd), -1)
        _label(panel, corner + square / 2, _figures(deviation, sd, region["vehicles"]), letters)
    return panel


def side_by_side(corners: np.ndarray, square: float) -> np.ndarray:
    """(N, 2) `corners` of squares [px], overlapping ones moved apart, each pair along the axis that needs less."""
    corners = corners.astype(float)
    for _ in range(MOVES):
        apart = corners[:, None] - corners[None]
        overlap = square - np.abs(apart).max(2) - 1e-6
        np.fill_diagonal(overlap, 0)
        one, other = np.unravel_index(np.argmax(overlap), overlap.shape)
        if overlap[one, other] <= 0:
            break
        axis = int(np.argmax(np.abs(apart[one, other])))
        way = 1 if apart[one, other, axis] >= 0 else -1
        corners[one, axis] += way * overlap[one, other] / 2
        corners[other, axis] -= way * overlap[one, other] / 2
    return corners


def drift_panel(drift: Mapping[str, Any], width: int, height: int, side: int) -> np.ndarray:
    """RGB picture with `side` px on the longer side of a raster of `width` x `height` px, from the report's `drift`.

    Each cell shows its deviation in per cent with its 90 % uncertainty, and its number of vehicles.
    """
    zoom = side / max(width, height)
    panel = np.full((round(height * zoom) + TITLE, round(width * zoom), 3), 255, np.uint8)
    change = f"{100 * drift['tilt']:.1f} % from side to side, +- {100 * Z90 * drift['tilt_sd']:.1f} (90 %)"
    _entitle(panel, f"; {change}")
    half = np.array(drift["cell_px"]) / 2
    for cell in drift["cells"]:
        x, y, count, deviation, sd = (cell[name] for name in ("x_px", "y_px", "vehicles", "deviation", "sd"))
        low = np.round((np.array([x, y]) - half) * zoom).astype(int) + (0, TITLE)
        high = np.round((np.array([x, y]) + half) * zoom).astype(int) + (0, TITLE)
        cv2.rectangle(panel, low.tolist(), high.tolist(), _colour(deviation, sd), -1)
        cv2.rectangle(panel, low.tolist(), high.tolist(), (190, 190, 190), 1)
        middle, across = (low + high) / 2, int(high[0] - low[0])
        figures = _figures(deviation, sd, count)
        size = min(16, int(0.9 * across / max(text_width(line, 100) / 100 for line in figures)))
        if size >= SMALLEST_LETTERS:
            _label(panel, middle, figures, size)
    return panel


def _entitle(panel: np.ndarray, more: str = "") -> None:
    """Write the map's title and key onto the TITLE rows of `panel`."""
    write_on(panel, (10, 22), f"Scale by place: the scale drifts{more}", 17)
    key = "Per cent from the overall scale, +- 90 %. Pale: chance. Orange: larger, blue: smaller, full from 3 sigma"
    write_on(panel, (10, 45), key, 14)


def _colour(deviation: float, sd: float) -> list[float]:
    """RGB of a cell whose scale deviates by `deviation` (log), with one sigma `sd`."""
    full = LARGER_RGB if deviation > 0 else SMALLER_RGB
    return (NEUTRAL_RGB + strength(deviation, sd) * (full - NEUTRAL_RGB)).tolist()


def _figures(deviation: float, sd: float, count: float) -> tuple[str, str]:
    """The two lines on a cell."""
    larger, half = in_percent(deviation, sd)
    return f"{larger:+.1f} +- {half:.1f}", f"{int(count)} vehicle{'' if count == 1 else 's'}"


def _label(panel: np.ndarray, middle: np.ndarray, lines: tuple[str, str], size: int) -> None:
    """Write `lines` about the `middle` (2,) of a cell, in letters `size` px high."""
    for row, line in zip((-0.6, 0.6), lines, strict=True):
        write_on(panel, (middle[0], middle[1] + 1.2 * size * row), line, size, BLACK, WHITE, "mm")
