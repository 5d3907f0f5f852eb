"""The boxes to measure, as a request asks for them: from a file or by a detector."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..core.detections import Detections
from ..core.fleet import Fleet
from ..core.measuring.geometry import Geometry
from ..core.measuring.measure import measure
from ..core.measuring.method import Method
from ..core.measuring.oblique import FramesGeometry
from ..core.measuring.plan import PlanGeometry
from ..core.measuring.planar_sweep import SweepGeometry
from ..core.progress import Progress
from ..core.source import Source
from ..detect.detector import Detector, Passes
from ..detect.effort import Effort
from ..detect.refine import refined
from ..detect.zoom import user_zoom
from ..errors import EvidenceDisagrees, TooLittleEvidence
from ..formats.detections import load as load_detections
from ..requests import EstimateRequest
from .find import Sampling, VehicleSearch, find_in, measured_anew
from .opening import Opened

log = logging.getLogger(__name__)


def boxes_of(asked: Opened, request: EstimateRequest, progress: Progress | None) -> Detections:
    """The boxes to measure, from a file or by a detector, with the ruler that belongs to them.

    Raises InputError, UsageError, TooLittleEvidence, EvidenceDisagrees.
    """
    if request.detections is not None:
        found = load_detections(Path(request.detections), asked.source, request.vehicle_classes, request.alone)
    else:
        found = _looked_for(asked, request, progress)
    found = measured_anew(asked.source, found, request, effort_of(request), progress)
    found = found.made_on(asked.source)
    log.info("%d boxes at resampling factor %.3g", len(found), found.zoom)
    if asked.calibration is not None:
        found = asked.calibration.applied(found)
    if asked.source.plan is not None:  # the views of a model calibrate the ruler
        found = replace(found, notes=(*found.notes, *found.assumed))
    return found


def _looked_for(asked: Opened, request: EstimateRequest, progress: Progress | None) -> Detections:
    """The vehicles found by a detector. Raises InputError, UsageError, TooLittleEvidence, EvidenceDisagrees; the last
    two name the input."""
    source, fleet = asked.source, asked.fleet
    effort, network = effort_of(request), detector_of(asked, request)
    zoom = user_zoom(request.zoom, request.gsd_hint, network.card, float(fleet.mean[0]))
    try:
        search = VehicleSearch(network, zoom, effort, _sampling(source, fleet), progress)
        found = find_in(source, request.wanted_mode, search)
    except (TooLittleEvidence, EvidenceDisagrees) as error:
        raise type(error)(f"{source.path}: {error.message}", error.hint) from error
    if request.refine:
        boxes = refined(source.pictures, found.boxes, found.zoom, found.ruler.noise, network, effort.threads, progress)
        found = replace(found, boxes=boxes)
    return replace(found, notes=(*found.notes, *network.notes))


def _sampling(source: Source, fleet: Fleet) -> Sampling:
    """Functions that give the sampling part of the uncertainty after a part of the sweep of `source`."""
    one = replace(fleet, candidates=(), prior=())  # which fleet it is matters little here, and trying all takes time

    def by(geometry: Callable[[Detections], Geometry]) -> Callable[[Detections], float]:
        def sampling(found: Detections) -> float:
            try:
                scale = measure(geometry(found), one).scale
            except TooLittleEvidence:
                return np.inf
            return scale.parts["sampling"] if scale.vehicles_used else np.inf

        return sampling

    if source.plan is not None:
        return Sampling(by(lambda found: PlanGeometry.of(source, found)))
    in_frames = by(lambda found: FramesGeometry.of(source, found, one, Method()))
    return Sampling(in_frames, by(lambda found: SweepGeometry.of(source, found)))


def effort_of(request: EstimateRequest) -> Effort:
    """The effort that `request` sets."""
    return Effort(request.target, request.exhaustive, request.seed, request.workers, request.scheduler, request.cache)


def detector_of(asked: Opened, request: EstimateRequest) -> Detector:
    """The detector that `request` asks for, for its source. Raises InputError; UsageError, also if the calibration is
    another detector's, before any sweep: without vehicles there would be no boxes to compare it with."""
    path = None if request.detector is None else Path(request.detector)
    # A user's own network processes one image at a time, with all cores.
    threads = effort_of(request).threads_each if path is None else 0
    detector = Detector(path, request.decoder, request.vehicle_classes, threads, _passes(asked.source, request))
    if asked.calibration is not None:
        asked.calibration.require_of(detector.name, detector.sha256)
    return detector


def _passes(source: Source, request: EstimateRequest) -> Passes:
    """Which detection passes are made over the pictures of `source`."""
    if source.plan is None:
        return Passes.COARSE_FIRST
    if request.confirms:
        return Passes.CONFIRMED
    return Passes.FINE_FIRST if request.fast or request.detector is not None else Passes.TWICE_CONFIRMED
