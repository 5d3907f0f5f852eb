"""Vehicles of a place differ in size; boxes that are all alike are of something else, and their scale is refused."""

from __future__ import annotations

from ..alike import of_one_size
from ..boxes import Boxes
from ..remarks import REFUSAL, Remark
from ..scale import Scale
from ..verdicts import UNUSABLE


def only_unlike(scale: Scale, boxes: Boxes) -> Scale:
    """`scale`, refused where its vehicles, those of `boxes` (N) that are used, are too much alike. A detector sees
    panels and roof machines of one make alike to 1 or 2 %, vehicles of twelve places differ by 6 to 20 %."""
    used = boxes[scale.used]
    if not of_one_size(used):
        return scale
    remark = Remark(
        REFUSAL,
        f"all {len(used)} boxes are of one length, where vehicles differ: panels, graves or machines, or a lot of one "
        "model of car",
        "Inspect the boxes (--save-detections); give the vehicles' size (--gsd-hint METRES_PER_PIXEL) if there are any",
    )
    return scale.remarked(remark, at_best=UNUSABLE)
