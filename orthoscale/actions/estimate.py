"""The main sequence: source, tiles, boxes, projection, pooling, Scale; `actions.fix` adds the copy and the report."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.claims import perhaps_metric
from ..core.detections import UNKNOWN_HEIGHT, UNKNOWN_RULER, Detections
from ..core.fleet import Fleet
from ..core.measuring.anchors import FoundAnchors
from ..core.measuring.footing import BY_POINTS, Footing
from ..core.measuring.measurement import Measurement
from ..core.measuring.method import Method
from ..core.measuring.oblique import FramesGeometry
from ..core.measuring.planar_sweep import SweepGeometry
from ..core.measuring.ways import measure_source
from ..core.measuring.without_vehicles import measured_without_vehicles
from ..core.pooling.anchors import evidence_of
from ..core.pooling.proposed import proposed_class
from ..core.progress import Progress
from ..core.remarks import CAUTION, REFUSAL, Remark
from ..core.source import Source
from ..core.verdicts import UNUSABLE
from ..errors import InputError, TooLittleEvidence
from ..formats.tables import standards
from ..report.result import Result
from ..requests import EstimateRequest
from ..sources.country import country_of
from ..sources.on_map import OnMap
from .against import on_map
from .anchors import Wanted, at_any_scale, kinds_of_boxes, look_for_anchors
from .boxes import boxes_of, effort_of
from .opening import Opened, given_evidence, opened

if TYPE_CHECKING:
    from typing import Unpack

    from ..requests import EstimateOptions

HINT_SD, CLAIM_SD = 0.15, 0.1  # relative one-sigma of --gsd-hint and of georeferencing, where no vehicles give a scale
OR_EVIDENCE = "Or give two kinds of evidence that agree, such as --known-distance and --ground-control."

log = logging.getLogger(__name__)

OnBoxes = Callable[[Detections, Source], None]
"""What is called with the boxes that were found, and their source."""


def estimate(
    path: str | Path | Source, *, progress: Progress | None = None, **options: Unpack[EstimateOptions]
) -> Result:
    """Find the scale of an orthophoto (metres per pixel) or a COLMAP model (metres per model unit).

    path : of the input, or a source that `open_source` opened. progress : called as progress(what, done, total).

    Where the vehicles' boxes come from
    fleet : code of the country's fleet, or a JSON file; by default the calibration's own, else that of the country
    where the input lies, else ``world``.
    detections : file of boxes to use instead of the detector; see `formats.detections`.
    detector : an ONNX file instead of the shipped one.
    decoder : how to read its outputs, if the file does not say (`detect.output_forms.DECODERS`).
    vehicle_classes : names or numbers of the classes that count, instead of those called small vehicles.
    measurer : second network, which measures vehicles seen from above again: "built-in", "none" or an ONNX file; see
    `requests`.
    fast : the small detector makes both detection passes over an orthophoto.
    calibration : file of `orthoscale.calibrate`, whose ruler replaces the detector's own.
    zoom, gsd_hint : resampling factor (detector pixels per picture pixel), or the expected metres per pixel, instead of
    a scale search. refine : look at every vehicle four more times, rotated and at neighbouring resampling factors.

    How it is measured
    images : folder of a model's frames, when not beside it. ground_cloud : its dense cloud or workspace, "none" for its
    sparse points alone; by default one that lies beside it. mode : how a model is measured, one of `requests.MODES`;
    by default in every way that there is evidence for.
    projection, estimator : alternatives to the usual ones, see `measuring.method.Method`. known_distance,
    ground_control : further evidence, see `actions.control`. gps : whether the GPS positions of a model's frames count,
    see `core.gps`. against : a georeferenced map that shows the same ground, see `actions.against`. anchors : which
    objects of standard size are looked for, and anchor : your own standards for them, see `actions.anchors`.

    How much of the pictures is processed, and by what (`detect.effort.Effort`)
    target, exhaustive, seed, workers, scheduler, cache.

    `requests.EstimateRequest` has the defaults, and which options exclude each other. Raises InputError, UsageError (no
    such option, or one that would do nothing), TooLittleEvidence, EvidenceDisagrees.
    """
    return noted(measured(path, EstimateRequest.of(options), progress))


def noted(result: Result) -> Result:
    """`result` with a note on a model that does not count as metric, but whose unit is nearly a metre. (`check`, which
    compares it with a metre, needs none.)"""
    scale = result.scale.remarked(*perhaps_metric(result.source, result.scale))
    return replace(result, measured=replace(result.measured, scale=scale))


@dataclass(frozen=True)
class _Answer:
    """A scale, and what entered it.

    found : the boxes, none if no vehicles were found. method : with all evidence. anchors : those found in the
    pictures. on_map : where the source lies on the map of `--against`.
    """

    found: Detections
    measurement: Measurement
    method: Method
    anchors: FoundAnchors
    on_map: OnMap


def measured(
    path: str | Path | Source,
    request: EstimateRequest,
    progress: Progress | None = None,
    on_boxes: OnBoxes | None = None,
    on_open: Callable[[Source], None] | None = None,
) -> Result:
    """Measure the input at `path` as `request` says; see `estimate`.

    on_boxes : called as soon as boxes are found, also if these give no scale. on_open : called with the source as soon
    as it is open, and may refuse it.
    """
    started = time.perf_counter()
    log.info("measuring %s", path)
    asked = opened(path, request, progress)
    source, fleet = asked.source, asked.fleet
    if on_open is not None:
        on_open(source)
    method = Method(
        request.projection,
        request.estimator,
        evidence=asked.given,
        standards=standards(kinds_of_boxes(request.anchors)),
        country=country_of(source, fleet),
        own=asked.own,
    )
    wanted = Wanted(request.anchors, asked.own, method.country, effort_of(request), progress)
    try:
        answer = _answer(asked, method, request, wanted, on_boxes)
    except TooLittleEvidence as error:
        raise _with_cautions(error, source) from error
    measurement, anchors, match = answer.measurement, answer.anchors, answer.on_map
    if any(note.severity == REFUSAL for note in source.notes):
        measurement = replace(measurement, scale=replace(measurement.scale, verdict=UNUSABLE))
    named = str(request.fleet or fleet.code)
    scale = measurement.scale.remarked(*_of_a_class(measurement, fleet, answer.method, named))
    measurement = replace(measurement, scale=scale)
    log.info("%d anchors, seen %d times", len(anchors.votes), len(anchors.anchors))
    found = replace(answer.found, notes=(*asked.why, *answer.found.notes, *anchors.notes, *match.notes))
    seconds = time.perf_counter() - started
    log.info("%.6g %s by %d vehicles in %.1f s", scale.value, source.unit, scale.vehicles_used, seconds)
    return Result(source, fleet, found, seconds, measurement, answer.method, request.settings(), anchors, match)


def _of_a_class(measurement: Measurement, fleet: Fleet, method: Method, named: str) -> Iterator[Remark]:
    """The remark that most vehicles may be of one class, where the scale is by vehicles. named : what the user calls
    the fleet."""
    if measurement.scale.vehicles_used and not method.vehicles_only:
        pooled = measurement.pooled
        yield from proposed_class(measurement.votes, fleet, pooled.ruler, pooled.systematic.covariance, named)


def _answer(
    asked: Opened, method: Method, request: EstimateRequest, wanted: Wanted, on_boxes: OnBoxes | None
) -> _Answer:
    """The scale from the vehicles and all other evidence; where the vehicles give none, from the other evidence alone.

    Raises TooLittleEvidence, UsageError.
    """
    found = Detections({}, 1.0, UNKNOWN_RULER, UNKNOWN_HEIGHT, "no vehicles found")
    try:
        found = boxes_of(asked, request, wanted.progress)
        if on_boxes is not None:
            on_boxes(found, asked.source)
        return _of_vehicles(asked, found, method, request, wanted)
    except TooLittleEvidence as error:
        if method.vehicles_only:
            raise
        try:
            answer = _without_vehicles(asked, found, method, request, wanted)
        except TooLittleEvidence as also:
            raise TooLittleEvidence(f"{error.message}; {also.message}", error.hint) from error
        if answer is None:
            raise TooLittleEvidence(error.message, f"{error.hint} {OR_EVIDENCE}") from error
        return answer


def _with_cautions(error: TooLittleEvidence, source: Source) -> TooLittleEvidence:
    """The same error with the cautions from opening `source`, which may be why too few vehicles were found in it."""
    cautions = [f"Caution: {note.text}." for note in source.notes if note.severity == CAUTION]
    return TooLittleEvidence(error.message, "\n".join([error.hint, *cautions]))


def _of_vehicles(asked: Opened, found: Detections, method: Method, request: EstimateRequest, wanted: Wanted) -> _Answer:
    """The scale from the vehicles; then with the evidence of the map and of the anchors, both searched at that scale.

    Raises TooLittleEvidence, UsageError.
    """
    source, fleet = asked.source, asked.fleet
    footing = footing_of(source, found, fleet)
    given = method
    if footing is not BY_POINTS:  # the user's evidence is measured on that ground, too
        evidence = given_evidence(source, request, footing)
        given = replace(method, evidence=tuple(evidence))
    by_vehicles = _by_vehicles(source, found, fleet, given, request)

    match, with_map, by_map = OnMap(), given, by_vehicles
    if asked.satellite is not None:
        rough = by_vehicles.scale.value, by_vehicles.scale.relative_sd
        match = on_map(source, asked.satellite, rough, request.cache, wanted.progress, footing)
    if match.evidence:
        with_map = replace(given, evidence=(*given.evidence, *match.evidence))
        by_map = measure_source(source, found, fleet, with_map, request.wanted_mode)

    anchors = FoundAnchors()
    if not method.vehicles_only and not by_map.scale.conflict:
        try:
            anchors = look_for_anchors(source, by_map.scale, replace(wanted, footing=footing))
        except InputError as error:  # if the boxes came from a file, damaged pictures are noticed only here
            anchors = FoundAnchors(notes=(f"no anchors were looked for: {error.message}",))
    if not anchors.votes:
        return _Answer(found, by_map, with_map, anchors, match)
    with_anchors = replace(with_map, anchors=anchors.votes)
    by_anchors = measure_source(source, found, fleet, with_anchors, request.wanted_mode)
    return _Answer(found, by_anchors, with_anchors, anchors, match)


def _without_vehicles(
    asked: Opened, found: Detections, method: Method, request: EstimateRequest, wanted: Wanted
) -> _Answer | None:
    """The scale from the user's evidence, anchors and the map, where the boxes `found` give none; None without any.

    Raises TooLittleEvidence if these do not suffice.
    """
    source = asked.source
    rough, match = _rough(source, request), OnMap()
    if asked.satellite is not None and rough is not None:
        match = on_map(source, asked.satellite, rough, request.cache, wanted.progress)
        method = replace(method, evidence=(*method.evidence, *match.evidence))
    anchors = at_any_scale(source, rough, wanted, known=len({e.kind for e in method.evidence}))
    method = replace(method, anchors=anchors.votes)
    evidence = (*method.evidence, *evidence_of(method.anchors, method.country))
    if not evidence:
        return None
    dims = 2 if source.plan is not None else 3
    by_the_rest = measured_without_vehicles(evidence, source.unit, asked.fleet.code, dims, found.uncounted)
    return _Answer(found, by_the_rest, method, anchors, match)


def _by_vehicles(
    source: Source, found: Detections, fleet: Fleet, method: Method, request: EstimateRequest
) -> Measurement:
    """The scale from the vehicles `found`. Raises TooLittleEvidence, which names the input and the size of its
    vehicles; UsageError."""
    try:
        return measure_source(source, found, fleet, method, request.wanted_mode)
    except TooLittleEvidence as error:
        raise TooLittleEvidence(
            f"{source.path}: {error.message} (resampling factor {found.zoom:.2f}, {_typical_length(found)})",
            "Try the fleet of the country (--fleet), another resampling factor (--gsd-hint METRES_PER_PIXEL or "
            "--zoom FACTOR), or a scene with more vehicles.",
        ) from error


def _rough(source: Source, request: EstimateRequest) -> tuple[float, float] | None:
    """Metres per unit and its relative one-sigma, as the user or the source states it; None where neither does."""
    if request.gsd_hint is not None and source.plan is not None:
        return request.gsd_hint, HINT_SD
    claimed = source.claimed
    if claimed is None or claimed.gsd_m is None or not claimed.usable:
        return None
    return claimed.gsd_m, CLAIM_SD


def footing_of(source: Source, found: Detections, fleet: Fleet) -> Footing:
    """The ground of a reconstruction, from the vehicles `found` in its frames or else in its ground pictures; from its
    sparse points alone where vehicles are too few."""
    if source.posed is not None:
        with suppress(TooLittleEvidence):
            return FramesGeometry.of(source, found, fleet, Method()).footing
        with suppress(TooLittleEvidence):
            if found.planar is not None:
                return SweepGeometry.of(source, found.planar).footing
    return BY_POINTS


def _typical_length(found: Detections) -> str:
    """Part of a sentence: the median length of all boxes [px], or that there are none."""
    boxes = found.boxes or (found.planar.boxes if found.planar is not None else {})
    lengths = [one.length for one in boxes.values() if len(one)]
    if not lengths:
        return "no boxes given" if found.swept is None else "no boxes found"
    return f"vehicles about {np.median(np.concatenate(lengths)):.0f} px long there"
