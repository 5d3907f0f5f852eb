"""By how much a picture was enlarged beyond its detail.

Maps are resampled: an orthophoto may have two or four pixels for one of its frames. Edges are then blurred over more
pixels, and properties of boxes that are known in pixels (the ruler's margin, the uncertainty of edges) do not hold. So
vehicles are measured at the picture's true resolution: reduced as far as no detail is lost.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction

import cv2
import numpy as np

from ..core.boxes import Boxes
from ..core.source import Picture

AS_IT_IS = Fraction(1)  # of a picture that is not enlarged
FACTORS = tuple(map(Fraction, ("5/4", "3/2", "2", "3", "4")))
WINDOWS_AT_MOST = 30  # windows about boxes that are looked at, two of their lengths wide
# Share of a window's contrast (RMS) that is lost by reducing and enlarging it again, up to which that loses nothing. Of
# twelve orthophotos 0.056 to 0.26 are lost by 5/4 as they are; enlarged by cubic splines and stored in 8 bits, 0.025 to
# 0.10 of those by 3/2, 0.016 to 0.07 of those by 2, 0.02 to 0.08 of those by 4, by as much (2026-11-23).
LOST = 0.05


def enlargement(pictures: Mapping[str, Picture], boxes: Mapping[str, Boxes]) -> Fraction:
    """The largest of FACTORS by which the `pictures` can be reduced with hardly any loss about `boxes`, 1 if none."""
    every = [(name, box) for name, some in boxes.items() for box in some.xylwa]
    chosen = [every[k] for k in np.unique(np.linspace(0, len(every) - 1, WINDOWS_AT_MOST).astype(int))] if every else []
    lost = [_lost(pictures[name], box) for name, box in chosen]
    if not lost:
        return AS_IT_IS
    kept = np.median(lost, axis=0) < LOST
    fine = FACTORS[: int(np.logical_and.accumulate(kept).sum())]
    return fine[-1] if fine else AS_IT_IS


def _lost(picture: Picture, box: np.ndarray) -> list[float]:
    """Of each of FACTORS, how much of the contrast about `box` (5,) is lost by it."""
    limit = np.array([picture.width, picture.height])
    x, y = low = np.clip(np.floor(box[:2] - box[2]), 0, limit - 1).astype(int)
    width, height = (np.clip(np.ceil(box[:2] + box[2]), low + 1, limit).astype(int) - low).tolist()
    window = cv2.cvtColor(picture.read(int(x), int(y), width, height, width, height), cv2.COLOR_RGB2GRAY)
    window = window.astype(np.float32)
    contrast = max(float(window.std()), 1.0)
    out = []
    for factor in FACTORS:
        size = max(1, round(width / factor)), max(1, round(height / factor))
        small = cv2.resize(window, size, interpolation=cv2.INTER_AREA)
        again = cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
        out.append(float(np.sqrt(((window - again) ** 2).mean())) / contrast)
    return out
