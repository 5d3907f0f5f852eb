"""Altitude of one photo, by this package's method and by the paper's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..core.boxes import Boxes
from ..core.detections import Detections
from ..core.fleet import Fleet
from ..core.pooling.paper import pool_iqr
from ..core.projection.decoupled import PROGRAM, TEXT, Variant, focal_plane_scale
from ..errors import InputError, TooLittleEvidence
from ..photos.depth.maps import Depths
from ..photos.measure import measure
from ..photos.photo import Photo


@dataclass(frozen=True)
class Estimate:
    """altitude [m], low and high of its 90 % interval if it has one, and the number of vehicles used."""

    altitude: float
    low: float | None
    high: float | None
    vehicles: int


Method = Callable[[Photo, Detections, Fleet, float], Estimate | None]


def exact(photo: Photo, found: Detections, fleet: Fleet, min_score: float) -> Estimate | None:
    """The exact projection, pooled with the fleet, as `orthoscale photo` does; None for too few vehicles."""
    boxes = found.boxes.get(photo.name, Boxes.empty())
    confident = replace(found, boxes={photo.name: boxes[boxes.score > min_score]})
    try:
        got = measure([photo], confident, fleet)
    except TooLittleEvidence:
        return None
    return Estimate(got.altitude.value, got.altitude.low, got.altitude.high, got.scale.vehicles_used)


def paper(variant: Variant) -> Method:
    """The paper's method: decoupled projection, the same priors for every country, and the mean within the whiskers."""

    def estimate(photo: Photo, found: Detections, fleet: Fleet, min_score: float) -> Estimate | None:
        boxes = found.boxes.get(photo.name, Boxes.empty())
        views, ok = photo.views(boxes.centre, photo.lens.focal_px)
        boxes = boxes[ok]
        if not len(boxes):
            return None
        scales = focal_plane_scale(boxes, views[ok], variant=variant).mean(1)
        try:
            got = pool_iqr(scales, boxes.score, min_score, min_vehicles=1)
        except TooLittleEvidence:
            return None
        focal = photo.lens.focal_px
        low, high = (max(bound, 0.0) * focal for bound in got.interval90)
        return Estimate(got.value * focal, low, high, int(np.sum(boxes.score > min_score)))

    return estimate


def by_depth(depths: Depths, refused: Counter[str]) -> Method:
    """The altitude over the ground around the vehicles in a photo's depth map, without an interval.

    refused : counts the reasons why maps give no altitude.
    """

    def estimate(photo: Photo, found: Detections, fleet: Fleet, min_score: float) -> Estimate | None:
        boxes = found.boxes.get(photo.name, Boxes.empty())
        try:
            got = depths.altitude(photo, boxes[boxes.score > min_score])
        except InputError as error:
            refused[error.message] += 1
            return None
        return Estimate(got.altitude, None, None, got.vehicles)

    return estimate


EXACT = "exact"
BY_DEPTH = "depth"
METHODS: dict[str, Method] = {EXACT: exact, "paper": paper(TEXT), "program": paper(PROGRAM)}
