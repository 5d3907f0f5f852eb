"""Measuring in the frames of a reconstruction, as they are: each box with its own camera, distortion and ground.

The ruler calibrates itself on the way (`projection.calibration`): what the boxes take in of a vehicle's height, and
their margin, follow from vehicles that are seen steeply and flatly, near and far.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .boxes import Boxes
from .detections import Detections
from .errors import TooLittleEvidence
from .fleet import Fleet
from .measuring import Measured, doubts, tight
from .method import Method
from .model_drift import drift
from .pooling import MIN_VEHICLES
from .projection.calibration import Calibration, calibrate, trends
from .projection.height import lean
from .projection.view import Views
from .votes import gather

if TYPE_CHECKING:
    from .sources.colmap import ColmapSource

ROUNDS = 6  # of projection and pooling; the scale enters its own projection only through the vehicles' height
SETTLED = 1e-4  # relative change of the scale at which the rounds end
# Relative uncertainty of a reconstruction's ground under the vehicles (one sigma), as a share of the camera's height:
# sparse points on bare ground scatter by about this much on the two real scenes.
GROUND_SD = 0.01
# How far a detector's effective height strays from its card between scenes (one sigma) [m], and its upper bound.
HEIGHT_SD = 0.25
MAX_HEIGHT = 1.5
NO_GROUND = "no ground under the box, or seen too flatly"
NO_HULL = "no vehicle on the ground gives this box"


def measure_frames(source: ColmapSource, found: Detections, fleet: Fleet, method: Method) -> Measured:
    """Measure the boxes `found` in the frames of `source`. Raises TooLittleEvidence."""
    parts, names, views, places = [], [], [], []
    lost = doubts(found)
    for name, boxes in found.boxes.items():
        if not len(boxes):
            continue
        view, place, ok = source.views(name, boxes.centre)
        parts.append(boxes[ok])
        names += [name] * int(ok.sum())
        views.append(view[ok])
        places.append(place[ok])
        lost[NO_GROUND] = lost.get(NO_GROUND, 0) + int((~ok).sum())
    if len(names) < MIN_VEHICLES:
        raise TooLittleEvidence(f"{len(names)} boxes on the ground, {MIN_VEHICLES} vehicles are needed")
    boxes, picture, place = Boxes.concatenate(parts), np.array(names), np.concatenate(places)
    view = Views.concatenate(views)
    pixel = view.unit_per_pixel / found.zoom
    leaning = lean(boxes, view)
    # The height's share of a box is a small correction, so a few rounds of measuring and pooling settle the scale.
    metres_per_unit = float(fleet.mean[0] / np.median(boxes.length * view.unit_per_pixel))
    card = Calibration.of_card(found, HEIGHT_SD)
    ruler = card
    for _ in range(ROUNDS):
        size = method.sizes(boxes, view, metres_per_unit, ruler.height, fleet)
        solved = np.isfinite(size).all(1)
        own = boxes[solved]
        votes = gather(size[solved], pixel[solved], place[solved], own.score, True, own.spread)
        scale = method.pool(
            votes,
            fleet,
            replace(found.ruler, margin=_pair(ruler.margin), margin_sd=_pair(ruler.margin_sd)),
            source.unit,
            geometry(size[solved], leaning[solved], ruler.height_sd / metres_per_unit),
        )
        change = abs(np.log(scale.value / metres_per_unit))
        metres_per_unit = scale.value
        flat = size[solved] + leaning[solved] * ruler.height / metres_per_unit
        if change < SETTLED:
            break
        counted = [members for members, used in zip(votes.members, scale.used, strict=True) if used]
        if method.projection in (None, "exact"):  # the others have no effective height, or one of their own
            ruler = calibrate(flat, leaning[solved], pixel[solved], counted, metres_per_unit, card, MAX_HEIGHT)
    lost[NO_HULL] = int((~solved).sum())
    picture = picture[solved]
    bare = size[solved] - ruler.margin * pixel[solved, None]
    counted = [members for members, used in zip(votes.members, scale.used, strict=True) if used]
    changes = trends(flat, bare, np.degrees(view.elevation[solved]), pixel[solved], counted)
    findings = {
        "calibration": {**ruler.document(card), "trends": changes},
        "drift": drift(bare, picture, votes, scale, source.ground.plane(votes.place)),
    }
    return Measured(boxes[solved], picture, votes, scale, lost, findings, tight(votes, ruler.margin))


def _pair(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def geometry(size: np.ndarray, leaning: np.ndarray, height_sd: np.ndarray) -> np.ndarray:
    """(2, 2) relative covariance of length and width from the ground's height (shared) and the effective height.

    size, leaning : (N, 2) as measured. height_sd : (2,) one sigma of the effective height [units of `size`].
    """
    if not len(size):
        return np.zeros((2, 2))
    share = np.median(leaning * height_sd / size, axis=0)
    return np.diag(share**2) + GROUND_SD**2
