"""Decoders: from a network's output arrays to boxes."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..core.boxes import Boxes

# The encoding of boxes in the network's maps; `training/targets.py` writes it.
MAP_STRIDE = 4
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
            (x + dx + 0.5) * MAP_STRIDE,
            (y + dy + 0.5) * MAP_STRIDE,
            LENGTH_UNIT * np.exp(np.clip(log_length, -4, 4)),
            WIDTH_UNIT * np.exp(np.clip(log_width, -4, 4)),
            np.arctan2(sin2, cos2) / 2,
        ],
        -1,
    )
    return _plausible(xylwa, 1 / (1 + np.exp(-heat)))


def decode_ultralytics(output: np.ndarray, vehicles: Sequence[int], threshold: float) -> Boxes:
    """Boxes [px of the network's input] from an Ultralytics OBB head, (4 + classes + 1, n).

    Rows: centre x, y, width, height [px], one confidence per class, angle [rad] of the width from +x, clockwise on
    screen. An anchor counts as its most confident class; anchors of other classes than `vehicles` are dropped.
    """
    best = output[4:-1].argmax(0)
    score = np.take_along_axis(output[4:-1], best[None], 0)[0]
    keep = np.isin(best, vehicles) & (score > threshold)
    return _plausible(np.concatenate([output[:4], output[-1:]]).T[keep], score[keep])


def decode_ultralytics_nms_free(output: np.ndarray, vehicles: Sequence[int], threshold: float) -> Boxes:
    """Boxes [px of the network's input] from an Ultralytics head whose output needs no non-maximum suppression, (n, 7):
    centre x, y, width, height [px], confidence, class, angle [rad]; unused rows have confidence 0."""
    keep = np.isin(np.rint(output[:, 5]), vehicles) & (output[:, 4] > threshold)
    return _plausible(output[keep][:, [0, 1, 2, 3, 6]], output[keep, 4])


def decode_mmrotate(dets: np.ndarray, labels: np.ndarray, vehicles: Sequence[int], threshold: float) -> Boxes:
    """Boxes [px of the network's input] from MMDeploy's rotated detectors: `dets` (n, 6), centre x, y, width, height
    [px], angle [rad] of the width from +x, clockwise on screen, confidence; `labels` (n,) class numbers."""
    keep = np.isin(labels, vehicles) & (dets[:, 5] > threshold)
    return _plausible(dets[keep, :5], dets[keep, 5])


def _plausible(xywha: np.ndarray, score: np.ndarray) -> Boxes:
    """As Boxes, without those that have no size or are not numbers (padding rows, half-precision overflow)."""
    good = np.isfinite(xywha).all(1) & (xywha[:, 2:4] > 0).all(1)
    return Boxes(xywha[good], score[good])
