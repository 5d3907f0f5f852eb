"""Parsing points and numbers that users type."""

from __future__ import annotations

import numpy as np

from ..errors import shown


def coordinates(text: str, count: int, what: str) -> np.ndarray:
    """(count,) the numbers in `text`, with commas between. Raises ValueError, which says that `text` is not `what`."""
    found = np.array([number(part) for part in text.split(",")])
    if len(found) != count:
        raise ValueError(f"{text!r} is not {what}")
    return found


def pixel(text: str, width: int, height: int, what: str) -> np.ndarray:
    """(2,) column and row in a picture of that size. Raises ValueError, also for what lies outside of it."""
    found = coordinates(text, 2, what)
    if not ((found >= 0) & (found <= (width, height))).all():
        raise ValueError(f"{text} lies outside of the picture, which is {width} x {height} px")
    return found


def number(text: str) -> float:
    """Raises ValueError for what is no finite number."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise ValueError(f"{shown(text)!r} is not a finite number")
    return value
