"""By how much a picture was enlarged beyond its detail.

Maps are resampled: an orthophoto may have two or four pixels where its frames had one. Edges are then blurred over more
pixels, and properties of boxes that are known in pixels (the ruler's margin, the uncertainty of edges) do not hold. So
vehicles are measured at the picture's true resolution: the picture is reduced as far as no detail is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import cv2
import numpy as np

AS_IT_IS = Fraction(1)  # of a picture that is not enlarged
FACTORS = tuple(map(Fraction, ("5/4", "3/2", "2", "3", "4")))
# Share of a window's contrast (RMS) that reducing it and enlarging it again may lose and still count as no loss.
# Measured on twelve orthophotos (2026-11-23): as they are, a reduction by 5/4 loses 0.056 to 0.26. If they were first
# enlarged by cubic splines and stored in 8 bits, a reduction by the same factor loses 0.025 to 0.10 for 3/2, 0.016 to
# 0.07 for 2, and 0.02 to 0.08 for 4.
LOST = 0.05


def enlargement(windows: Sequence[np.ndarray]) -> Fraction:
    """The largest of FACTORS by which pictures can be reduced with hardly any loss in their `windows`
    (`windows_about`); 1 if there is none."""
    if not windows:
        return AS_IT_IS
    kept = np.median([_lost(window) for window in windows], axis=0) < LOST
    fine = FACTORS[: int(np.logical_and.accumulate(kept).sum())]
    return fine[-1] if fine else AS_IT_IS


def _lost(window: np.ndarray) -> list[float]:
    """For each of FACTORS, the share of the contrast of a window (H, W) that a reduction by it loses."""
    window, (height, width) = window.astype(np.float32), window.shape
    contrast = max(float(window.std()), 1.0)
    out = []
    for factor in FACTORS:
        size = max(1, round(width / factor)), max(1, round(height / factor))
        small = cv2.resize(window, size, interpolation=cv2.INTER_AREA)
        again = cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
        out.append(float(np.sqrt(((window - again) ** 2).mean())) / contrast)
    return out
