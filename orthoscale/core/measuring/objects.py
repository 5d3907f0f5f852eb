"""Objects of a standard size, where a detector has classes for them: courts, containers, buses.

A class with several standards (20 and 40 foot containers) is told
apart by the ratio of length to width, which needs no scale.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..evidence import Evidence

EDGE_SD = 2.0  # of one box side, in detector pixels: how well an object's edges are boxed, which nobody has measured
SHARED = 0.5  # share of that variance that all boxes of a class have in common: the boxes' margin
ODD_RATIO = 3.0  # sigmas between a box's ratio of sides and a standard's, beyond which it is not that standard


def standard_object(
    kind: str, standards: Sequence[Mapping[str, Any]], size: np.ndarray, pixel: np.ndarray
) -> Evidence | None:
    """The scale by objects of class `kind`; None where no standard is known or none has that shape.

    standards : those of the class, as in ``data/objects.json``: length and width, each a value and one sigma [m].
    size : (N, 2) length and width [units]. pixel : (N,) size of one detector pixel [units].
    """
    if not standards or not len(size):
        return None
    edge = EDGE_SD * pixel[:, None] / size  # (N, 2) relative
    sides = np.array([[s["length"][0], s["width"][0]] for s in standards])  # (S, 2) [m]
    side_sd = np.array([[s["length"][1], s["width"][1]] for s in standards]) / sides
    log_scale = np.log(sides)[:, None] - np.log(size)  # (S, N, 2)
    variance = side_sd[:, None] ** 2 + edge**2
    odd = np.abs(log_scale[..., 0] - log_scale[..., 1]) / np.sqrt(variance.sum(2))  # (S, N) sigmas
    which = np.argmin(odd, axis=0)
    fits = odd.min(axis=0) < ODD_RATIO
    if not fits.any():
        return None
    chosen = (which[fits], np.flatnonzero(fits))
    value, var = log_scale[chosen].ravel(), variance[chosen].ravel()
    weight = 1 / var / (1 / var).sum()
    independent = (weight**2 * var).sum()
    sd = float(np.sqrt(SHARED * (weight @ var) + (1 - SHARED) * independent))
    count = int(fits.sum())
    return Evidence(kind, float(np.exp(weight @ value)), sd, f"{count} box{'es' if count > 1 else ''} of class {kind}")
