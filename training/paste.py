"""Cuts vehicles out of one image and pastes them onto ground of another that has none.

Scenes without vehicles teach what is not a vehicle; with some pasted in they also teach that a vehicle on a lawn is
one. A pasted patch has a seam, which must not give the vehicle away: so as many patches of bare ground are pasted, too.
"""

from __future__ import annotations

import cv2
import numpy as np

from .data import LabelledImage
from .geometry import LENGTH_RANGE, MAX_ENLARGEMENT, transform_boxes, warp
from .targets import CROP

MOST = 4  # patches on one crop
RIM = 0.12  # rim around a vehicle that is cut out with it, in widths: its contact shadow and some ground
ASIDE = 1.5  # distance from a vehicle to the bare ground that is cut out beside it, in vehicle lengths


def paste(
    pixels: np.ndarray, boxes: np.ndarray, donors: list[LabelledImage], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Paste vehicles of `donors` into the crop `pixels` (CROP, CROP, 3) uint8, clear of its `boxes` (N, 5); returns the
    crop and the boxes (M, 5) added to it."""
    added: list[np.ndarray] = []
    occupied = [(*box[:2], box[2]) for box in boxes]
    for _ in range(rng.integers(1, MOST + 1)):
        donor = donors[rng.integers(len(donors))]
        source = donor.vehicles[rng.integers(len(donor.vehicles))].copy()
        decoy = rng.random() < 0.5
        if decoy:
            way = rng.uniform(0, 2 * np.pi)
            source[:2] += ASIDE * source[2] * np.array([np.cos(way), np.sin(way)])
            if _near(source, donor) or not (0 < source[0] < donor.width and 0 < source[1] < donor.height):
                continue
        scale = min(np.exp(rng.uniform(*np.log(LENGTH_RANGE))) / source[2], MAX_ENLARGEMENT)
        turn, place = rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 0.9, 2) * CROP
        linear = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        shift = place - linear @ source[:2]
        box = transform_boxes(source[None], linear, shift)[0]
        if any(np.hypot(x - box[0], y - box[1]) < (length + box[2]) / 2 for x, y, length in occupied):
            continue
        rim = RIM * box[3] * 2
        outline = ((box[0] - 0.5, box[1] - 0.5), (box[2] + rim, box[3] + rim), np.degrees(box[4]))
        mask = np.zeros(pixels.shape[:2], np.float32)
        cv2.fillConvexPoly(mask, np.round(cv2.boxPoints(outline)).astype(np.int32), 1.0)
        mask = cv2.GaussianBlur(mask, (0, 0), 0.05 * box[3] + 0.5)[..., None]
        pixels = (mask * warp(donor, linear, shift, scale, rng) + (1 - mask) * pixels).round().astype(np.uint8)
        occupied.append((box[0], box[1], box[2]))
        if not decoy:
            added.append(box)
    return pixels, np.array(added).reshape(-1, 5)


def _near(box: np.ndarray, image: LabelledImage) -> bool:
    away = np.hypot(*(image.boxes[:, :2] - box[:2]).T)
    return bool((away < (image.boxes[:, 2] + box[2]) / 2).any())
