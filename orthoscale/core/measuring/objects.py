"""Objects of a standard size, where a detector has classes for them: courts, containers, buses.

A class may have several standards (20 and 40 foot containers). The ratio of length to width, which needs no scale, says
how likely each is. Many are too similar to be told apart by a box, so an anchor keeps every standard that fits its box,
and the vehicles decide. The diagonal is measured: where all edges are known equally well, it holds all that length and
width say about the scale, and its error is independent of their ratio.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..anchors import Anchor, AnchorVote, Standard
from ..pooling.anchors import SHARED

EDGE_SD = 2.0  # one sigma of a box's side around an object [detector px]; assumed, not measured
ODD_RATIO = 3.0  # sigmas between a box's ratio of sides and a standard's, beyond which it is not that standard
# Probability that a box of the class and of the right shape is something else (a coach, a garage), or of a size that
# the table lacks. A judgement: no detector's mistakes among such classes were counted.
OBJECT_FALSE = 0.05


def standard_objects(
    kind: str, standards: Sequence[Mapping[str, Any]], size: np.ndarray, pixel: np.ndarray, place: np.ndarray
) -> list[AnchorVote]:
    """The boxes of class `kind` that have the shape of one of its standards, each as an anchor.

    standards : those of the class, as in ``data/objects.json``: length and width, each a value and one sigma [m].
    size : (N, 2) length and width [units]. pixel : (N,) size of one detector pixel [units]. place : (N, D) [units].
    """
    if not standards or not len(size):
        return []
    sides, rule_sd = (np.array([[s["length"][k], s["width"][k]] for s in standards]) for k in (0, 1))  # (S, 2) [m]
    edge_sd = EDGE_SD * pixel  # (N,) [units]
    ratio_sd = np.sqrt(((rule_sd / sides) ** 2).sum(1)[:, None] + ((edge_sd[:, None] / size) ** 2).sum(1))  # (S, N)
    odd = np.abs(np.log(sides[:, None] / size) @ [1, -1]) / ratio_sd  # sigmas
    likelihood = np.exp(-0.5 * odd**2) / ratio_sd
    metres, units = np.hypot(*sides.T), np.hypot(*size.T)
    rule = np.sqrt(((rule_sd * sides) ** 2).sum(1)) / metres**2
    # The errors of a box's sides are common to all of them in part.
    fit = edge_sd / units * np.sqrt(1 + SHARED * 2 * size.prod(1) / units**2)
    votes = []
    for n in np.flatnonzero(odd.min(axis=0) < ODD_RATIO).tolist():
        meant = tuple(
            _standard(standards[s], float(metres[s]), float(rule[s]), float(likelihood[s, n]))
            for s in np.flatnonzero(odd[:, n] < ODD_RATIO).tolist()
        )
        lines, residual = np.empty((0, 2, 2)), np.empty(0)
        diagonal, sd = float(units[n]), float(fit[n])
        anchor = Anchor(in_words(kind), place[n], lines, diagonal, sd, residual, meant, OBJECT_FALSE)
        votes.append(AnchorVote(anchor, place[n], diagonal, sd))
    return votes


def _standard(told: Mapping[str, Any], metres: float, relative_sd: float, prior: float) -> Standard:
    name, where = f"diagonal of {told['name']}", tuple(told.get("countries", ()))
    return Standard(name, metres, relative_sd, told["source"], prior, where)


def in_words(kind: str) -> str:
    """An anchor's kind by the name of a detector's class, or of a choice on the command line: ``tennis-court``."""
    return kind.replace("-", " ")
