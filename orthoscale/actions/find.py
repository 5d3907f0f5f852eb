"""The vehicles in a plan, or in a posed set: in its frames as they are, and in frames warped onto the ground."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.detections import Detections
from ..core.measuring.ways import BOTH, OBLIQUE, PLANAR
from ..core.progress import Progress
from ..core.source import GroundView, PosedSet, Source
from ..detect.cover import FEW_FRAMES, Cover, covering, places_seen, seen_from_above
from ..detect.detector import Detector
from ..detect.find import ZOOM_FRAMES, Effort, find_vehicles, find_zoom
from ..detect.measurer import Measurer
from ..detect.remeasure import remeasured
from ..errors import EvidenceDisagrees, TooLittleEvidence
from .requests import BUILT_IN, EstimateRequest

if TYPE_CHECKING:
    from ..detect.zoom import ZoomChoice

Spread = Callable[[Detections], float]
"""The sampling part of the uncertainty that follows from what was found so far, infinite for too little."""
Found = tuple[Detections, "ZoomChoice | None"]


@dataclass(frozen=True)
class Sampling:
    """How sure the vehicles found so far make the scale; None where all pictures are to be looked at.

    in_pictures : of an orthophoto or of frames. from_above : of pictures of a model's ground.
    """

    in_pictures: Spread | None = None
    from_above: Spread | None = None


def find_in(
    source: Source,
    mode: str | None,
    detector: Detector,
    zoom: float | None = None,
    progress: Progress | None = None,
    effort: Effort | None = None,
    sampling: Sampling | None = None,
) -> tuple[Detections, ZoomChoice | None]:
    """The vehicles in `source`. mode : of a posed set, see `find_in_model`. sampling : by which the sweep may stop.

    Raises TooLittleEvidence, EvidenceDisagrees.
    """
    sampling = sampling or Sampling()
    if source.posed is not None:
        return find_in_model(source.posed, mode, detector, zoom, progress, effort, sampling)
    return find_vehicles(source.pictures, detector, zoom, progress, effort, sampling.in_pictures)


def find_in_model(
    source: PosedSet,
    mode: str | None,
    detector: Detector,
    zoom: float | None = None,
    progress: Progress | None = None,
    effort: Effort | None = None,
    sampling: Sampling | None = None,
) -> tuple[Detections, ZoomChoice | None]:
    """The vehicles in the frames of `source`, and in `planar` those in its pictures of the ground, as `mode` asks.

    zoom : of the frames; by default it is searched for. sampling : says whether what was seen is enough for a scale; of
    FEW_FRAMES and more only those that show all of the ground are then looked at (`detect.cover`). Without it all are,
    and what they show is always enough. Raises TooLittleEvidence.
    """
    sampling = sampling or Sampling()
    names = [picture.name for picture in source.pictures]
    seen = places_seen(source, names) if len(names) >= FEW_FRAMES else {}
    cover = covering(list(seen.values())) if seen else None

    def searched() -> float:
        some = source.pictures if cover is None else [source.pictures[k] for k in cover.first(ZOOM_FRAMES)]
        return find_zoom(some, detector, _named(progress, "in the frames"), effort).zoom

    def planar(plans: Sequence[GroundView], shown: Progress | None, of_frames: Callable[[], float]) -> Found:
        places = [seen_from_above(seen[plan.image]) for plan in plans] if len(plans) >= FEW_FRAMES else []
        above = covering(places) if places else None
        return _planar(plans, detector, zoom, shown, effort, sampling.from_above, above, of_frames)

    if mode == PLANAR:
        from_above, choice = planar(_plans(source, True), progress, searched)
        return replace(from_above, boxes={}, doubtful={}, planar=from_above), choice
    in_frames = sampling.in_pictures if cover is not None else None
    found, choice = find_vehicles(source.pictures, detector, zoom, progress, effort, in_frames, cover)
    if mode == OBLIQUE:
        return found, choice
    plans = _plans(source, mode == BOTH)
    if not plans:
        return found, choice
    try:
        known = found.zoom  # what `searched` would give
        from_above, _ = planar(plans, _named(progress, "from above"), lambda: known)
    except (TooLittleEvidence, EvidenceDisagrees) as error:
        return replace(found, notes=(*found.notes, f"planar sweep: {error.message}")), choice
    return replace(found, planar=from_above), choice


def _planar(
    plans: Sequence[GroundView],
    detector: Detector,
    zoom: float | None,
    progress: Progress | None,
    effort: Effort | None,
    sampling: Spread | None,
    cover: Cover | None,
    of_frames: Callable[[], float],
) -> Found:
    """The vehicles in pictures of the ground, the same in `planar` alone and beside the frames.

    The resampling factor is first searched for in these pictures themselves. Where few vehicles stand, a slightly other
    one may decide whether there are enough: then that `of_frames`, which show the same vehicles as large, is tried too.
    Raises TooLittleEvidence, EvidenceDisagrees.
    """
    stop = sampling if cover is not None else None

    def enough(planar: Detections) -> bool:
        return sampling is None or np.isfinite(sampling(planar))

    failed = None
    try:
        found, choice = find_vehicles(plans, detector, zoom, progress, effort, stop, cover)
        if zoom is not None or enough(found):
            return found, choice
    except (TooLittleEvidence, EvidenceDisagrees) as error:
        if zoom is not None:
            raise
        failed = error
    with suppress(TooLittleEvidence, EvidenceDisagrees):
        again, _ = find_vehicles(plans, detector, of_frames(), progress, effort, stop, cover)
        if enough(again):
            return again, None
    if failed is not None:
        raise failed
    return found, choice


def _plans(source: PosedSet, needed: bool) -> list[GroundView]:
    plans = [picture for picture in source.ground_pictures if picture.frame is not None]
    if needed and not plans:
        raise TooLittleEvidence(
            f"no frame of {source.path} sees the ground from near the nadir", "Measure obliquely: --mode oblique."
        )
    return plans


def measured_anew(
    source: Source,
    found: Detections,
    request: EstimateRequest,
    effort: Effort | None = None,
    progress: Progress | None = None,
) -> Detections:
    """`found` with what is seen from above measured by the measurer that is asked for; as it is, if none is.

    In frames it is not: seen at a slant, the measurer's edges are those of what is bright, not of the body that the
    projection takes off. Raises InputError.
    """
    if request.measures is None:
        return found
    measurer = Measurer(None if request.measures == BUILT_IN else Path(request.measures))
    if source.posed is None:
        return remeasured(source.pictures, found, measurer, effort, progress)
    if found.planar is None:
        return found
    plans = _plans(source.posed, False)
    return replace(found, planar=remeasured(plans, found.planar, measurer, effort, _named(progress, "from above")))


def _named(progress: Progress | None, where: str) -> Progress | None:
    return None if progress is None else lambda what, done, total: progress(f"{what} {where}", done, total)
