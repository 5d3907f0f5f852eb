"""Measuring in the frames of a reconstruction, as they are: each box with its own camera, distortion and ground.

The ruler calibrates itself on the way (`core.projection.self_calibration`): what the boxes take in of a vehicle's
height, and their margin, follow from vehicles that are seen steeply and flatly, near and far.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...errors import TooLittleEvidence
from ...evidence.surroundings import GROUND_SD, objects_in_model, rows_in_model, world_axes
from ..boxes import Boxes
from ..detections import Detections
from ..fleet import Fleet
from ..pooling.robust import MIN_VEHICLES
from ..projection.exact import BODIES
from ..projection.height import lean
from ..projection.self_calibration import OwnRuler, own_ruler, trends
from ..projection.view import Views
from ..votes import gather
from .measure import Measured, doubts, tight
from .method import Method
from .model_drift import drift

if TYPE_CHECKING:
    from ...sources.colmap import ColmapSource

ROUNDS = 6  # of projection and pooling; the scale enters its own projection only through the vehicles' height
SETTLED = 1e-4  # relative change of the scale at which the rounds end
HEIGHT_SD = 0.25  # how far a detector's effective height strays from its card between scenes (one sigma) [m]
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
    along = world_axes(source, picture, boxes, view)
    # The height's share of a box is a small correction, so a few rounds of measuring and pooling settle the scale.
    metres_per_unit = float(fleet.mean[0] / np.median(boxes.length * view.unit_per_pixel))
    # The other projections have no effective height, or one of their own: they measure by the detector's card.
    exact = method.projection in (None, "exact")
    card = OwnRuler.shipped(
        found.effective_height, found.ruler.margin, (HEIGHT_SD, HEIGHT_SD), found.ruler.margin_sd, BODIES[found.body]
    )
    ruler = card
    for _ in range(ROUNDS):
        if exact:
            size, slopes = (f(boxes, view, found.zoom, metres_per_unit) for f in (ruler.size, ruler.slopes))
        else:
            size, slopes = method.sizes(boxes, view, metres_per_unit, ruler.height, fleet), None
        solved = np.isfinite(size).all(1)
        own = boxes[solved]
        votes = gather(size[solved], pixel[solved], place[solved], own.score, True, own.spread)
        spread, left = geometry(size[solved], leaning[solved], np.full(2, HEIGHT_SD / metres_per_unit)), found.ruler
        if slopes is not None and solved.any():
            by_height, by_margin, *by_shape = ruler.relative_sd(size[solved], slopes[solved]).T
            spread = np.diag(by_height**2 + np.square(by_shape).sum(0)) + GROUND_SD**2
            per_pixel = np.median(pixel[solved, None] / size[solved], axis=0)
            left = replace(found.ruler, margin=(0.0, 0.0), margin_sd=_pair(by_margin / per_pixel))  # it is off already
        more = []
        if method.surroundings:
            rows = rows_in_model(replace(votes, size=tight(votes, left.margin)), along[solved], fleet.code)
            more = objects_in_model(source, found.objects, found.zoom, metres_per_unit) + ([rows] if rows else [])
        scale = method.pool(votes, fleet, left, source.unit, spread, more)
        change = abs(np.log(scale.value / metres_per_unit))
        metres_per_unit = scale.value
        if change < SETTLED:
            break
        counted = [members for members, used in zip(votes.members, scale.used, strict=True) if used]
        if exact:
            ruler = own_ruler(boxes[solved], view[solved], found.zoom, counted, metres_per_unit, card, ruler)
    lost[NO_HULL] = int((~solved).sum())
    picture = picture[solved]
    bare = size[solved] if exact else size[solved] - card.margin * pixel[solved, None]
    shipped = card.size(boxes, view, found.zoom, metres_per_unit)[solved] if exact else bare
    counted = [members for members, used in zip(votes.members, scale.used, strict=True) if used]
    changes = trends(shipped, bare, np.degrees(view.elevation[solved]), pixel[solved], counted)
    tightened = replace(votes, size=tight(votes, left.margin))
    findings = {
        "calibration": {**ruler.document(card), "trends": changes},
        "drift": drift(bare, picture, tightened, scale, source.ground.plane(votes.place)),
    }
    return Measured(boxes[solved], picture, votes, scale, lost, findings, tightened.size)


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
