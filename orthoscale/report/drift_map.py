"""A map of the scale by place: cells coloured by how far their vehicles' scale is from the whole picture's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

FULL = 0.1  # relative deviation with full colour
SMALLER, NEUTRAL, LARGER = np.array([70, 110, 220]), np.array([245, 245, 245]), np.array([220, 90, 60])  # RGB
FONT = cv2.FONT_HERSHEY_SIMPLEX


def drift_panel(drift: Mapping[str, Any], width: int, height: int, side: int) -> np.ndarray:
    """RGB picture with `side` px on the longer side of a raster of `width` x `height` px, from the report's `drift`.

    Each cell shows its deviation in per cent and, below, its one sigma and its number of vehicles.
    """
    zoom = side / max(width, height)
    title = 34
    panel = np.full((round(height * zoom) + title, round(width * zoom), 3), 255, np.uint8)
    text = (
        f"scale by place: tilt {100 * drift['tilt']:.1f} +- {100 * drift['tilt_sd']:.1f} %, p = {drift['p_tilt']:.2g}"
    )
    cv2.putText(panel, text, (10, 23), FONT, 0.55, (20, 20, 20), 1, cv2.LINE_AA)
    half = np.array(drift["cell_px"]) / 2
    for cell in drift["cells"]:
        x, y, count, deviation, sd = (cell[name] for name in ("x_px", "y_px", "vehicles", "deviation", "sd"))
        share = float(np.clip(deviation / FULL, -1, 1))
        colour = NEUTRAL + abs(share) * ((LARGER if share > 0 else SMALLER) - NEUTRAL)
        low = np.round((np.array([x, y]) - half) * zoom).astype(int) + (0, title)
        high = np.round((np.array([x, y]) + half) * zoom).astype(int) + (0, title)
        cv2.rectangle(panel, low.tolist(), high.tolist(), colour.tolist(), -1)
        cv2.rectangle(panel, low.tolist(), high.tolist(), (190, 190, 190), 1)
        for row, line in enumerate((f"{100 * deviation:+.1f}", f"{100 * sd:.1f} n{int(count)}")):
            where = (int(low[0]) + 5, int((low[1] + high[1]) // 2) + 15 * row)
            cv2.putText(panel, line, where, FONT, 0.42, (30, 30, 30), 1, cv2.LINE_AA)
    return panel
