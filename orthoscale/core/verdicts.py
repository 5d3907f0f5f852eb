"""The verdict on a scale, and the reasons for which votes are rejected."""

from __future__ import annotations

import numpy as np

from .remarks import CAUTION, REFUSAL, Remark

VERDICTS = (("good", 0.03), ("fair", 0.06), ("poor", 0.15))  # relative one-sigma of the scale, upper bounds
UNUSABLE = "unusable"  # no output is written unless it is forced
BEST_TO_WORST = (*(word for word, _ in VERDICTS), UNUSABLE)  # from the best to the worst
FIT = {  # verdict: what the scale is fit for
    "good": "Suitable for metric layouts and checks.",
    "fair": "Suitable where this tolerance is acceptable.",
    "poor": "Suitable for a rough idea only.",
    UNUSABLE: "Not suitable for use.",
}
AT_BEST_DOUBTED = "fair"  # if a measurement does not fit the rest: one of them is wrong, but it is not known which
CHECK_LIMIT = 2.5  # sigmas between length and width above which the verdict is lowered
TOO_SMALL, TOO_LARGE = "too small for a car", "too large for a car"  # reasons for which a vote does not count
SHAPE_LIMIT = 4.0  # sigmas between them above which no output is written unless it is forced


def verdict(sd: float, odd_shape: bool, conflict: bool, doubted: bool = False) -> str:
    """``good``, ``fair``, ``poor`` or ``unusable``. sd : relative one-sigma of the scale. odd_shape : lengths and
    widths give different scales: one step down, to ``poor`` at worst. conflict : two measurements contradict each
    other, so the scale is not known: ``unusable``. doubted : a measurement does not fit the rest: ``fair`` at best."""
    rank = next((k for k, (_, limit) in enumerate(VERDICTS) if sd <= limit), len(VERDICTS))
    if conflict or rank == len(VERDICTS):
        return UNUSABLE
    word = BEST_TO_WORST[min(rank + odd_shape, len(VERDICTS) - 1)]
    return worst(word, AT_BEST_DOUBTED) if doubted else word


def worst(*verdicts: str) -> str:
    """The worst of them."""
    return max(verdicts, key=BEST_TO_WORST.index)


def one_step_below(word: str) -> str:
    """The next worse verdict after `word`; ``unusable`` is the last."""
    return BEST_TO_WORST[min(BEST_TO_WORST.index(word) + 1, len(BEST_TO_WORST) - 1)]


def remark_on_shape(difference: float, tension: float) -> Remark:
    """`difference` is the log scale by lengths minus that by widths, `tension` the sigmas between the two."""
    larger, smaller = ("lengths", "widths") if difference > 0 else ("widths", "lengths")
    percent = 100 * np.expm1(abs(difference))
    return Remark(
        REFUSAL if tension > SHAPE_LIMIT else CAUTION,
        f"{larger} give a larger scale than {smaller} by {percent:.0f} %: wrong fleet, or boxes that do not fit",
        "Inspect the boxes (--save-detections) or name the country's fleet (--fleet)",
    )


def reasons(
    used: np.ndarray, measurable: np.ndarray, fleeting: np.ndarray, log_size: np.ndarray, mean: np.ndarray
) -> list[str]:
    """Why each vote does not count, '' where it does.

    used, fleeting : (N,) bool. measurable : (M,) indices of votes. log_size : (M, 2) of these. mean : (2,) of log_size
    over the votes that are used.
    """
    out = ["seen in too few frames" if f else "smaller than the detector's margin" for f in fleeting]
    for index, (d_length, d_width) in zip(measurable, log_size - mean, strict=True):
        if used[index]:
            out[index] = ""
        elif abs(d_length - d_width) > max(abs(d_length), abs(d_width)):
            out[index] = "wrong shape for a car"
        else:
            out[index] = TOO_SMALL if d_length + d_width < 0 else TOO_LARGE
    return out
