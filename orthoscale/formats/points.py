"""Parses points and numbers that users type, or that their spreadsheets write."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from ..errors import shown

WITH_POINT = re.compile(r"[+-]?\d*\.\d+")
WITH_COMMA = re.compile(r"[+-]?\d+,\d+")
MAYBE_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")  # 1,234 is 1234 to some programs


def coordinates(text: str, count: int, what: str) -> np.ndarray:
    """(count,) the comma-separated numbers in `text`. Raises ValueError, which says that `text` is not `what`."""
    found = np.array([number(part) for part in text.split(",")])
    if len(found) != count:
        raise ValueError(f"{text!r} is not {what}")
    return found


def pixel(text: str, width: int, height: int, what: str) -> np.ndarray:
    """(2,) column and row in a picture of that size. Raises ValueError, also for a pixel outside of it."""
    found = coordinates(text, 2, what)
    if not ((found >= 0) & (found <= (width, height))).all():
        raise ValueError(f"{text} lies outside of the picture, which is {width} x {height} px")
    return found


def number(text: str) -> float:
    """The finite number in `text`. Raises ValueError for anything else."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        if MAYBE_THOUSANDS.fullmatch(text):
            raise ValueError(f"{shown(text)!r} is {text.replace(',', '.')} or {text.replace(',', '')}: write which")
        if WITH_COMMA.fullmatch(text):
            raise ValueError(f"{shown(text)!r} has a decimal comma: write {text.replace(',', '.')}")
        raise ValueError(f"{shown(text)!r} is not a finite number")
    return value


def decimal_commas(words: Iterable[str], sure: bool = False) -> bool:
    """Whether the numbers among `words` have decimal commas, as programs write them in much of Europe: none has a
    point, and some have a comma that cannot separate thousands. sure : commas never do, so that any comma counts."""
    found = False
    for word in words:
        if WITH_POINT.fullmatch(word):
            return False
        found = found or bool(WITH_COMMA.fullmatch(word) and (sure or not MAYBE_THOUSANDS.fullmatch(word)))
    return found
