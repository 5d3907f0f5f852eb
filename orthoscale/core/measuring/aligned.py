"""Vehicles stand parallel to their neighbours or across: lanes, kerbs, bays and rows see to that. Boxes whose
directions know nothing of one another may be of any size, and give some scale; that they are vehicles is doubtful."""

from __future__ import annotations

import numpy as np

from ..boxes import Boxes
from ..remarks import CAUTION, Remark
from ..scale import Scale

NEAR = 3.0  # lengths of a vehicle from middle to middle within which the nearest one is a neighbour
LEAST_PAIRS = 30  # neighbours below which chance may look like order, and nothing is said
# Mean cosine of four times the angle between neighbours, 1 where all are parallel or across, 0 by chance. Eight
# orthophotos of known scale and 109 parts of them with 25 pairs and more have 0.54 to 0.98, 67 labelled pictures with
# 15 and more 0.68 to 1; of 4,000 sets of random boxes with 30 pairs one in a thousand reaches it.
ALIGNED = 0.35


def alignment(boxes: Boxes) -> tuple[int, float]:
    """Pairs of `boxes` (N, of one picture) of which one is the other's nearest neighbour, and how far their directions
    agree: the mean of cos(4 difference), which is the same for parallel and across, and 0 without any pair."""
    from scipy.spatial import cKDTree

    if len(boxes) < 2:
        return 0, 0.0
    distance, nearest = cKDTree(boxes.centre).query(boxes.centre, 2)
    near = distance[:, 1] < NEAR * np.median(boxes.length)
    pairs = np.unique(np.sort(np.column_stack([np.arange(len(boxes)), nearest[:, 1]])[near], 1), axis=0)
    if not len(pairs):
        return 0, 0.0
    between = boxes.angle[pairs[:, 0]] - boxes.angle[pairs[:, 1]]
    return len(pairs), float(np.cos(4 * between).mean())


def only_aligned(scale: Scale, boxes: Boxes) -> Scale:
    """`scale`, ``poor`` at best where its vehicles, those of `boxes` (N) that are used, stand in no order at all."""
    pairs, agreement = alignment(boxes[scale.used])
    if pairs < LEAST_PAIRS or agreement >= ALIGNED:
        return scale
    remark = Remark(
        CAUTION,
        f"the directions of {pairs} pairs of neighbours agree by {agreement:.2f}, where those of vehicles in lanes and "
        "rows agree by 0.5 to 1: see whether the boxes are vehicles",
    )
    return scale.remarked(remark, at_best="poor")
