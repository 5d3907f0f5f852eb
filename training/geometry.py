"""The geometry of crops: one affine map for pixels and boxes."""

from __future__ import annotations

import cv2
import numpy as np

from .data import LabelledImage
from .targets import CROP

LENGTH_RANGE = (11.0, 75.0)  # vehicle length in a crop [px]
MAX_ENLARGEMENT = 2.6  # coarse orthophotos are enlarged as much for the detector, whatever the blur


def warp(
    image: LabelledImage, linear: np.ndarray, shift: np.ndarray, scale: float, rng: np.random.Generator
) -> np.ndarray:
    """The crop's pixels, uint8 (CROP, CROP, 3).

    A reduction starts from one of the two half-size levels next to `scale`, by chance: the finer one gives sharper
    edges, the coarser one softer edges than the area filter that reduces pictures for the detector. A size must not
    depend on that (version 2 of the weights, trained on sharp ones, made boxes 2 % larger in the coarse pass).
    """
    octave = int(np.clip(np.floor(np.log2(1 / scale) + rng.random()), 0, 3))
    source = image.level(octave)
    # OpenCV puts a pixel's centre at its integer index, the labels put it half a pixel further.
    a = linear * shrunk_by(image.level(0), source)
    t = shift + a @ (0.5, 0.5) - 0.5
    return cv2.warpAffine(
        source, np.c_[a, t], (CROP, CROP), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
        borderValue=(114, 114, 114),
    )  # fmt: skip


def shrunk_by(picture: np.ndarray, level: np.ndarray) -> np.ndarray:
    """(2,) size of a pixel of `level` in pixels of `picture`, across and down. It is not quite a power of two, since
    half of an odd size is rounded down, although the level shows the whole picture."""
    return np.array([picture.shape[k] / level.shape[k] for k in (1, 0)])


def transform_boxes(boxes: np.ndarray, linear: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Boxes (N, 5) under the affine map; the width keeps the area of the sheared box."""
    out = boxes.copy()
    out[:, :2] = boxes[:, :2] @ linear.T + shift
    along = np.c_[np.cos(boxes[:, 4]), np.sin(boxes[:, 4])]
    across = np.c_[-along[:, 1], along[:, 0]]
    long_side = (along * boxes[:, 2:3]) @ linear.T
    short_side = (across * boxes[:, 3:4]) @ linear.T
    out[:, 2] = np.hypot(*long_side.T)
    out[:, 3] = np.abs(long_side[:, 0] * short_side[:, 1] - long_side[:, 1] * short_side[:, 0]) / out[:, 2]
    out[:, 4] = np.arctan2(long_side[:, 1], long_side[:, 0])
    return out
