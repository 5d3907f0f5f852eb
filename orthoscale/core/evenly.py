"""Some of many things, evenly spread over all of them."""

from __future__ import annotations

import numpy as np


def evenly(count: int, most: int) -> np.ndarray:
    """(K,) int: `most` of the numbers from 0 to `count` - 1, evenly spread from the first to the last; all of them if
    there are no more."""
    return np.linspace(0, count - 1, min(count, most)).astype(int)
