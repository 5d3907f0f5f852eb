"""The vehicles in a plan, or in a posed set: in its frames as they are, and in frames warped onto the ground."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from ..core.detections import Detections
from ..core.measuring.ways import BOTH, OBLIQUE, PLANAR
from ..core.source import Picture, PosedSet, Source
from ..detect.detector import Detector
from ..detect.find import Effort, Progress, find_vehicles
from ..errors import EvidenceDisagrees, TooLittleEvidence

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
) -> tuple[Detections, ZoomChoice | None]:
    """The vehicles in `source`. mode : of a posed set, see `find_in_model`. sampling : see `find_vehicles`.

    Raises TooLittleEvidence, EvidenceDisagrees.
    """
    if source.posed is not None:
        return find_in_model(source.posed, mode, detector, zoom, progress, effort)
    return find_vehicles(source.pictures, detector, zoom, progress, effort, sampling)


def find_in_model(
    source: PosedSet,
    mode: str | None,
    detector: Detector,
    zoom: float | None = None,
    progress: Progress | None = None,
    effort: Effort | None = None,
) -> tuple[Detections, ZoomChoice | None]:
    """The vehicles in the frames of `source`, and in `planar` those in its pictures of the ground, as `mode` asks.

    zoom : of the frames; by default it is searched for. Raises TooLittleEvidence.
    """
    if mode == PLANAR:
        planar, choice = find_vehicles(_plans(source, True), detector, zoom, progress, effort)
        return replace(planar, boxes={}, doubtful={}, planar=planar), choice
    found, choice = find_vehicles(source.pictures, detector, zoom, progress, effort)
    if mode == OBLIQUE:
        return found, choice
    plans = _plans(source, mode == BOTH)
    if not plans:
        return found, choice
    try:  # as `planar` alone would: what the frames show must not decide how the plans are looked at
        planar, _ = find_vehicles(plans, detector, zoom, _named(progress), effort)
    except (TooLittleEvidence, EvidenceDisagrees) as error:
        return replace(found, notes=(*found.notes, f"planar sweep: {error.message}")), choice
    return replace(found, planar=planar), choice


def _plans(source: PosedSet, needed: bool) -> list[Picture]:
    plans: list[Picture] = [picture for picture in source.ground_pictures if picture.frame is not None]
    if needed and not plans:
        raise TooLittleEvidence(
            f"no frame of {source.path} sees the ground from near the nadir", "Measure obliquely: --mode oblique."
        )
    return plans


def _named(progress: Progress | None) -> Progress | None:
    return None if progress is None else lambda what, done, total: progress(f"{what} from above", done, total)
