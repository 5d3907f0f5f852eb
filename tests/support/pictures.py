"""Pictures that say nothing. Noise would take a PNG ten times as long, and reports have several."""

from __future__ import annotations

import numpy as np

SIDE = 16  # px of a square


def squares(width: int, height: int, low: int = 90, high: int = 110) -> np.ndarray:
    """uint8 (height, width, 3) of squares whose colours, from `low` to below `high`, change from each to the next."""
    down, across, channel = np.ogrid[:height, :width, :3]
    return (low + (7 * (across // SIDE) + 13 * (down // SIDE) + 5 * channel) % (high - low)).astype(np.uint8)
