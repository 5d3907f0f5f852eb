"""What pictures of painted ground share: the paint in each pixel, and the camera that looks straight down on it."""

from __future__ import annotations

import cv2
import numpy as np


def covered(x, y, gsd, box):
    """Share of each pixel, at (x, y) [m] in the frame of the ground, that the rectangle (or ring) covers; exact for a
    rectangle parallel to the pixels."""
    if len(box) == 6:  # a ring: its middle, both radii, and on which sides of the middle it is, 0 for both
        gap = np.hypot(x - box[0], y - box[1])
        inside = np.clip(np.minimum(box[3], gap + gsd / 2) - np.maximum(box[2], gap - gsd / 2), 0, gsd) / gsd
        return inside * ((x - box[0]) * box[4] >= 0) * ((y - box[1]) * box[5] >= 0)
    x0, y0, x1, y1 = box
    part = [np.clip(np.minimum(high, at + gsd / 2) - np.maximum(low, at - gsd / 2), 0, gsd) / gsd
            for at, low, high in ((x, x0, x1), (y, y0, y1))]  # fmt: skip
    return part[0] * part[1]


def photographed(ground, fine, shape, blur_px, noise, rng):
    """RGB uint8 of `shape` (H, W) [px]: `ground`, drawn with `fine` cells to each side of a pixel, through a lens that
    blurs by `blur_px`, with the `noise` of the sensor (both one sigma)."""
    image = cv2.GaussianBlur(ground, (0, 0), blur_px * fine)
    image = cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA)
    return np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
