"""The share of boxes of one length that both detection passes find: nearly all of vehicles, few of false detections.

A detector makes mistakes of the sizes that it was trained for, and where there are hundreds of graves, panels or boats,
some are found in both passes. The share of confirmed boxes distinguishes them from vehicles, whatever their number.
"""

from __future__ import annotations

import numpy as np

from .boxes import Boxes

ABOUT = 0.24  # log of the ratio of lengths that are about the same
# Share of the boxes that two detection passes agree on, where they are mistakes. Eleven orthophotos of known scale have
# 0.5 to 0.9, one with 14 vehicles 0.2; five of six rendered pictures without any vehicle 0.04 to 0.3, one 0.6.
OF_MISTAKES = 0.3
# Of the share among the vehicles, from which less is that of mistakes. In twelve orthophotos of known scale 11 of 4,216
# boxes fall under both limits, all of them shorter than two thirds of the median (2026-11-23).
MUCH_LESS = 0.5
# Of what stands for the best length, from which another may be the vehicles' as well. In the search the second best of
# twelve places and two orthophotos of known scale has 0.04 to 0.19, on rendered towns of panels and graves up to 0.7.
AS_LIKELY = 0.4


def share_confirmed(length: np.ndarray, confirmed: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(K,) share of the boxes of about each `length` (K,) that two passes agree on.

    confirmed : (M,) lengths of the boxes that both see; seen : (N,) of all that one sees, those among them. One of one
    says little, so shares begin with one of three.
    """
    both, every = (1 + about(np.log(length), np.sort(np.log(some))) for some in (confirmed, seen))
    return np.asarray(both / (2 + every))


def about(where: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(K,) how many of the sorted `values` (N,), log lengths, lie within ABOUT of each of `where` (K,)."""
    return np.searchsorted(values, where + ABOUT, "left") - np.searchsorted(values, where - ABOUT, "right")


def seldom_confirmed(boxes: Boxes, doubtful: Boxes) -> np.ndarray:
    """(N,) bool: which of the `boxes` that both passes see are of a length of which they seldom do, as seldom as of
    mistakes, and much less often than of the length that most of the evidence is of; as long as it is clear which that
    is.

    doubtful : what one pass alone sees.
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
