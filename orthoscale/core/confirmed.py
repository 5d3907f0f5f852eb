"""The share of boxes of one length that both detection passes find: nearly all of vehicles, few of false detections.

A detector makes mistakes of the sizes that it was trained for, and where there are hundreds of graves, panels or boats,
some are found in both passes. The share of confirmed boxes distinguishes them from vehicles, whatever their number.
"""

from __future__ import annotations

import numpy as np

from .boxes import Boxes

ABOUT = 0.24  # greatest log ratio of two lengths that count as about the same
# Share of boxes that both detection passes find, below which they may be false detections. It is 0.5 to 0.9 on eleven
# orthophotos of known scale and 0.2 on one with 14 vehicles; 0.04 to 0.3 on five of six rendered pictures without any
# vehicle and 0.6 on one.
OF_MISTAKES = 0.3
# The second limit, relative to the share at the vehicles' length. In twelve orthophotos of known scale 11 of 4,216
# boxes fall below both limits, all of them shorter than two thirds of the median (2026-11-23).
MUCH_LESS = 0.5
# Evidence for another length, relative to that for the best one, from which it may be the vehicles' length as well. In
# the scale search the second best length has 0.04 to 0.19 on twelve places and two orthophotos of known scale, and up
# to 0.7 on rendered towns of panels and graves.
AS_LIKELY = 0.4


def share_confirmed(length: np.ndarray, confirmed: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(K,) share of the boxes of about each `length` (K,) that both passes find.

    confirmed : (M,) lengths of the boxes that both passes find. seen : (N,) lengths of all boxes, these included. One
    of one says little, so one confirmed box of three is added to the counts.
    """
    both, every = (1 + about(np.log(length), np.sort(np.log(some))) for some in (confirmed, seen))
    return np.asarray(both / (2 + every))


def about(where: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(K,) how many of `values` (N,), sorted log lengths, lie within ABOUT of each of `where` (K,)."""
    return np.searchsorted(values, where + ABOUT, "left") - np.searchsorted(values, where - ABOUT, "right")


def seldom_confirmed(boxes: Boxes, doubtful: Boxes) -> np.ndarray:
    """(N,) bool: which of the `boxes` that both passes find are of a length that is seldom confirmed: as seldom as
    false detections are, and much less often than the length with most of the evidence. None of them if such a length
    has nearly as much evidence.

    doubtful : the boxes that only one pass finds.
    """
    if not len(boxes):
        return np.zeros(0, bool)
    share = share_confirmed(boxes.length, boxes.length, np.concatenate([boxes.length, doubtful.length]))
    log_length = np.log(boxes.length)
    standing = share * about(log_length, np.sort(log_length))
    best = int(np.argmax(standing))
    seldom = (share < OF_MISTAKES) & (share < MUCH_LESS * share[best])
    if (standing[seldom] >= AS_LIKELY * standing[best]).any():
        return np.zeros(len(boxes), bool)
    return np.asarray(seldom)
