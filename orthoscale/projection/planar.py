"""The planar variant (arXiv 2603.07535, without the height): an orthophoto shows footprints, so a box is a vehicle."""

from __future__ import annotations

import numpy as np

from ..boxes import Boxes


def ground_size(boxes: Boxes) -> np.ndarray:
    """(N, 2) length and width of each vehicle in pixels of the orthophoto."""
    return boxes.xylwa[:, 2:4].copy()
