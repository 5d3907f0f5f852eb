"""Measuring a reconstruction as if it were an orthophoto: frames warped onto the ground, the planar variant.

The paper's orthophoto method without an orthophoto, and a second look that shares neither the projection model nor the
picture with the first (`oblique`). A plan shows footprints; what remains of the vehicles' height in the near-nadir
parts is taken off.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...errors import TooLittleEvidence
from ...evidence.surroundings import rows_in_model
from ..boxes import Boxes
from ..detections import Detections
from ..fleet import Fleet
from ..pooling.robust import MIN_VEHICLES
from ..projection.planar import footprint, ground_size
from ..votes import gather
from .measure import Measured, doubts, tight
from .method import Method
from .oblique import HEIGHT_SD, geometry

if TYPE_CHECKING:
    from ...sources.colmap import ColmapSource
    from ...sources.ground_picture import GroundPicture

SWEEP_ROUNDS = 3  # the height left in a box is a few percent of it, and the scale enters only there
ROOM = 1.15  # a box, enlarged so, must lie within what the frame saw, or it may be cut
BORDER = 2.0  # [px of the frame]
TOO_FLAT = "cut by the frame's edge, or seen too flatly"


def measure_ground(source: ColmapSource, found: Detections, fleet: Fleet, method: Method) -> Measured:
    """Measure the boxes `found` in the `source.ground_pictures`. Raises TooLittleEvidence."""
    pictures = {picture.name: picture for picture in source.ground_pictures}
    lost = {**doubts(found), TOO_FLAT: 0}
    parts, names, offsets, heights, places, alongs = [], [], [], [], [], []
    for name, boxes in found.boxes.items():
        picture = pictures.get(name)
        if picture is None or not len(boxes):
            continue
        whole, offset = _whole(picture, boxes)
        lost[TOO_FLAT] += int((~whole).sum())
        parts.append(boxes[whole])
        names += [name] * int(whole.sum())
        offsets.append(offset[whole])
        heights.append(np.full(int(whole.sum()), picture.camera_height))
        places.append(picture.ground(boxes.centre[whole]))
        alongs.append(picture.ground(boxes.centre[whole] + _heading(boxes[whole])) - places[-1])
    if len(names) < MIN_VEHICLES:
        raise TooLittleEvidence(f"{len(names)} boxes near the nadir, {MIN_VEHICLES} vehicles are needed")
    boxes, place, along = Boxes.concatenate(parts), np.concatenate(places), np.concatenate(alongs)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    unit = next(iter(pictures.values())).unit_per_pixel
    camera = np.concatenate(heights)[:, None]
    offset = _along(boxes, np.concatenate(offsets))
    flat = ground_size(boxes) * unit
    height = np.array(found.effective_height)
    metres_per_unit = float(fleet.mean[0] / np.median(flat[:, 0]))
    for _ in range(SWEEP_ROUNDS):
        size = camera * footprint(flat / camera, offset, height / metres_per_unit / camera)
        votes = gather(size, np.full(len(boxes), unit / found.zoom), place, boxes.score, repeated=True)
        spread = geometry(size, np.abs(offset), np.full(2, HEIGHT_SD / metres_per_unit))
        more = []
        if method.surroundings:
            rows = rows_in_model(replace(votes, size=tight(votes, found.ruler.margin)), along, fleet.code)
            more = [rows] if rows else []
        scale = method.pool(votes, fleet, found.ruler, source.unit, spread, more)
        metres_per_unit = scale.value
    return Measured(boxes, np.array(names), votes, scale, lost, {}, tight(votes, found.ruler.margin))


def _along(boxes: Boxes, offset: np.ndarray) -> np.ndarray:
    """(N, 2) the vectors `offset` (N, 2), in pictures' axes, along the boxes' long sides and across."""
    heading = _heading(boxes)
    across = np.stack([-heading[:, 1], heading[:, 0]], -1)
    return np.stack([(offset * heading).sum(1), (offset * across).sum(1)], -1)


def _heading(boxes: Boxes) -> np.ndarray:
    """(N, 2) unit vectors along the boxes' long sides, in their picture's axes."""
    return np.stack([np.cos(boxes.angle), np.sin(boxes.angle)], -1)


def _whole(picture: GroundPicture, boxes: Boxes) -> tuple[np.ndarray, np.ndarray]:
    """(N,) bool, boxes that the frame shows whole and steeply enough, and (N, 2) where they lie, see `seen`."""
    from ...sources.ground_picture import NEAR_NADIR

    centre = boxes.centre[:, None]
    corners = (centre + ROOM * (boxes.corners - centre)).reshape(-1, 2)
    with np.errstate(invalid="ignore"):
        pixels = picture.seen(corners)[0].reshape(-1, 4, 2)
        inside = ((pixels >= BORDER) & (pixels <= np.array(picture.size) - BORDER)).all((1, 2))
    offset = picture.seen(boxes.centre)[1]
    return inside & (np.linalg.norm(offset, axis=1) <= 1 / np.tan(np.radians(NEAR_NADIR))), offset
