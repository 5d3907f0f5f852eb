"""Chooses the measuring modes of a source: planar for a plan, oblique and planar for a posed set.

The two modes of a posed set (in its frames, and in frames warped onto the ground) share neither the projection nor the
pictures, so each checks the other. They share what the views in frames tell of the vehicles' bodies.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from ...errors import InputError, TooLittleEvidence, UsageError
from ..detections import Detections
from ..fleet import Fleet
from ..pooling.agreement import alone, compare, of_scales, together
from ..projection.own_ruler import OwnRuler
from ..remarks import CAUTION, ON_PLACES, Remark
from ..scale import Scale
from ..source import PosedSet, Source
from .contradiction import Cause, cause
from .drift import with_drift
from .joining import in_common, united
from .measure import measure
from .measurement import Measurement
from .method import Method
from .oblique import FramesGeometry, card_of, shown_in_frames
from .parts import Parts, found_in
from .patches import other_size
from .plan import PlanGeometry
from .planar_sweep import SweepGeometry
from .plausibility import plausible

OBLIQUE, PLANAR, BOTH = "oblique", "planar", "both"


def measure_source(
    source: Source, found: Detections, fleet: Fleet, method: Method | None = None, mode: str | None = None
) -> Measurement:
    """The scale of `source` by the vehicles `found` in it.

    mode : of a posed set, see `measure_posed`; a plan has none. Raises TooLittleEvidence, UsageError.
    """
    if source.plan is not None:
        measured = measure(PlanGeometry.of(source, found), fleet, method)
        uncounted, aspect = sum(found.uncounted.values()), source.claimed.aspect
        scale = plausible(measured.scale, measured.boxes, uncounted, aspect, not found.zoom_given)
        measured = replace(measured, scale=scale)
        return _of_one_scale(measured, *other_size(measured.vehicles))
    return measure_posed(source, found, fleet, method or Method(), mode)


def measure_posed(source: PosedSet, found: Detections, fleet: Fleet, method: Method, mode: str | None) -> Measurement:
    """The scale of a reconstruction by the vehicles `found`, in each mode that `mode` allows and that has enough of
    them.

    By default both modes are tried. If one has too little evidence, the other is used alone; otherwise they are pooled,
    each vehicle once, and `Measurement.agreement` compares them. If they contradict each other they are not pooled: the
    more certain one gives the value, its verdict is ``unusable``, and its interval covers both. Parts of `source` that
    share no point are compared by the vehicles in their frames (`Measurement.parts`).

    Raises TooLittleEvidence, UsageError.
    """
    whole = _in_modes(source, found, fleet, method, mode)
    scales = [(part.picture_names, _of_part(part, found, fleet, method)) for part in source.parts]
    if not scales:
        return whole
    parts = Parts.of(scales)
    return replace(whole, scale=parts.judged(whole.scale), parts=parts)


def _of_part(part: PosedSet, found: Detections, fleet: Fleet, method: Method) -> Scale | None:
    """The scale of a `part` of a reconstruction by the vehicles `found` in its frames, on its own ground; None for too
    few vehicles, or no ground under its few points."""
    by_vehicles = replace(method, evidence=(), anchors=(), standards=None)
    with suppress(TooLittleEvidence, InputError):
        return _in_modes(part, found_in(set(part.picture_names), found), fleet, by_vehicles, OBLIQUE).scale
    return None


def _in_modes(source: PosedSet, found: Detections, fleet: Fleet, method: Method, mode: str | None) -> Measurement:
    """As `measure_posed`, with all parts of `source` taken for one."""
    if mode in (PLANAR, BOTH) and found.planar is None:
        raise UsageError(
            f"--mode {mode}: these detections hold no boxes of a planar sweep",
            "Remove --detections, or use a file that --save-detections wrote for --mode both.",
        )
    modes: dict[str, Measurement] = {}
    failed: dict[str, TooLittleEvidence] = {}
    if mode != PLANAR:
        try:
            modes[OBLIQUE] = measure(FramesGeometry.of(source, found, fleet, method), fleet, method)
        except TooLittleEvidence as error:
            failed[OBLIQUE] = error
    if mode != OBLIQUE and found.planar is not None:
        fitted = _fitted(modes.get(OBLIQUE), found.planar)
        try:
            modes[PLANAR] = measure(SweepGeometry.of(source, found.planar, fitted), fleet, method)
        except TooLittleEvidence as error:
            failed[PLANAR] = error
    if not modes:
        raise next(iter(failed.values()))
    notes = tuple(f"{name}: {error.message}" for name, error in failed.items())
    if source.focal.said:
        notes = (*notes, source.focal.said)
    return replace(_of_one_scale(_answer(source, found, modes, fleet, method)), modes=modes, notes=notes)


def _fitted(oblique: Measurement | None, planar: Detections) -> OwnRuler | None:
    """The ruler fitted to the views of `oblique`, for the boxes `planar` of a network with the same card; else None."""
    calibration = oblique.findings.calibration if oblique is not None else None
    if calibration is None or not np.array_equal(calibration.card.body_alone.value, card_of(planar).body_alone.value):
        return None
    return calibration.ruler


def _answer(
    source: PosedSet, found: Detections, modes: dict[str, Measurement], fleet: Fleet, method: Method
) -> Measurement:
    """The scale by one mode, or by both."""
    first = next(iter(modes.values()))
    if len(modes) == 1:
        return first
    ratio, place = in_common(*modes.values())
    scales = {name: m.scale for name, m in modes.items()}
    one_network = found.planar is not None and found.planar.detector_sha256 == found.detector_sha256
    agreement = compare(scales, ratio, one_network)
    if agreement.contradicts:
        why, said = cause(
            agreement, of_scales(scales, ratio), source.ground.plane(place), modes[OBLIQUE].findings.calibration
        )
        agreement = replace(agreement, cause=said, spared=PLANAR if why is Cause.LENS else "")
    name, scale = alone(agreement), together(agreement)
    answer = first if name is None else modes[name]
    if name is None:
        with suppress(TooLittleEvidence):  # among all vehicles of both modes, too few may agree on one scale
            scale = _by_vehicles(source, found, modes, fleet, method)
    return replace(answer, scale=replace(scale, remarks=(*scale.remarks, agreement.remark)), agreement=agreement)


def _by_vehicles(
    source: PosedSet, found: Detections, modes: dict[str, Measurement], fleet: Fleet, method: Method
) -> Scale:
    """The scale by all vehicles of both modes, each counted once. A vehicle found in few ground pictures, and in none
    of many frames that show its place, is a false detection."""
    first = next(iter(modes.values()))
    votes, ruler, covariance = united(*modes.values())
    in_frames = shown_in_frames(source, found, first.boxes, votes.place)
    votes = replace(votes, shown=in_frames if votes.shown is None else np.maximum(votes.shown, in_frames))
    more = next((m.pooled.more for m in modes.values() if m.pooled.more), ())  # both modes see the same rows
    scale = method.pool(votes, fleet, ruler, first.scale.unit, covariance, more)
    checks = {**scale.checks, **{name: m.scale.value for name, m in modes.items()}}
    return replace(scale, used=first.scale.used, reasons=first.scale.reasons, checks=checks)


def _of_one_scale(measured: Measurement, stray: float = 0.0, said: str = "") -> Measurement:
    """`measured`, with the drift of its scale as a part of the uncertainty: the scale at one place is less certain than
    the mean. stray, said : of `patches.other_size`, which is like a drift."""
    drift = measured.drift
    amplitude, texts = (0.0, []) if drift is None else (drift.amplitude, drift.warnings)
    warnings = [Remark(CAUTION, text, check=ON_PLACES) for text in texts]
    warnings += [Remark(CAUTION, said)] if said else []
    return replace(measured, scale=with_drift(measured.scale, float(np.hypot(amplitude, stray)), warnings))
