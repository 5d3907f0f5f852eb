"""The way the data goes: source, tiles, boxes, projection, pooling, Scale, written copy, report."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from ..core.calibration import Calibration, fleet_of
from ..core.detections import Detections
from ..core.evidence import Evidence
from ..core.fleet import Fleet
from ..core.measuring.drift import drift
from ..core.measuring.looks import find_in_model, measure_model
from ..core.measuring.measure import measure
from ..core.measuring.method import Method
from ..detect.detector import Detector
from ..detect.find import Effort, Progress, find_vehicles
from ..detect.refine import refined
from ..detect.workers import worker_count
from ..detect.zoom import told_zoom
from ..errors import EvidenceDisagrees, TooLittleEvidence
from ..evidence.control import read_control, read_distance
from ..formats.detections import load as load_detections
from ..sources.opening import open_source
from .requests import EstimateRequest
from .result import Result

if TYPE_CHECKING:
    from typing import Unpack

    from ..detect.zoom import ZoomChoice
    from ..sources.colmap import ColmapSource
    from ..sources.source import Source
    from .requests import EstimateOptions

log = logging.getLogger(__name__)


def estimate(
    path: str | Path | Source, *, progress: Progress | None = None, **options: Unpack[EstimateOptions]
) -> Result:
    """Find the scale of an orthophoto (metres per pixel) or a COLMAP model (metres per model unit).

    path : of the input, or a source that `open_source` opened. progress : told what is done, (what, done, total).

    Where the vehicles' boxes come from
    fleet : code of the country's fleet, or a JSON file; by default the calibration's own, else ``world``.
    detections : boxes from a file instead of the detector; see `formats.detections` for them.
    detector : an ONNX file instead of the shipped one.
    decoder : how to read its outputs, where they do not tell (`detect.output_forms.DECODERS`).
    vehicle_classes : names or numbers of the classes that count, instead of those called small vehicles.
    calibration : file of `orthoscale.calibrate`, whose ruler takes the place of the detector's own.
    zoom, gsd_hint : resampling factor (detector pixels per picture pixel), or the expected metres per pixel, instead of
    the search for it. refine : look at every vehicle four times more, turned and at neighbouring zooms.

    How it is measured
    images : folder of a model's frames, when not beside it. mode : how a model is measured, one of `requests.MODES`;
    by default in every way that there is evidence for.
    projection, estimator : other ways than the usual, see `core.measuring.method.Method`.
    known_distance, ground_control : what is known besides, see `evidence.control`.
    surroundings : whether parking rows and standard objects count.

    How much is looked at, and with what (`detect.find.Effort`)
    target, exhaustive, seed, workers, scheduler, cache.

    `requests.EstimateRequest` has the defaults, and what excludes what. Raises InputError, UsageError (no such
    option, or one that would do nothing), TooLittleEvidence, EvidenceDisagrees.
    """
    return measured(path, EstimateRequest.of(options), progress)


def measured(path: str | Path | Source, request: EstimateRequest, progress: Progress | None = None) -> Result:
    """What `request` asks of the input at `path`; see `estimate`."""
    started = time.perf_counter()
    log.info("measuring %s", path)
    known = None if request.calibration is None else Calibration.load(Path(request.calibration))
    fleet = fleet_of(request.fleet, known)
    from_file = request.detections is not None
    source = open_source(path, request.images, not from_file) if isinstance(path, (str, Path)) else path
    model = None if source.unit == "m/px" else cast("ColmapSource", source)
    if model is None:
        request.for_orthophoto(source.path)
    else:
        request.for_model(source.path)
    given = _given(source, request.known_distance, request.ground_control)
    method = Method(request.projection, request.estimator, tuple(given), request.surroundings)
    choice = None
    if request.detections is not None:
        found = load_detections(Path(request.detections), source, request.vehicle_classes)
    else:
        found, choice = _looked_for(source, model, request, fleet, progress)
    log.info("%d boxes at resampling factor %.3g", len(found), found.zoom)
    if known is not None:
        found = known.applied(found, Path(str(request.calibration)))
    try:
        if model is None:
            answer = measure(source, found, fleet, method)
        else:
            answer = measure_model(model, found, fleet, method, request.mode)
    except TooLittleEvidence as error:
        raise TooLittleEvidence(
            f"{source.path}: {error.message} (looked at zoom {found.zoom:.2f}, {_typical_length(found)})",
            "Try the fleet of the country (--fleet), another zoom (--gsd-hint METRES_PER_PIXEL, --zoom FACTOR), "
            "or a scene with more vehicles.",
        ) from error
    within = None
    if model is None:
        (whole,) = source.pictures
        within = drift(answer.vehicles, whole.width, whole.height)
    seconds = time.perf_counter() - started
    log.info("%.6g %s by %d vehicles in %.1f s", answer.scale.value, source.unit, answer.scale.vehicles_used, seconds)
    return Result(source, fleet, found, choice, seconds, answer, within, method, request.settings())


def _looked_for(
    source: Source,
    model: ColmapSource | None,
    request: EstimateRequest,
    fleet: Fleet,
    progress: Progress | None,
) -> tuple[Detections, ZoomChoice | None]:
    """The vehicles that a detector finds. Raises TooLittleEvidence, EvidenceDisagrees, which name the input."""
    effort = Effort(request.target, request.exhaustive, request.seed, request.workers, request.scheduler, request.cache)
    # Somebody else's network looks at one image at a time, with all cores.
    threads = 0 if request.detector else effort.threads_each
    network = Detector(_path(request.detector), request.decoder, request.vehicle_classes, threads)
    zoom = told_zoom(request.zoom, request.gsd_hint, network.card, float(fleet.mean[0]))
    try:
        if model is None:
            sampling = _sampling(source, fleet)
            found, choice = find_vehicles(source.pictures, network, zoom, progress, effort, sampling)
        else:
            found, choice = find_in_model(model, request.mode, network, zoom, progress, effort)
    except (TooLittleEvidence, EvidenceDisagrees) as error:
        raise type(error)(f"{source.path}: {error.message}", error.hint) from error
    if request.refine:
        workers = worker_count(effort.workers)
        found = replace(found, boxes=refined(source.pictures, found.boxes, found.zoom, network, workers, progress))
    return replace(found, notes=(*found.notes, *network.notes)), choice


def _given(source: Source, known_distance: Sequence[str], ground_control: str | Path | None) -> list[Evidence]:
    """What the user knows of the scale. Raises UsageError, InputError."""
    given = [read_distance(text, source) for text in known_distance]
    if ground_control is not None:
        given.append(read_control(Path(ground_control), source))
    return given


def _path(value: str | Path | None) -> Path | None:
    return None if value is None else Path(value)


def _sampling(source: Source, fleet: Fleet) -> Callable[[Detections], float]:
    """The sampling part of the uncertainty after a part of an orthophoto's sweep. Frames are all looked at: they show
    the same vehicles again, and need each other."""
    one = replace(fleet, candidates=(), prior=())  # which fleet it is matters little here, and trying all takes time

    def sampling(found: Detections) -> float:
        try:
            return measure(source, found, one).scale.parts["sampling"]
        except TooLittleEvidence:
            return np.inf

    return sampling


def _typical_length(found: Detections) -> str:
    boxes = found.boxes or (found.planar.boxes if found.planar is not None else {})
    lengths = [one.length for one in boxes.values() if len(one)]
    if not lengths:
        return "no boxes given" if found.swept is None else "no boxes found"
    return f"vehicles about {np.median(np.concatenate(lengths)):.0f} px long there"
