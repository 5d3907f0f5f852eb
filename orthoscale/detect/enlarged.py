"""By how much a picture was enlarged beyond its detail.

Maps are resampled: an orthophoto may have two or four pixels for one of its frames. Edges are then blurred over more
pixels, and properties of boxes that are known in pixels (the ruler's margin, the uncertainty of edges) do not hold. So
vehicles are measured at the picture's true resolution: reduced as far as no detail is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import cv2
import numpy as np

AS_IT_IS = Fraction(1)  # of a picture that is not enlarged
FACTORS = tuple(map(Fraction, ("5/4", "3/2", "2", "3", "4")))
# Share of a window's contrast (RMS) that is lost by reducing and enlarging it again, up to which that loses nothing. Of
# twelve orthophotos 0.056 to 0.26 are lost by 5/4 as they are; enlarged by cubic splines and stored in 8 bits, 0.025 to
# 0.10 of those by 3/2, 0.016 to 0.07 of those by 2, 0.02 to 0.08 of those by 4, by as much (2026-11-23).
LOST = 0.05


def enlargement(windows: Sequence[np.ndarray]) -> Fraction:
    """The largest of FACTORS by which pictures can be reduced with hardly any loss in their `windows`
    (`windows_about`), 1 if none."""
    if not windows:
        return AS_IT_IS
    kept = np.median([_lost(window) for window in windows], axis=0) < LOST
    fine = FACTORS[: int(np.logical_and.accumulate(kept).sum())]
    return fine[-1] if fine else AS_IT_IS


def _lost(window: np.ndarray) -> list[float]:
    """Of each of FACTORS, how much of the contrast of a window (H, W) is lost by it."""
    window, (height, width) = window.astype(np.float32), window.shape
    contrast = max(float(window.std()), 1.0)
    out = []
    for factor in FACTORS:
        size = max(1, round(width / factor)), max(1, round(height / factor))
        small = cv2.resize(window, size, interpolation=cv2.INTER_AREA)
        again = cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
        out.append(float(np.sqrt(((window - again) ** 2).mean())) / contrast)
    return out
