"""A reconstruction is looked at twice: in its frames as they are, and in frames warped onto the ground."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from ...detect.detector import Detector
from ...detect.find import Effort, Progress, find_vehicles
from ...errors import EvidenceDisagrees, TooLittleEvidence, UsageError
from ..detections import Detections
from ..fleet import Fleet
from ..pooling.agreement import compare, together
from .measure import Measured
from .method import Method
from .oblique import measure_frames
from .planar_sweep import measure_ground

if TYPE_CHECKING:
    from ...detect.zoom import ZoomChoice
    from ...sources.colmap import ColmapSource

OBLIQUE, PLANAR, BOTH = "oblique", "planar", "both"
SAME_IN_BOTH = 0.8  # of a vehicle's width: how far apart the two looks may see one vehicle


def find_in_model(
    source: ColmapSource,
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


def _plans(source: ColmapSource, needed: bool) -> list:
    plans = [picture for picture in source.ground_pictures if picture.frame is not None]
    if needed and not plans:
        raise TooLittleEvidence(
            f"no frame of {source.path} sees the ground from near the nadir", "Measure obliquely: --mode oblique."
        )
    return plans


def _named(progress: Progress | None) -> Progress | None:
    return None if progress is None else lambda what, done, total: progress(f"{what} from above", done, total)


def measure_model(
    source: ColmapSource, found: Detections, fleet: Fleet, method: Method | None = None, mode: str | None = None
) -> Measured:
    """The scale of a reconstruction by the vehicles `found`, in each way that `mode` asks for and they allow.

    By default both ways are tried. Where one has too little evidence, the other answers; where both have enough, they
    are pooled, and `Measured.agreement` says how they fit. Two that contradict each other are not: the surer one
    answers, its verdict is ``unusable``, and its interval reaches over both. Raises TooLittleEvidence, UsageError.
    """
    method = method or Method()
    if mode is None and method.projection is not None:
        mode = OBLIQUE  # a projection is one of frames
    if mode in (PLANAR, BOTH) and found.planar is None:
        raise UsageError(
            f"--mode {mode}: these detections hold no boxes of a planar sweep",
            "Leave --detections away, or use a file that --save-detections wrote for --mode both.",
        )
    ways = {OBLIQUE: lambda: measure_frames(source, found, fleet, method)}
    if found.planar is not None:
        planar = found.planar
        ways[PLANAR] = lambda: measure_ground(source, planar, fleet, method)
    if mode in (OBLIQUE, PLANAR):
        ways = {mode: ways[mode]}
    measured: dict[str, Measured] = {}
    failed: dict[str, TooLittleEvidence] = {}
    for name, way in ways.items():
        try:
            measured[name] = way()
        except TooLittleEvidence as error:
            failed[name] = error
    if not measured:
        raise next(iter(failed.values()))
    notes = tuple(f"{name}: {error.message}" for name, error in failed.items())
    scales = {name: m.scale for name, m in measured.items()}
    agreement = compare(scales, _common(*measured.values())) if len(scales) == 2 else None
    contradiction = agreement is not None and agreement.contradicts
    answer = measured[agreement.surer] if agreement and contradiction else next(iter(measured.values()))
    findings: dict[str, Any] = {**answer.findings, "modes": {name: _plain(m) for name, m in measured.items()}}
    remarks = answer.findings.get("drift", {}).get("remarks", [])
    scale = answer.scale
    if agreement is not None:
        scale = together(agreement)
        remarks = [agreement.sentence(), *remarks] if contradiction else [*remarks, agreement.sentence()]
        findings["agreement"] = {
            "difference": agreement.difference,
            "sigmas": agreement.tension,
            "common_vehicles": agreement.common,
            "contradicts": agreement.contradicts,
        }
    scale = replace(scale, remarks=(*scale.remarks, *remarks))
    return replace(answer, scale=scale, findings=findings, agreement=agreement, notes=notes)


def _common(a: Measured, b: Measured) -> np.ndarray:
    """(K, 2) log of the sizes that `a` gives over those that `b` gives, for the vehicles that count in both."""
    used_a, used_b = (np.flatnonzero(m.scale.used) for m in (a, b))
    tree = cKDTree(a.votes.place[used_a])
    reach = SAME_IN_BOTH * float(np.median(a.size[used_a, 1]))
    distance, nearest = tree.query(b.votes.place[used_b], distance_upper_bound=reach)
    same = np.isfinite(distance)
    return np.log(a.size[used_a[nearest[same]]]) - np.log(b.size[used_b[same]])


def _plain(measured: Measured) -> dict[str, Any]:
    scale = measured.scale
    return {
        "scale": scale.value,
        "interval90": list(scale.interval90),
        "verdict": scale.verdict,
        "vehicles_used": scale.vehicles_used,
        "boxes": len(measured.boxes),
        "uncertainty": dict(scale.parts),
    }
