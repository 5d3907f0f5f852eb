"""Round numbers, 1, 2 or 5 times a power of ten: the lengths of scale bars and the steps of charts."""

from __future__ import annotations

import math

ROUND = (1, 2, 5, 10)
BAR_SHARE = 1 / 5  # share of a picture's width that a scale bar takes at most
NEARLY = 0.999  # share of a value from which a round number counts as no less than it


def round_below(value: float) -> float:
    """The largest round number that is no more than `value`, a positive number."""
    power = _power(value)
    return power * max(step for step in ROUND if step * power <= value)


def round_above(value: float) -> float:
    """The smallest round number that is no less than `value`, a positive number, or at most a thousandth less."""
    power = _power(value)
    return power * next(step for step in ROUND if step * power >= NEARLY * value)


def scale_bar(metres_per_px: float, width: int) -> tuple[float, float]:
    """A round length [m], about a fifth of a picture that is `width` px wide, and its length there [px]."""
    metres = round_below(BAR_SHARE * width * metres_per_px)
    return metres, metres / metres_per_px


def _power(value: float) -> float:
    """The largest power of ten that is no more than `value`."""
    power = 10.0 ** math.floor(math.log10(value))
    return power if power <= value else power / 10  # just below a power of ten, the logarithm is rounded up
