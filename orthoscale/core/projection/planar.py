"""The planar variant (arXiv 2603.07535, without the height): an orthophoto shows footprints, so a box is a vehicle."""

from __future__ import annotations

import numpy as np

from ..boxes import Boxes


def ground_size(boxes: Boxes, aspect: float = 1.0) -> np.ndarray:
    """(N, 2) length and width of each vehicle in pixels of the orthophoto.

    aspect : how many times as wide as high a pixel is on the ground. What is told then is in square pixels of the same
    area: lengths grow as their directions do, and widths shrink as much, for areas stay.
    """
    across, down = np.cos(boxes.angle) * np.sqrt(aspect), np.sin(boxes.angle) / np.sqrt(aspect)
    longer = np.hypot(across, down)
    return boxes.xylwa[:, 2:4] * np.stack([longer, 1 / longer], -1)


def square_pixels(aspect: float) -> np.ndarray:
    """(2,) width and height of a pixel that is `aspect` times as wide as high, in square pixels of the same area."""
    wide = np.sqrt(aspect)
    return np.array([wide, 1 / wide])
