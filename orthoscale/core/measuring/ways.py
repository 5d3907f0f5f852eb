"""A plan is measured in one way, a posed set in two: in its frames as they are, and in these warped onto the ground.

The two ways share neither the projection model nor the pictures, so each is a check on the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ...errors import TooLittleEvidence, UsageError
from ..detections import Detections
from ..fleet import Fleet
from ..pooling.agreement import compare, together
from ..source import PosedSet, Source
from .apart import only_apart
from .drift import with_drift
from .measure import measure
from .measurement import Measurement
from .method import Method
from .oblique import FramesGeometry
from .plan import PlanGeometry
from .planar_sweep import SweepGeometry

OBLIQUE, PLANAR, BOTH = "oblique", "planar", "both"
SEEN_BOTH_WAYS = 0.8  # of a vehicle's width: how far apart the two ways may see one vehicle


def measure_source(
    source: Source, found: Detections, fleet: Fleet, method: Method | None = None, mode: str | None = None
) -> Measurement:
    """The scale of `source` by the vehicles `found` in it. mode : of a posed set, see `measure_posed`; a plan has none.

    Raises TooLittleEvidence, UsageError.
    """
    if source.plan is not None:
        measured = measure(PlanGeometry.of(source.plan, found), fleet, method)
        return _of_one_scale(replace(measured, scale=only_apart(measured.scale, measured.boxes)))
    if source.posed is not None:
        return measure_posed(source.posed, found, fleet, method, mode)
    raise TypeError(f"{source!r} is neither a plan nor a posed set")


def measure_posed(
    source: PosedSet, found: Detections, fleet: Fleet, method: Method | None = None, mode: str | None = None
) -> Measurement:
    """The scale of a reconstruction by the vehicles `found`, in each way that `mode` asks for and they allow.

    By default both ways are tried. Where one has too little evidence, the other answers; where both have enough, they
    are pooled, and `Measurement.agreement` says how they fit. Two that contradict each other are not: the surer one
    answers, its verdict is ``unusable``, and its interval reaches over both. Raises TooLittleEvidence, UsageError.
    """
    method = method or Method()
    if mode is None and method.projection is not None:
        mode = OBLIQUE  # a projection is one of frames
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
    return replace(_of_one_scale(_answer(modes)), modes=modes, notes=notes)


def _answer(modes: dict[str, Measurement]) -> Measurement:
    """What one way or two say together."""
    first = next(iter(modes.values()))
    if len(modes) == 1:
        return first
    agreement = compare({name: m.scale for name, m in modes.items()}, _common(*modes.values()))
    answer = modes[agreement.surer] if agreement.contradicts else first
    scale = together(agreement)
    return replace(answer, scale=replace(scale, remarks=(*scale.remarks, agreement.remark)), agreement=agreement)


def _of_one_scale(measured: Measurement) -> Measurement:
    """`measured` with what its drift makes of its scale: that of one place is known less well than that of all."""
    if measured.drift is None:
        return measured
    return replace(measured, scale=with_drift(measured.scale, measured.drift.amplitude, measured.drift.warnings))


def _common(a: Measurement, b: Measurement) -> np.ndarray:
    """(K, 2) log of the sizes that `a` gives over those that `b` gives, for the vehicles that count in both."""
    used_a, used_b = (np.flatnonzero(m.scale.used) for m in (a, b))
    tree = cKDTree(a.votes.place[used_a])
    reach = SEEN_BOTH_WAYS * float(np.median(a.size[used_a, 1]))
    distance, nearest = tree.query(b.votes.place[used_b], distance_upper_bound=reach)
    same = np.isfinite(distance)
    return np.log(a.size[used_a[nearest[same]]]) - np.log(b.size[used_b[same]])
