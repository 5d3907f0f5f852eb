"""Chooses the measuring modes of a source: planar for a plan, oblique and planar for a posed set.

The two modes of a posed set (in its frames, and in frames warped onto the ground) share neither the projection nor the
pictures, so each checks the other.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ...errors import TooLittleEvidence, UsageError
from ..boxes import KINDS
from ..detections import Detections
from ..fleet import Fleet
from ..pooling.agreement import alone, compare, of_scales, together
from ..pooling.robust import left_by_views
from ..ruler import Ruler
from ..scale import Scale
from ..source import PosedSet, Source
from ..votes import Votes
from .contradiction import Cause, cause
from .drift import with_drift
from .measure import doubts, measure
from .measurement import Measurement, Pooled
from .method import Method
from .oblique import FramesGeometry, shown_in_frames
from .plan import PlanGeometry
from .planar_sweep import SweepGeometry
from .plausibility import plausible

OBLIQUE, PLANAR, BOTH = "oblique", "planar", "both"
SEEN_BOTH_WAYS = 0.8  # of a vehicle's width: largest distance between the places of one vehicle in the two modes


def measure_source(
    source: Source, found: Detections, fleet: Fleet, method: Method | None = None, mode: str | None = None
) -> Measurement:
    """The scale of `source` by the vehicles `found` in it.

    mode : of a posed set, see `measure_posed`; a plan has none. Raises TooLittleEvidence, UsageError.
    """
    if source.plan is not None:
        measured = measure(PlanGeometry.of(source.plan, found), fleet, method)
        scale = plausible(measured.scale, measured.boxes, sum(doubts(found).values()), source.plan.claimed.aspect)
        return _of_one_scale(replace(measured, scale=scale))
    if source.posed is not None:
        return measure_posed(source.posed, found, fleet, method, mode)
    raise TypeError(f"{source!r} is neither a plan nor a posed set")


def measure_posed(
    source: PosedSet, found: Detections, fleet: Fleet, method: Method | None = None, mode: str | None = None
) -> Measurement:
    """The scale of a reconstruction by the vehicles `found`, in each mode that `mode` allows and that has enough of
    them.

    By default both modes are tried. If one has too little evidence, the other is used alone; otherwise they are pooled,
    each vehicle once, and `Measurement.agreement` compares them. If they contradict each other they are not pooled: the
    more certain one gives the value, its verdict is ``unusable``, and its interval covers both. Raises
    TooLittleEvidence, UsageError.
    """
    method = method or Method()
    if mode in (PLANAR, BOTH) and found.planar is None:
        raise UsageError(
            f"--mode {mode}: these detections hold no boxes of a planar sweep",
            "Remove --detections, or use a file that --save-detections wrote for --mode both.",
        )
    ways: dict[str, Callable[[], Measurement]] = {
        OBLIQUE: lambda: measure(FramesGeometry.of(source, found, fleet, method), fleet, method)
    }
    if found.planar is not None:
        planar = found.planar
        ways[PLANAR] = lambda: measure(SweepGeometry.of(source, planar), fleet, method)
    if mode in (OBLIQUE, PLANAR):
        ways = {mode: ways[mode]}
    modes: dict[str, Measurement] = {}
    failed: dict[str, TooLittleEvidence] = {}
    for name, way in ways.items():
        try:
            modes[name] = way()
        except TooLittleEvidence as error:
            failed[name] = error
    if not modes:
        raise next(iter(failed.values()))
    notes = tuple(f"{name}: {error.message}" for name, error in failed.items())
    if source.focal.said:
        notes = (*notes, source.focal.said)
    return replace(_of_one_scale(_answer(source, found, modes, fleet, method)), modes=modes, notes=notes)


def _answer(
    source: PosedSet, found: Detections, modes: dict[str, Measurement], fleet: Fleet, method: Method
) -> Measurement:
    """The scale by one mode, or by both."""
    first = next(iter(modes.values()))
    if len(modes) == 1:
        return first
    ratio, place = _common(*modes.values())
    scales = {name: m.scale for name, m in modes.items()}
    one_network = found.planar is not None and found.planar.detector_sha256 == found.detector_sha256
    agreement = compare(scales, ratio, one_network)
    if agreement.contradicts:
        why, said = cause(
            agreement, of_scales(scales, ratio), source.ground.plane(place), modes[OBLIQUE].found.calibration
        )
        agreement = replace(agreement, cause=said, spared=PLANAR if why is Cause.LENS else "")
    answer = modes[name] if (name := alone(agreement)) is not None else first
    scale = together(agreement)
    if name is None:
        with suppress(TooLittleEvidence):  # among all vehicles of both modes, too few may agree on one scale
            scale = _by_vehicles(source, found, modes, fleet, method)
    return replace(answer, scale=replace(scale, remarks=(*scale.remarks, agreement.remark)), agreement=agreement)


def _by_vehicles(
    source: PosedSet, found: Detections, modes: dict[str, Measurement], fleet: Fleet, method: Method
) -> Scale:
    """The scale by all vehicles of both modes, each counted once. A vehicle found in one ground picture only, and in
    none of many frames that show its place, is a false detection."""
    first = next(iter(modes.values()))
    votes, ruler, covariance = united(*modes.values())
    in_frames = shown_in_frames(source, found, first.boxes, votes.place)
    votes = replace(votes, shown=in_frames if votes.shown is None else np.maximum(votes.shown, in_frames))
    more = next((m.pooled.more for m in modes.values() if m.pooled.more), ())  # both modes see the same rows
    scale = method.pool(votes, fleet, ruler, first.scale.unit, covariance, more)
    checks = {**scale.checks, **{name: m.scale.value for name, m in modes.items()}}
    return replace(scale, used=first.scale.used, reasons=first.scale.reasons, checks=checks)


def _of_one_scale(measured: Measurement) -> Measurement:
    """`measured`, with the drift of its scale as a part of the uncertainty: the scale at one place is less certain than
    the mean."""
    if measured.drift is None:
        return measured
    return replace(measured, scale=with_drift(measured.scale, measured.drift.amplitude, measured.drift.warnings))


def united(a: Measurement, b: Measurement) -> tuple[Votes, Ruler, np.ndarray]:
    """The vehicles of two modes as one set of votes, without the margin; their ruler; and the (2, 2) covariance of the
    geometry's errors.

    The two sizes of a vehicle measured in both modes are weighted by the errors that the modes do not share
    (`_shares`). The ruler's uncertainty is the weighted mean of both, as if it were common to them; with two networks
    that is true only in part. The geometry's uncertainty is common in part.
    """
    ia, ib = _matched(a, b, np.arange(len(a.votes)), np.arange(len(b.votes)))
    share = _shares(a.pooled, b.pooled, ia, ib)
    weight = _weights(a, b, ia, ib, share)
    systematic = a.pooled.systematic.mean(b.pooled.systematic, weight[1])
    return _joined_votes(a, b, ia, ib, share), _joined_ruler(a, b, weight), systematic.covariance


def _joined_votes(a: Measurement, b: Measurement, ia: np.ndarray, ib: np.ndarray, share: np.ndarray) -> Votes:
    """All vehicles of `a`, then those that only `b` measured.

    ia, ib : (K,) indices of the votes in `a` and in `b` that are one vehicle. Its size is the mean of the two, in which
    `a` has the weight `share` (K, 2). Both modes use the same pixels, so its noise is the weighted mean of the two
    noises and does not average out. Its kind probabilities are the mean of the two.
    """
    rest = np.setdiff1d(np.arange(len(b.votes)), ib)
    size, noise, views = a.size.copy(), a.pooled.noise.copy(), a.votes.views.copy()
    size[ia] = np.exp(share * np.log(a.size[ia]) + (1 - share) * np.log(b.size[ib]))
    noise[ia] = share * a.pooled.noise[ia] + (1 - share) * b.pooled.noise[ib]
    views[ia] = np.maximum(views[ia], b.votes.views[ib])
    views = np.concatenate([views, b.votes.views[rest]])
    noise = np.concatenate([noise, b.pooled.noise[rest]])
    shown = None
    if a.votes.shown is not None and b.votes.shown is not None:
        shown = a.votes.shown.copy()
        shown[ia] = np.maximum(shown[ia], b.votes.shown[ib])
        shown = np.concatenate([shown, b.votes.shown[rest]])
    kinds, other = _kinds(a), _kinds(b)
    mean = (kinds[ia] + other[ib]) / 2
    kinds[ia] = np.where(np.isfinite(mean), mean, np.where(np.isfinite(kinds[ia]), kinds[ia], other[ib]))
    return Votes(
        size=np.concatenate([size, b.size[rest]]),
        pixel=np.concatenate([a.votes.pixel, b.votes.pixel[rest]]),
        views=views,
        place=np.concatenate([a.votes.place, b.votes.place[rest]]),
        score=np.concatenate([a.votes.score, b.votes.score[rest]]),
        members=[np.array([k]) for k in range(len(noise))],
        sigma=noise / left_by_views(views)[:, None],
        kinds=np.concatenate([kinds, other[rest]]),
        shown=shown,
    )


def _joined_ruler(a: Measurement, b: Measurement, weight: np.ndarray) -> Ruler:
    """The ruler of the vehicles of both modes, by the modes' `weight` (2 modes, 2) from `_weights`. The margins are
    removed already, so their uncertainty is added to the bias."""
    rulers = a.pooled.ruler, b.pooled.ruler
    bias = [
        np.hypot(ruler.bias_sd, np.asarray(ruler.margin_sd) * np.median(way.votes.pixel[:, None] / way.size, axis=0))
        for ruler, way in zip(rulers, (a, b), strict=True)
    ]
    middle: dict[str, Any] = {
        name: tuple((weight * [getattr(ruler, name) for ruler in rulers]).sum(0).tolist())
        for name in ("shrink", "shrink_sd", "usual")
    }
    of_kinds = next((ruler for ruler in rulers if ruler.kinds), rulers[0])
    return Ruler(
        margin_sd=(0.0, 0.0),
        bias_sd=tuple((weight * bias).sum(0).tolist()),
        common_sd=float(weight.mean(1) @ [ruler.common_sd for ruler in rulers]),
        kinds=of_kinds.kinds,
        kinds_vehicles=of_kinds.kinds_vehicles,
        **middle,
    )


def _shares(a: Pooled, b: Pooled, ia: np.ndarray, ib: np.ndarray) -> np.ndarray:
    """(K, 2) weights of `a` in the lengths and widths of the K vehicles `ia`, `ib` that both measured: those that
    minimise the variance of the mean of all K. In that mean, the noise variance of each counts for a Kth, errors common
    to a mode in full."""
    both, count = a.systematic.cross(b.systematic), max(len(ia), 1)
    own = [np.diag(way.systematic.covariance) - both + way.noise[some] ** 2 / count for way, some in ((a, ia), (b, ib))]
    return np.clip(own[1] / (own[0] + own[1]), 0, 1)


def _weights(a: Measurement, b: Measurement, ia: np.ndarray, ib: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(2 modes, 2) weights of the modes in the mean of all lengths, and of all widths. ia, ib : (K,) votes of vehicles
    measured in both, in which `a` has the weight `share` (K, 2). All vehicles have equal weight: their true sizes
    differ by more than any measurement error."""
    of_a = np.ones((len(a.votes), 2))
    of_a[ia] = share
    counts = a.scale.used.copy()
    counts[ia] |= b.scale.used[ib]
    only_b = b.scale.used.copy()
    only_b[ib] = False
    first = of_a[counts].sum(0) / (counts.sum() + only_b.sum())
    return np.array([first, 1 - first])


