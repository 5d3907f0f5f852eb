"""How many frames show a place: a vehicle should be found in most of them, a false detection in few."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..detections import Detections
from ..source import PosedSet


def pictures_with_boxes(found: Detections) -> list[str]:
    """Names of the pictures with any boxes, whether these count or not: those that were certainly processed. Counting
    all swept pictures instead would reject cars that drove between the frames."""
    every = (found.boxes, found.doubtful, *found.set_aside.values())
    return list(dict.fromkeys(name for some in every for name, boxes in some.items() if len(boxes)))


def frames_in_view(
    source: PosedSet, names: Iterable[str], place: np.ndarray, border: float, lowest_elevation: float
) -> np.ndarray:
    """(N,) number of the frames `names` that show each place (N, 3) [units, world], `border` [px] or more from the
    frame's edge and at an elevation angle of `lowest_elevation` [deg] or more. Occlusion is not considered."""
    count = np.zeros(len(place), int)
    for name in names:
        ray = source.centre(name) - place
        steep = ray @ source.ground.up >= np.sin(np.radians(lowest_elevation)) * np.linalg.norm(ray, axis=1)
        pixel = source.project(name, place)
        with np.errstate(invalid="ignore"):
            inside = ((pixel >= border) & (pixel <= np.array(source.image_size(name)) - border)).all(1)
        count += inside & steep
    return count
