"""Finds objects that are all of one size, and so are not vehicles: solar panels, skylights, graves, stacked crates.

Vehicles of a place differ in length by 7 to 10 %, and a detector adds an error to each: the lengths of boxes of parked
vehicles scatter by 4 to 8 % in every row and car park (below). Panels are of one make: their boxes scatter by 1 to 3 %.
A chi-squared test decides for each group of neighbouring boxes whether they scatter too little to be vehicles. So a few
vehicles that happen to be of equal size are kept.
"""

from __future__ import annotations

import numpy as np

from .angles import axis_angle
from .boxes import Boxes
from .confirmed import about
from .linked import linked

TOGETHER = 1.6  # [lengths of the shorter box] centres nearer than this form a group; bays end to end are 1.2 apart
TURN = np.radians(8.0)  # angle within which neighbouring boxes of a group are parallel
# Least scatter (one sigma of the log) of the box lengths of vehicles that stand together. Measured with version 5 in
# groups of ten and more on six places of known scale (manila, chongqing, four of the USA): 0.041 to 0.082 from 20
# vehicles on. Rendered panels, graves and skylights have 0.014 to 0.032.
LEAST_SCATTER = 0.04
MISTAKEN = 1e-3  # probability of taking a group of vehicles for objects of one size
# The same where the picture is known to hold such objects of about that length: what stands on one roof stands on the
# next. Rendered panels in groups of 10 to 40 scatter by 0.02 to 0.03, too much to recognise a small group by itself.
MISTAKEN_AGAIN = 0.05


def all_alike(boxes: Boxes) -> np.ndarray:
    """(N,) bool: which of `boxes` (of one picture, at any zoom) belong to a group whose lengths are too much alike for
    vehicles."""
    group = _standing_together(boxes)
    count = np.bincount(group, minlength=1)
    log_length = np.log(boxes.length)
    mean = np.bincount(group, log_length) / np.maximum(count, 1)
    squares = np.bincount(group, (log_length - mean[group]) ** 2)
    probability = _by_chance(count, squares)
    sure = probability < MISTAKEN
    again = about(mean, np.sort(mean[sure])) > 0
    return (sure | (again & (probability < MISTAKEN_AGAIN)))[group]


def of_one_size(boxes: Boxes) -> bool:
    """Whether `boxes`, taken as one group wherever they stand, are too much alike for vehicles."""
    log_length = np.log(boxes.length)
    squares = ((log_length - log_length.mean()) ** 2).sum() if len(boxes) else 0.0
    return bool(_by_chance(np.array([len(boxes)]), np.array([squares]))[0] < MISTAKEN)


def _by_chance(count: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """(G,) probability that the log lengths of `count` (G,) vehicles have a sum of squares about their mean as small as
    `squares` (G,), at the least variance of vehicles (LEAST_SCATTER)."""
    from scipy.special import chdtr

    return np.where(count > 2, chdtr(np.maximum(count - 1, 1), squares / LEAST_SCATTER**2), 1.0)


def more_of_the_same(boxes: Boxes, alike: np.ndarray) -> np.ndarray:
    """(N,) bool: which other `boxes` are probably like those that are `alike` (N,) bool: of the boxes of about their
    length, at least half are `alike`."""
    length = np.log(boxes.length)
    same, other = (about(length, np.sort(length[which])) for which in (alike, ~alike))
    return ~alike & (same >= other)


def _standing_together(boxes: Boxes) -> np.ndarray:
    """(N,) number of each box's group; chains of near neighbours connect the boxes of a group."""
    from scipy.spatial import cKDTree

    n = len(boxes)
    if n < 2:
        return np.arange(n)
    # Each octave of lengths is searched with the next, so that one long box does not make all others its neighbours.
    octave = np.floor(np.log2(boxes.length)).astype(int)
    found = [np.empty((0, 2), int)]
    for k in np.unique(octave):
        index = np.flatnonzero((octave == k) | (octave == k + 1))
        found.append(index[cKDTree(boxes.centre[index]).query_pairs(TOGETHER * 2.0 ** (k + 1), output_type="ndarray")])
    i, j = np.concatenate(found).T
    apart = np.linalg.norm(boxes.centre[i] - boxes.centre[j], axis=1)
    turned = np.abs(axis_angle(boxes.angle[i] - boxes.angle[j]))
    near = (apart < TOGETHER * np.minimum(boxes.length[i], boxes.length[j])) & (turned < TURN)
    return linked(i[near], j[near], n)
