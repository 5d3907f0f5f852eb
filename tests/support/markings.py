"""Pictures of painted strokes on a road, drawn from their corners in metres, with a camera's blur and noise."""

from __future__ import annotations

import cv2
import numpy as np

FINER = 4  # supersampling; corners are exact to a sixteenth of a sample
ROAD, PAINT = (104, 104, 108), (222, 222, 218)


def stroke(x, y, length, width, degrees=0.0):
    """(4, 2) corners [m] of a bar about (x, y) that runs at `degrees` from +x."""
    turn = np.radians(degrees)
    along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [length / 2, width / 2]
    return np.array([x, y]) + half[:, :1] * along + half[:, 1:] * across


def picture(shapes, gsd, metres=(60, 45), turn=0.0, ground=ROAD, blur=0.6, noise=3.0, seed=0):
    """RGB uint8: `shapes` are (corners [m], colour); all turned by `turn` degrees about the middle of the picture."""
    rng = np.random.default_rng(seed)
    width, height = (int(round(side / gsd)) for side in metres)
    canvas = np.full((height * FINER, width * FINER, 3), ground, np.uint8)
    middle, t = np.array(metres) / 2, np.radians(turn)
    rotation = np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])
    for corners, colour in shapes:
        pixels = ((corners - middle) @ rotation.T + middle) / gsd * FINER - 0.5
        cv2.fillPoly(canvas, [np.round(pixels * 16).astype(np.int32)], colour, shift=4)
    image = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA).astype(float)
    image = cv2.GaussianBlur(image, (0, 0), blur)
    slow = cv2.resize(
        rng.normal(0, 6, (height // 40 + 2, width // 40 + 2)), (width, height), interpolation=cv2.INTER_CUBIC
    )
    image += slow[..., None] + rng.normal(0, noise, image.shape[:2])[..., None]
    return image.clip(0, 255).astype(np.uint8)
