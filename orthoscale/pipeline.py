"""The way the data goes: source, tiles, boxes, projection, pooling, Scale, written copy, report."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from .calibration import Calibration, fleet_of
from .detect.detector import Detector
from .detect.find import Effort, Progress, find_vehicles
from .detect.refine import refined
from .detect.workers import worker_count
from .detect.zoom import check_told, told_zoom
from .detections import Detections
from .errors import EvidenceDisagrees, TooLittleEvidence, UsageError
from .evidence.control import read_control, read_distance
from .exchange import load as load_detections
from .fleet import Fleet
from .measuring.drift import drift
from .measuring.looks import find_in_model, measure_model
from .measuring.measure import measure
from .measuring.method import Method
from .pooling.evidence import Evidence
from .result import Result
from .sources.opening import open_source

if TYPE_CHECKING:
    from .sources.colmap import ColmapSource
    from .sources.source import Source


def estimate(
    path: str | Path | Source,
    *,
    fleet: str | Path | None = None,
    images: str | Path | None = None,
    detections: str | Path | None = None,
    detector: str | Path | None = None,
    decoder: str | None = None,
    vehicle_classes: Sequence[str] = (),
    calibration: str | Path | None = None,
    zoom: float | None = None,
    gsd_hint: float | None = None,
    projection: str | None = None,
    estimator: str = "robust",
    known_distance: Sequence[str] = (),
    ground_control: str | Path | None = None,
    surroundings: bool = True,
    refine: bool = False,
    progress: Progress | None = None,
    mode: str | None = None,
    **effort: Any,
) -> Result:
    """Find the scale of an orthophoto (metres per pixel) or a COLMAP model (metres per model unit).

    fleet : code of the country's fleet, or a JSON file; by default the calibration's own, else ``world``.
    images : folder of a model's frames, when not beside it.
    detections : boxes from a file instead of the detector; see `exchange` for the formats.
    detector : an ONNX file instead of the shipped one.
    decoder : how to read its outputs, where they do not tell (`detect.layout.DECODERS`). vehicle_classes : names or
    numbers of the classes that count, instead of those called small vehicles.
    calibration : file of `orthoscale.calibrating.calibrate`, whose ruler takes the place of the detector's own.
    zoom, gsd_hint : detector pixels per picture pixel, or the expected metres per pixel, instead of the zoom search.
    projection, estimator : other ways than the usual, see `Method`. known_distance, ground_control : what is known
    besides, see `control`. surroundings : whether parking rows and standard objects count.
    refine : look at every vehicle four times more, turned and at neighbouring zooms (`detect.refine`).
    mode : how a model is measured, one of `looks.MODES`; by default in every way that there is evidence for.
    effort : how much to look at, and with what; see `orthoscale.detect.find.Effort` (target, exhaustive, seed, workers,
    scheduler, cache). `path` may be a source that `open_source` opened.
    Raises InputError, UsageError, TooLittleEvidence.
    """
    settings = _plain(locals())
    started = time.perf_counter()
    check_told(zoom, gsd_hint)
    if refine and detections is not None:
        raise UsageError("--refine looks again, --detections does not look at all", "Leave one of them away.")
    known = None if calibration is None else Calibration.load(Path(calibration))
    ruler_fleet = fleet_of(fleet, known)
    source = open_source(path, images, detections is None) if isinstance(path, (str, Path)) else path
    model = None if source.unit == "m/px" else cast("ColmapSource", source)
    method = Method(projection, estimator, tuple(_given(source, known_distance, ground_control)), surroundings)
    if model is None:
        method.for_picture()
        if mode is not None:
            raise UsageError("--mode is for COLMAP models", f"{source.path} is an image: leave --mode away.")
    choice = None
    if detections is not None:
        found = load_detections(Path(detections), source, vehicle_classes)
    else:
        how_much = Effort(**effort)
        # Somebody else's network looks at one image at a time, with all cores.
        network = Detector(_path(detector), decoder, vehicle_classes, 0 if detector else how_much.threads_each)
        zoom = told_zoom(zoom, gsd_hint, network.card, float(ruler_fleet.mean[0]))
        try:
            if model is None:
                sampling = _sampling(source, ruler_fleet)
                found, choice = find_vehicles(source.pictures, network, zoom, progress, how_much, sampling)
            else:
                found, choice = find_in_model(model, mode, network, zoom, progress, how_much)
        except (TooLittleEvidence, EvidenceDisagrees) as error:
            raise type(error)(f"{source.path}: {error.message}", error.hint) from error
        if refine:
            workers = worker_count(how_much.workers)
            found = replace(found, boxes=refined(source.pictures, found.boxes, found.zoom, network, workers, progress))
        source.notes.extend(network.notes)
    if known is not None:
        found = known.applied(found, Path(str(calibration)))
    try:
        if model is None:
            measured = measure(source, found, ruler_fleet, method)
        else:
            measured = measure_model(model, found, ruler_fleet, method, mode)
    except TooLittleEvidence as error:
        raise TooLittleEvidence(
            f"{source.path}: {error.message} (looked at zoom {found.zoom:.2f}, vehicles about "
            f"{_typical_length(found):.0f} px long there)",
            "Try the fleet of the country (--fleet), another zoom (--gsd-hint METRES_PER_PIXEL, --zoom FACTOR), "
            "or a scene with more vehicles.",
        ) from error
    within = None
    if model is None:
        (whole,) = source.pictures
        within = drift(measured.votes, measured.scale, found.ruler, whole.width, whole.height)
    seconds = time.perf_counter() - started
    return Result(source, ruler_fleet, found, choice, seconds, measured, within, method, settings)


def _given(source: Source, known_distance: Sequence[str], ground_control: str | Path | None) -> list[Evidence]:
    """What the user knows of the scale. Raises UsageError, InputError."""
    given = [read_distance(text, source) for text in known_distance]
    if ground_control is not None:
        given.append(read_control(Path(ground_control), source))
    return given


def _plain(arguments: dict[str, Any]) -> dict[str, Any]:
    """Options that say something, as values that JSON knows."""
    given = {**arguments, **arguments.get("effort", {})}
    return {
        name: value if isinstance(value, (bool, int, float, list, tuple)) else str(value)
        for name, value in given.items()
        if name not in ("path", "progress", "effort") and value is not None
    }


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


def _typical_length(found: Detections) -> float:
    lengths = [boxes.length for boxes in found.boxes.values() if len(boxes)]
    return float(np.median(np.concatenate(lengths))) if lengths else 0.0
