"""Pictures without content. Noise would take ten times as long to write as PNG, and reports have several pictures."""

from __future__ import annotations

import numpy as np

SIDE = 16  # px of a square


def squares(width: int, height: int, low: int = 90, high: int = 110) -> np.ndarray:
    """uint8 (height, width, 3) of squares; neighbours have different colours, from `low` to below `high`."""
    down, across, channel = np.ogrid[:height, :width, :3]
    return (low + (7 * (across // SIDE) + 13 * (down // SIDE) + 5 * channel) % (high - low)).astype(np.uint8)
