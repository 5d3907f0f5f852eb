"""Round numbers, 1, 2 or 5 times a power of ten: the lengths of scale bars and the steps of charts."""

from __future__ import annotations

import math

ROUND = (1, 2, 5, 10)
BAR_SHARE = 1 / 5  # of a picture's width that a scale bar takes at most
NEARLY = 0.999  # of a value: a round number of that size counts as no less


def round_below(value: float) -> float:
    """The largest that is no more than `value`, a positive number."""
    power = _power(value)
    return power * max(step for step in ROUND if step * power <= value)


def round_above(value: float) -> float:
    """The smallest that is no less than `value`, a positive number, or only a thousandth less."""
    power = _power(value)
    return power * next(step for step in ROUND if step * power >= NEARLY * value)


def scale_bar(metres_per_px: float, width: int) -> tuple[float, float]:
    """A round length [m], about a fifth of a picture that is `width` px wide, and its length there [px]."""
    metres = round_below(BAR_SHARE * width * metres_per_px)
    return metres, metres / metres_per_px


def _power(value: float) -> float:
    """The power of ten next below, or `value` itself."""
    power = 10.0 ** math.floor(math.log10(value))
    return power if power <= value else power / 10  # the logarithm of what is hardly less is a whole number
