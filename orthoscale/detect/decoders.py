"""From a network's output arrays to boxes."""

from __future__ import annotations

import cv2
import numpy as np

from ..boxes import Boxes

# How `training/targets.py` writes boxes; see there.
STRIDE = 4
LENGTH_UNIT, WIDTH_UNIT = 32.0, 14.0


def decode_maps(maps: np.ndarray, threshold: float) -> Boxes:
    """Boxes [px of the network's input] from maps (7, h, w): every local peak of the heat above `threshold`."""
    logit_threshold = np.float32(np.log(threshold / (1 - threshold)))
    heat = maps[0]
    peaks = (heat > logit_threshold) & (heat >= cv2.dilate(heat, np.ones((3, 3), np.uint8)))
    y, x = np.nonzero(peaks)
    heat, dx, dy, log_length, log_width, cos2, sin2 = maps[:, y, x].astype(np.float64)
    xylwa = np.stack(
        [
            (x + dx + 0.5) * STRIDE,
            (y + dy + 0.5) * STRIDE,
            LENGTH_UNIT * np.exp(np.clip(log_length, -4, 4)),
            WIDTH_UNIT * np.exp(np.clip(log_width, -4, 4)),
            np.arctan2(sin2, cos2) / 2,
        ],
        -1,
    )
    return Boxes(xylwa, 1 / (1 + np.exp(-heat)))
