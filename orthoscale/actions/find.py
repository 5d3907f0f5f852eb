"""Finds the vehicles of a source: in a plan, in a posed set's frames, and in frames warped onto the ground."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..core.detections import Detections
from ..core.measuring.ways import BOTH, OBLIQUE, PLANAR
from ..core.progress import Progress
from ..core.source import GroundView, Picture, PosedSet, Source
from ..detect.cover import FEW_FRAMES, Cover, covering, places_seen, seen_from_above
from ..detect.detector import Detector
from ..detect.effort import Effort
from ..detect.find import find_vehicles, find_zoom
from ..detect.measurer import Measurer
from ..detect.remeasure import MOST_IN_FRAMES, remeasured
from ..errors import EvidenceDisagrees, TooLittleEvidence
from ..requests import BUILT_IN, EstimateRequest

Spread = Callable[[Detections], float]
"""The sampling part of the uncertainty that follows from what was found so far, infinite for too little."""


@dataclass(frozen=True)
class Sampling:
    """How well the vehicles found so far determine the scale; None if all pictures are to be processed.

    in_pictures : in an orthophoto or in frames. from_above : in the ground pictures of a model.
    """

    in_pictures: Spread | None = None
    from_above: Spread | None = None


@dataclass(frozen=True)
class VehicleSearch:
    """How vehicles are searched for, the same for all pictures of a source.

    zoom : resampling factor (of a model, in its frames); None to search for it. sampling : when a sweep may stop.
    """

    detector: Detector
    zoom: float | None = None
    effort: Effort = Effort()
    sampling: Sampling = Sampling()
    progress: Progress | None = None

    def within(self, where: str) -> VehicleSearch:
        """The same search, with `where` appended to its progress messages."""
        return replace(self, progress=_named(self.progress, where))

    def vehicles(self, pictures: Sequence[Picture], spread: Spread | None, cover: Cover | None = None) -> Detections:
        """See `find_vehicles`; `spread` is its `sampling`."""
        return find_vehicles(pictures, self.detector, self.zoom, self.progress, self.effort, spread, cover)


def find_in(source: Source, mode: str | None, search: VehicleSearch) -> Detections:
    """The vehicles in `source`. mode : for a posed set, see `find_in_model`.

    Raises TooLittleEvidence, EvidenceDisagrees.
    """
    if source.posed is not None:
        return find_in_model(source, mode, search)
    return search.vehicles(source.pictures, search.sampling.in_pictures)


def find_in_model(source: PosedSet, mode: str | None, search: VehicleSearch) -> Detections:
    """The vehicles in the frames of `source`, and as `Detections.planar` those in its ground pictures, as `mode` asks.

    Of FEW_FRAMES frames or more, only a selection that covers the whole ground is processed (`detect.cover`), if the
    search has a `sampling` that decides whether this is enough for a scale. Without it all are processed.

    Raises TooLittleEvidence, EvidenceDisagrees; if `mode` needs ground pictures and there are none, before any search.
    """
    names = [picture.name for picture in source.pictures]
    seen = places_seen(source, names) if len(names) >= FEW_FRAMES else {}
    cover = covering(list(seen.values())) if seen else None
    plans = [] if mode == OBLIQUE else _plans(source, needed=mode in (PLANAR, BOTH))
    places = [seen_from_above(seen[plan.image]) for plan in plans] if len(plans) >= FEW_FRAMES else []
    cover_above = covering(places) if places else None
    if mode == PLANAR:
        progress = _named(search.progress, "in the frames")
        planar = _planar(
            plans,
            search,
            cover_above,
            lambda: find_zoom(source.pictures, search.detector, progress, search.effort, cover).zoom,
        )
        return replace(planar, boxes={}, doubtful={}, set_aside={}, planar=planar)
    found = search.vehicles(source.pictures, search.sampling.in_pictures if cover is not None else None, cover)
    if not plans:
        return found
    try:
        planar = _planar(plans, search.within("from above"), cover_above, lambda: found.zoom)
    except (TooLittleEvidence, EvidenceDisagrees) as error:
        return replace(found, notes=(*found.notes, f"planar sweep: {error.message}"))
    return replace(found, planar=planar)


def _planar(
    plans: Sequence[GroundView], search: VehicleSearch, cover: Cover | None, of_frames: Callable[[], float]
) -> Detections:
    """The vehicles in ground pictures; the same whether these are searched alone or besides the frames.

    The resampling factor is first searched for in these pictures themselves. Where there are few vehicles, a slightly
    different factor may decide whether they are enough: then the factor `of_frames` is tried, whose vehicles have the
    same size in pixels. Raises TooLittleEvidence, EvidenceDisagrees.
    """
    spread = search.sampling.from_above
    stop = spread if cover is not None else None

    def enough(planar: Detections) -> bool:
        return spread is None or np.isfinite(spread(planar))

    def as_in_frames() -> Detections | None:
        with suppress(TooLittleEvidence, EvidenceDisagrees):
            again = replace(search, zoom=of_frames()).vehicles(plans, stop, cover)
            if enough(again):
                return again
        return None

    try:
        found = search.vehicles(plans, stop, cover)
    except (TooLittleEvidence, EvidenceDisagrees):
        again = None if search.zoom is not None else as_in_frames()
        if again is None:
            raise
        return again
    if search.zoom is not None or enough(found):
        return found
    again = as_in_frames()
    return found if again is None else again


def _plans(source: PosedSet, needed: bool = False) -> list[GroundView]:
    """The ground pictures whose frames are there. Raises TooLittleEvidence if there are none and some are `needed`."""
    plans = [picture for picture in source.ground_pictures if picture.frame is not None]
    if needed and not plans:
        raise TooLittleEvidence(
            f"no frame of {source.path} sees the ground from near the nadir", "Measure obliquely: --mode oblique."
        )
    return plans


def measurer_of(request: EstimateRequest) -> Measurer | None:
    """The measurer that `request` names; None if it wants none. Raises InputError."""
    if request.measures is None:
        return None
    return Measurer(None if request.measures == BUILT_IN else Path(request.measures))


def measured_anew(
    source: Source,
    found: Detections,
    request: EstimateRequest,
    effort: Effort,
    progress: Progress | None = None,
) -> Detections:
    """`found` with its vehicles measured by the measurer of `request`, in frames and in ground pictures separately;
    unchanged if it has none. Raises InputError."""
    if (measurer := measurer_of(request)) is None:
        return found
    if source.posed is None:
        return remeasured(source.pictures, found, measurer, effort, progress)
    planar = found.planar
    if len(found):
        found = remeasured(source.pictures, found, measurer, effort, progress, MOST_IN_FRAMES)
    if planar is not None:
        plans = _plans(source)
        planar = remeasured(plans, planar, measurer, effort, _named(progress, "from above"))
    return replace(found, planar=planar)


def _named(progress: Progress | None, where: str) -> Progress | None:
    return None if progress is None else lambda what, done, total: progress(f"{what} {where}", done, total)
