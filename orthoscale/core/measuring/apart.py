"""Vehicles cannot stand in one another, and boxes that do so are no vehicles: whatever scale they give is refused."""

from __future__ import annotations

import numpy as np

from ..boxes import Boxes
from ..remarks import REFUSAL, Remark
from ..scale import Scale
from ..verdicts import UNUSABLE

LOOKED_AT = 5  # that are looked at; more boxes than that near one another stand in one another anyway
# Share of the vehicles that count, from which it cannot be a mistake here and there. Of the 4,649 labelled vehicles of
# five places 0.0 to 0.16 % have their middle in another one's box; of random boxes of the size of vehicles 9 %, where
# they cover 8 % of the picture, and 84 % where they cover it all.
IN_ONE_ANOTHER = 0.1
LEAST_USED = 20  # vehicles below which one pair is no share


def standing_in_another(boxes: Boxes) -> np.ndarray:
    """(N,) bool: whose middle lies in another's box, or another's middle in its own. `boxes` are of one picture."""
    from scipy.spatial import cKDTree

    inside = np.zeros(len(boxes), bool)
    if len(boxes) < 2:
        return inside
    count = min(LOOKED_AT + 1, len(boxes))
    near = cKDTree(boxes.centre).query(boxes.centre, count)[1]
    one, other = np.repeat(np.arange(len(boxes)), count), near.ravel()
    one, other = one[one != other], other[one != other]
    offset = boxes.centre[one] - boxes.centre[other]
    along, across = np.cos(boxes.angle[other]), np.sin(boxes.angle[other])
    u, v = offset[:, 0] * along + offset[:, 1] * across, offset[:, 1] * along - offset[:, 0] * across
    hit = (np.abs(u) < boxes.length[other] / 2) & (np.abs(v) < boxes.width[other] / 2)
    inside[one[hit]] = inside[other[hit]] = True
    return inside


def only_apart(scale: Scale, boxes: Boxes) -> Scale:
    """`scale`, refused where its vehicles, those of `boxes` (N) that are used, stand in one another."""
    used = boxes[scale.used]
    share = float(standing_in_another(used).mean()) if len(used) >= LEAST_USED else 0.0
    if share < IN_ONE_ANOTHER:
        return scale
    remark = Remark(
        REFUSAL,
        f"{100 * share:.0f} % of the vehicles stand in one another: the boxes are no vehicles, or some are there twice",
        "Inspect the boxes (--save-detections), or let the built-in detector look",
    )
    return scale.remarked(remark, at_best=UNUSABLE)
