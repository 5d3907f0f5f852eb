"""Pictures without content. Noise would take ten times as long to write as PNG, and reports have several pictures."""

from __future__ import annotations

import numpy as np

SIDE = 16  # px of a square
ODD_PICTURES = {
    "one pixel": np.zeros((1, 1, 3), np.uint8),
    "a strip": np.zeros((5, 900, 3), np.uint8),
    "white": np.full((200, 200, 3), 255, np.uint8),
    "noise": np.random.default_rng(0).integers(0, 256, (250, 240, 3), np.uint8),
    "chequered": np.kron(np.indices((40, 40)).sum(0) % 2, np.ones((6, 6)))[..., None].repeat(3, 2).astype(np.uint8)
    * 255,
}


def squares(width: int, height: int, low: int = 90, high: int = 110) -> np.ndarray:
    """uint8 (height, width, 3) of squares; neighbours have different colours, from `low` to below `high`."""
    down, across, channel = np.ogrid[:height, :width, :3]
    return (low + (7 * (across // SIDE) + 13 * (down // SIDE) + 5 * channel) % (high - low)).astype(np.uint8)
