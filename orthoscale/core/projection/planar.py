"""The planar projection (arXiv 2603.07535, without height): an orthophoto shows footprints, so a box is the vehicle."""

from __future__ import annotations

import numpy as np

from ..boxes import Boxes


def ground_size(boxes: Boxes, aspect: float = 1.0) -> np.ndarray:
    """(N, 2) length and width of each vehicle in pixels of the orthophoto.

    aspect : width over height of a pixel on the ground. Sizes are then in square pixels of the same area: lengths are
    stretched as their directions are, and widths shrink by the same factor, for areas stay the same.
    """
    across, down = np.cos(boxes.angle) * np.sqrt(aspect), np.sin(boxes.angle) / np.sqrt(aspect)
    longer = np.hypot(across, down)
    return boxes.sides * np.stack([longer, 1 / longer], -1)


def square_pixels(aspect: float) -> np.ndarray:
    """(2,) width and height of a pixel that is `aspect` times as wide as high [square pixels of the same area]."""
    wide = np.sqrt(aspect)
    return np.array([wide, 1 / wide])


def footprints(boxes: Boxes, aspect: float) -> np.ndarray:
    """(N, 4, 2) corners of `boxes` [px of the orthophoto] as rectangles on the ground, in the order of `Boxes.corners`:
    in pixels that are `aspect` times as wide as high, a box itself is a parallelogram there."""
    square = square_pixels(aspect)
    along = boxes.along * square
    level = np.column_stack([boxes.centre * square, ground_size(boxes, aspect), np.arctan2(along[:, 1], along[:, 0])])
    return Boxes(level, boxes.score).corners / square
