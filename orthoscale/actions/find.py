"""The vehicles in a plan, or in a posed set: in its frames as they are, and in frames warped onto the ground."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.detections import Detections
from ..core.measuring.ways import BOTH, OBLIQUE, PLANAR
from ..core.source import Picture, PosedSet, Source
from ..detect.detector import Detector
from ..detect.find import Effort, Progress, find_vehicles, find_zoom
from ..detect.measurer import Measurer
from ..detect.remeasure import remeasured
from ..errors import EvidenceDisagrees, TooLittleEvidence
from .requests import BUILT_IN, EstimateRequest

if TYPE_CHECKING:
    from ..detect.zoom import ZoomChoice


def find_in(
    source: Source,
    mode: str | None,
    detector: Detector,
    zoom: float | None = None,
    progress: Progress | None = None,
    effort: Effort | None = None,
    sampling: Callable[[Detections], float] | None = None,
    enough: Callable[[Detections], bool] | None = None,
) -> tuple[Detections, ZoomChoice | None]:
    """The vehicles in `source`. mode, enough : of a posed set, see `find_in_model`. sampling : see `find_vehicles`.

    Raises TooLittleEvidence, EvidenceDisagrees.
    """
    if source.posed is not None:
        return find_in_model(source.posed, mode, detector, zoom, progress, effort, enough)
    return find_vehicles(source.pictures, detector, zoom, progress, effort, sampling)


def find_in_model(
    source: PosedSet,
    mode: str | None,
    detector: Detector,
    zoom: float | None = None,
    progress: Progress | None = None,
    effort: Effort | None = None,
    enough: Callable[[Detections], bool] | None = None,
) -> tuple[Detections, ZoomChoice | None]:
    """The vehicles in the frames of `source`, and in `planar` those in its pictures of the ground, as `mode` asks.

    zoom : of the frames; by default it is searched for. enough : whether what the pictures of the ground show is
    enough for a scale, see `_planar`; by default it always is. Raises TooLittleEvidence.
    """

    def searched() -> float:
        return find_zoom(source.pictures, detector, _named(progress, "in the frames"), effort).zoom

    enough = enough or (lambda planar: True)
    if mode == PLANAR:
        planar, choice = _planar(_plans(source, True), detector, zoom, progress, effort, enough, searched)
        return replace(planar, boxes={}, doubtful={}, planar=planar), choice
    found, choice = find_vehicles(source.pictures, detector, zoom, progress, effort)
    if mode == OBLIQUE:
        return found, choice
    plans = _plans(source, mode == BOTH)
    if not plans:
        return found, choice
    try:
        known = found.zoom  # what `searched` would give
        planar, _ = _planar(plans, detector, zoom, _named(progress, "from above"), effort, enough, lambda: known)
    except (TooLittleEvidence, EvidenceDisagrees) as error:
        return replace(found, notes=(*found.notes, f"planar sweep: {error.message}")), choice
    return replace(found, planar=planar), choice


def _planar(
    plans: Sequence[Picture],
    detector: Detector,
    zoom: float | None,
    progress: Progress | None,
    effort: Effort | None,
    enough: Callable[[Detections], bool],
    of_frames: Callable[[], float],
) -> tuple[Detections, ZoomChoice | None]:
    """The vehicles in pictures of the ground, the same in `planar` alone and beside the frames.

    The resampling factor is first searched for in these pictures themselves. Where few vehicles stand, a slightly other
    one may decide whether there are enough: then that `of_frames`, which show the same vehicles as large, is tried too.
    Raises TooLittleEvidence, EvidenceDisagrees.
    """
    failed = None
    try:
        found, choice = find_vehicles(plans, detector, zoom, progress, effort)
        if zoom is not None or enough(found):
            return found, choice
    except (TooLittleEvidence, EvidenceDisagrees) as error:
        if zoom is not None:
            raise
        failed = error
    with suppress(TooLittleEvidence, EvidenceDisagrees):
        again, _ = find_vehicles(plans, detector, of_frames(), progress, effort)
        if enough(again):
            return again, None
    if failed is not None:
        raise failed
    return found, choice


def _plans(source: PosedSet, needed: bool) -> list[Picture]:
    plans: list[Picture] = [picture for picture in source.ground_pictures if picture.frame is not None]
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
