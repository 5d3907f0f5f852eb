"""What a source shows of its scale besides the vehicles' sizes: rows of parked vehicles, objects of standard size."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .boxes import Boxes
from .evidence import Evidence
from .objects import standard_object
from .parking import parking_pitch
from .pooling import Ruler
from .votes import Votes


def orthophoto_evidence(
    votes: Votes, angle: np.ndarray, objects: Mapping[str, Boxes], zoom: float, ruler: Ruler, country: str
) -> list[Evidence]:
    """In an orthophoto: `votes` of single boxes with `angle` (N,) [rad], and boxes of other classes by class.

    `zoom` is detector pixels per picture pixel, `country` the fleet's code.
    """
    size = votes.size - np.asarray(ruler.margin) * votes.pixel[:, None]
    along = np.stack([np.cos(angle), np.sin(angle)], -1)
    found = [parking_pitch(votes.place, along, size, country)]
    for kind, boxes in objects.items():
        found.append(standard_object(kind, boxes.xylwa[:, 2:4], np.full(len(boxes), 1 / zoom)))
    return [evidence for evidence in found if evidence is not None]