def _kinds(of: Measurement) -> np.ndarray:
    """(N, 4) kind probabilities of the votes of a measurement, NaN where they are not used."""
    if of.votes.kinds is None or not of.pooled.ruler.kinds:
        return np.full((len(of.votes), len(KINDS)), np.nan)
    return of.votes.kinds.copy()


def _common(a: Measurement, b: Measurement) -> tuple[np.ndarray, np.ndarray]:
    """(K, 2) log ratio of the sizes by `a` to those by `b`, of the vehicles that count in both; and their (K, 3)
    positions."""
    ia, ib = _matched(a, b, *(np.flatnonzero(m.scale.used) for m in (a, b)))
    return np.log(a.size[ia]) - np.log(b.size[ib]), a.votes.place[ia]


def _matched(a: Measurement, b: Measurement, some_a: np.ndarray, some_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the votes in `a` and in `b` that are the same vehicle: mutual nearest neighbours among those of
    indices `some_a` and `some_b`."""
    if not len(some_a) or not len(some_b):
        return np.empty(0, int), np.empty(0, int)
    reach = SEEN_BOTH_WAYS * float(np.median(a.size[some_a, 1]))
    trees = cKDTree(a.votes.place[some_a]), cKDTree(b.votes.place[some_b])
    distance, nearest = trees[0].query(b.votes.place[some_b], distance_upper_bound=reach)
    k = np.flatnonzero(np.isfinite(distance))
    mutual = trees[1].query(a.votes.place[some_a[nearest[k]]])[1] == k
    return some_a[nearest[k[mutual]]], some_b[k[mutual]]
