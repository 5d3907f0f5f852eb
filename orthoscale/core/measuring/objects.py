"""Objects of a standard size, where a detector has classes for them: courts, containers, buses.

A class with several standards (20 and 40 foot containers) is told
apart by the ratio of length to width, which needs no scale.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..anchors import Anchor, AnchorVote, Standard
from ..pooling.anchors import SHARED

EDGE_SD = 2.0  # of one box side, in detector pixels: how well an object's edges are boxed, which nobody has measured
ODD_RATIO = 3.0  # sigmas between a box's ratio of sides and a standard's, beyond which it is not that standard


def standard_objects(
    kind: str, standards: Sequence[Mapping[str, Any]], size: np.ndarray, pixel: np.ndarray, place: np.ndarray
) -> list[AnchorVote]:
    """The boxes of class `kind` that have the shape of one of its standards, each as an anchor.

    standards : those of the class, as in ``data/objects.json``: length and width, each a value and one sigma [m].
    size : (N, 2) length and width [units]. pixel : (N,) size of one detector pixel [units]. place : (N, D) [units].
    """
    if not standards or not len(size):
        return []
    edge = (EDGE_SD * pixel[:, None] / size) ** 2  # (N, 2) relative variance
    sides = np.array([[s["length"][0], s["width"][0]] for s in standards])  # (S, 2) [m]
    rule = np.square(np.array([[s["length"][1], s["width"][1]] for s in standards]) / sides)
    log_scale = np.log(sides)[:, None] - np.log(size)  # (S, N, 2)
    variance = rule[:, None] + edge
    odd = np.abs(log_scale[..., 0] - log_scale[..., 1]) / np.sqrt(variance.sum(2))  # (S, N) sigmas
    which = np.argmin(odd, axis=0)
    votes = []
    for n in np.flatnonzero(odd.min(axis=0) < ODD_RATIO):
        s = which[n]
        weight = 1 / variance[s, n] / (1 / variance[s, n]).sum()  # of length and width
        fit = SHARED * weight @ edge[n] + (1 - SHARED) * weight**2 @ edge[n]  # a box errs alike on all its sides
        told = standards[s]
        standard = Standard(told["name"], float(sides[s, 0]), float(np.sqrt(rule[s, 0])), told["source"])
        units = float(sides[s, 0] * np.exp(-weight @ log_scale[s, n]))
        anchor = Anchor(
            in_words(kind), place[n], np.empty((0, 2, 2)), units, float(np.sqrt(fit)), np.empty(0), (standard,), 0.0
        )
        votes.append(AnchorVote(anchor, place[n], units, anchor.relative_sd))
    return votes


def in_words(kind: str) -> str:
    """An anchor's kind by the name of a detector's class, or of a choice on the command line: ``tennis-court``."""
    return kind.replace("-", " ")
