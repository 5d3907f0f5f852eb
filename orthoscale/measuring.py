"""From boxes to the scale: projection onto the ground, one vote per vehicle, pooling."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

from .boxes import Boxes
from .detections import Detections
from .errors import TooLittleEvidence
from .fleet import Fleet
from .method import Method
from .pooling import MIN_VEHICLES, Scale
from .projection.height import fit_height, lean
from .projection.planar import ground_size as planar_size
from .projection.view import Views
from .surroundings import orthophoto_evidence
from .votes import Votes, gather

if TYPE_CHECKING:
    from .sources.colmap import ColmapSource
    from .sources.source import Source

# Boxes that were measured, the picture of each (M,), the votes, the scale, and boxes lost on the way by reason.
Measured = tuple[Boxes, np.ndarray, Votes, Scale, dict[str, int]]

ROUNDS = 6  # of exact projection and pooling; the scale enters its own projection only through the vehicles' height
SETTLED = 1e-4  # relative change of the scale at which the rounds end
# Relative uncertainty of a reconstruction's ground under the vehicles (one sigma), as a share of the camera's height:
# sparse points on bare ground scatter by about this much on the two real scenes.
GROUND_SD = 0.01
# How far a detector's effective height strays from its card between scenes (one sigma) [m], and its upper bound.
HEIGHT_SD = 0.25
MAX_HEIGHT = 1.5
NO_GROUND = "no ground under the box, or seen too flatly"
NO_HULL = "no vehicle on the ground gives this box"


def measure(source: Source, found: Detections, fleet: Fleet, method: Method | None = None) -> Measured:
    """From boxes to the scale: projection onto the ground, one vote per vehicle, pooling."""
    method = method or Method()
    if source.unit == "m/px":
        return _measure_planar(source, found, fleet, method)
    return _measure_model(cast("ColmapSource", source), found, fleet, method)


def _measure_planar(source: Source, found: Detections, fleet: Fleet, method: Method) -> Measured:
    (name,) = source.picture_names
    boxes = found.boxes.get(name, Boxes.empty())
    size = planar_size(boxes)
    votes = gather(size, np.full(len(boxes), 1 / found.zoom), boxes.centre, boxes.score, False, boxes.spread)
    objects = found.objects.get(name, {})
    more = orthophoto_evidence(votes, boxes.angle, objects, found.zoom, found.ruler, fleet.code)
    scale = method.pool(votes, fleet, found.ruler, source.unit, more=more if method.surroundings else ())
    return boxes, np.full(len(boxes), name), votes, scale, _lost(found)


def _measure_model(source: ColmapSource, found: Detections, fleet: Fleet, method: Method) -> Measured:
    parts, names, views, places = [], [], [], []
    lost = _lost(found)
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
    height, height_sd = np.array(found.effective_height), np.full(2, HEIGHT_SD)
    for _ in range(ROUNDS):
        size = method.sizes(boxes, view, metres_per_unit, height, fleet)
        solved = np.isfinite(size).all(1)
        own = boxes[solved]
        votes = gather(size[solved], pixel[solved], place[solved], own.score, True, own.spread)
        scale = method.pool(
            votes,
            fleet,
            found.ruler,
            source.unit,
            _geometry(size[solved], leaning[solved], height_sd / metres_per_unit),
        )
        change = abs(np.log(scale.value / metres_per_unit))
        metres_per_unit = scale.value
        if change < SETTLED:
            break
        counted = [members for members, used in zip(votes.members, scale.used, strict=True) if used]
        flat = size[solved] + leaning[solved] * height / metres_per_unit
        height, height_sd = _calibrated_height(found, flat, leaning[solved], counted, metres_per_unit)
    lost[NO_HULL] = int((~solved).sum())
    return boxes[solved], picture[solved], votes, scale, lost


def _calibrated_height(
    found: Detections, flat_size: np.ndarray, leaning: np.ndarray, members: list[np.ndarray], metres_per_unit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Effective heights for length and width [m] and their one sigma: the detector's, and what the views say."""
    seen, seen_sd = (v * metres_per_unit for v in fit_height(flat_size, leaning, members))
    weight, prior_weight = 1 / seen_sd**2, 1 / HEIGHT_SD**2
    height = (weight * seen + prior_weight * np.array(found.effective_height)) / (weight + prior_weight)
    return np.clip(height, 0.0, MAX_HEIGHT), 1 / np.sqrt(weight + prior_weight)


def _geometry(size: np.ndarray, leaning: np.ndarray, height_sd: np.ndarray) -> np.ndarray:
    """(2, 2) relative covariance of length and width from the ground's height (shared) and the effective height."""
    if not len(size):
        return np.zeros((2, 2))
    share = np.median(leaning * height_sd / size, axis=0)
    return np.diag(share**2) + GROUND_SD**2


def _lost(found: Detections) -> dict[str, int]:
    return {found.doubt: sum(map(len, found.doubtful.values()))}
