"""The way the data goes: source, tiles, boxes, projection, pooling, Scale, written copy, report."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from .atomic import check_free, new_file, new_folder
from .boxes import Boxes
from .calibration import Calibration
from .control import read_control, read_distance
from .detect.detector import Detector
from .detect.find import Effort, Progress, find_vehicles
from .detect.refine import refined
from .detect.workers import worker_count
from .detect.zoom import check_zoom
from .detections import Detections
from .drift import Drift, drift
from .errors import EvidenceDisagrees, InputError, TooLittleEvidence, UsageError
from .exchange import load as load_detections
from .fleet import Fleet
from .looks import find_in_model, measure_model
from .measuring import Measured, measure
from .method import Method
from .pooling import Scale
from .votes import Votes

if TYPE_CHECKING:
    from .detect.zoom import ZoomChoice
    from .sources.colmap import ColmapSource
    from .sources.raster import RasterSource
    from .sources.source import Source

GDAL_SIDECARS = (".aux.xml", ".ovr", ".msk")
REPORTS = {"none": (), "json": ("json", "png"), "html": ("json", "png", "html")}  # parts of a report, by its level
CONFLICT = 4.0  # sigmas between lengths and widths from which nothing is written without being told to


@dataclass(frozen=True)
class Result:
    """What was found in one source, and the scale that follows."""

    source: Source
    fleet: Fleet
    detections: Detections
    zoom_choice: ZoomChoice | None
    seconds: float
    measured: Measured = field(repr=False)
    drift: Drift | None = None  # of the scale within an orthophoto
    method: Method = field(default_factory=Method)
    settings: dict[str, Any] = field(default_factory=dict)  # options of `estimate` as plain values, to do it again

    @property
    def projection(self) -> str:
        """The projection that was used: the one asked for, or what fits the source."""
        return self.method.projection or ("planar" if self.source.unit == "m/px" else "exact")

    @property
    def scale(self) -> Scale:
        return self.measured.scale

    @property
    def votes(self) -> Votes:
        return self.measured.votes

    @property
    def boxes(self) -> Boxes:
        """All boxes that entered the projection, of all pictures."""
        return self.measured.boxes

    @property
    def picture(self) -> np.ndarray:
        """(M,) name of each box's picture."""
        return self.measured.picture

    @property
    def rejected_boxes(self) -> dict[str, int]:
        """Boxes that never became votes, by reason."""
        return {reason: count for reason, count in self.measured.lost.items() if count}

    def require_useful(self) -> None:
        """Raise TooLittleEvidence for a scale too uncertain to be written, EvidenceDisagrees for a contradiction."""
        if self.scale.conflict or self.scale.tension > CONFLICT:
            raise EvidenceDisagrees(
                f"{self.source.path}: {self.scale.remarks[0]}",
                "Look at the boxes (--save-detections), check what was given, name the country's fleet, or write all "
                "the same with --force.",
            )
        agreement = self.measured.agreement
        if agreement is not None and agreement.contradicts:
            raise EvidenceDisagrees(
                f"{self.source.path}: {agreement.sentence()}",
                "Look at the boxes (--save-detections) and the poses, choose one way with --mode, or write all the "
                "same with --force.",
            )
        if self.scale.verdict == "refuse":
            low, high = self.scale.interval90
            raise TooLittleEvidence(
                f"{self.source.path}: the scale is only known to lie between {low:.4g} and {high:.4g} "
                f"{self.scale.unit}",
                "Name the country's fleet (--fleet), give a scene with more vehicles, or write all the same with "
                "--force.",
            )


def open_source(path: Path, images: Path | None = None, need_images: bool = True) -> Source:
    """The source at `path`: a folder is a COLMAP model, a file an image. Raises InputError."""
    if not path.exists():
        raise InputError(f"{path} does not exist", "Give an orthophoto, or the folder of a COLMAP model.")
    from .sources.exchange import ExchangeSource, find_exchange

    if (text := find_exchange(path)) is not None:
        return ExchangeSource.open(text, images=images, need_images=need_images)
    if path.is_dir():
        from .sources.colmap import ColmapSource

        return ColmapSource.open(path, images=images, need_images=need_images)
    if images is not None:
        raise UsageError("--images is for COLMAP models", f"{path} is a file: leave --images away.")
    from .sources.raster import RasterSource

    return RasterSource.open(path)


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
    if zoom is not None and gsd_hint is not None:
        raise UsageError("--zoom and --gsd-hint say the same thing twice", "Give one of them.")
    for name, value in (("--zoom", zoom), ("--gsd-hint", gsd_hint)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise UsageError(f"{name} must be a positive number, not {value}")
    if refine and detections is not None:
        raise UsageError("--refine looks again, --detections does not look at all", "Leave one of them away.")
    known = None if calibration is None else Calibration.load(Path(calibration))
    ruler_fleet = Fleet.load(fleet or "world")
    if known is not None and known.fleet is not None and fleet is None:
        ruler_fleet = known.fleet
    if isinstance(path, (str, Path)):
        source = open_source(Path(path), _path(images), need_images=detections is None)
    else:
        source = path
    given = [read_distance(text, source) for text in known_distance]
    if ground_control is not None:
        given.append(read_control(Path(ground_control), source))
    method = Method(projection, estimator, tuple(given), surroundings)
    model = None if source.unit == "m/px" else cast("ColmapSource", source)
    if model is None and mode is not None:
        raise UsageError("--mode is for COLMAP models", f"{source.path} is an image: leave --mode away.")
    if model is None:
        method.for_picture()
    choice = None
    if detections is not None:
        found = load_detections(Path(detections), source, vehicle_classes)
    else:
        how_much = Effort(**effort)
        network = Detector(_path(detector), decoder, vehicle_classes, how_much.threads_each)
        if gsd_hint is not None:
            zoom = network.card.best_length * gsd_hint / float(ruler_fleet.mean[0])
        if zoom is not None:
            check_zoom(zoom, network.card)
        try:
            if model is None:
                found, choice = find_vehicles(
                    source.pictures, network, zoom, progress, how_much, _sampling(source, ruler_fleet)
                )
            else:
                found, choice = find_in_model(model, mode, network, zoom, progress, how_much)
        except TooLittleEvidence as error:
            raise TooLittleEvidence(f"{source.path}: {error.message}", error.hint) from error
        if refine:
            sharper = refined(
                source.pictures, found.boxes, found.zoom, network, worker_count(how_much.workers), progress
            )
            found = replace(found, boxes=sharper)
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


def fix(
    path: str | Path,
    out: str | Path,
    *,
    overwrite: bool = False,
    override: bool = False,
    force: bool = False,
    dense: bool = False,
    keep_origin: bool = False,
    cog: bool = False,
    also: Sequence[str] = (),
    report: str = "html",
    **options: Any,
) -> Result:
    """Estimate the scale of `path` (see `estimate` for `options`) and write a copy of it in metres at `out`.

    An orthophoto becomes the GeoTIFF `out` with `out`.json, `out`.png and `out`.html beside it; a model the folder
    `out` with sim3.txt, report.json, vehicles.png and report.html in it. All of them appear, or none.

    overwrite : replace what is at `out`. override : rescale although the input's own georeferencing gives a scale.
    keep_origin : an orthophoto keeps its coordinate reference system, first corner and direction; else local metres.
    cog : write a cloud-optimised GeoTIFF. also : more files for other programs, of `orthoscale.report.extras.EXTRAS`.
    force : write although the evidence is too uncertain to be useful (verdict ``refuse``) or contradicts itself.
    dense : write the model's dense workspace in metres too, as ``dense/``: depth maps, cloud, meshes.
    report : ``html``, ``json`` (without the page) or ``none``.
    Raises what `estimate` raises, EvidenceDisagrees, OutputError.
    """
    path, out = Path(path), Path(out)
    if report not in REPORTS:
        raise UsageError(f"--report {report} is none of {', '.join(REPORTS)}")
    check_free(out, overwrite)
    if out.resolve() == path.resolve():
        raise UsageError(f"{out} is the input itself", "The input is never touched: choose another --out.")
    source = open_source(path, _path(options.get("images")), need_images=options.get("detections") is None)
    from .report.extras import chosen

    extras = [(extra.place(out), extra.write) for extra in chosen(also)]
    parts = report_paths(out, source.unit, report)
    if source.unit == "m/px":
        for beside in (*parts.values(), *(place for place, _ in extras)):
            check_free(beside, overwrite)
    elif keep_origin or cog or also:
        raise UsageError("--keep-origin, --cog and --also are for orthophotos", f"{path} is a model.")
    if source.metric_already and not override:  # not behind its owner's back
        raise UsageError(
            f"{path} is in metres already: {source.metric_already}",
            "Compare that with the vehicles by `orthoscale estimate`, or replace its scale with --override.",
        )
    if dense:
        _check_dense(source)
    result = estimate(source, **options)
    if not force:
        result.require_useful()
    from .report.files import write_report

    with ExitStack() as outputs:  # renamed into place in reverse order, the main output last
        if source.unit == "m/px":
            main = outputs.enter_context(new_file(out, overwrite))
            parts = {kind: outputs.enter_context(new_file(place, overwrite)) for kind, place in parts.items()}
            raster = cast("RasterSource", source)
            raster.write(main, result.scale.value, keep_origin, cog)
            for place, write in extras:
                partial = outputs.enter_context(new_file(place, overwrite))
                write(result, raster.place(result.scale.value, keep_origin), partial)
        else:
            main = outputs.enter_context(new_folder(out, overwrite))
            parts = {kind: main / place.name for kind, place in parts.items()}
            source.write(main, result.scale.value)
            if dense:
                (main / "dense").mkdir()
                cast("ColmapSource", source).write_dense(main / "dense", result.scale.value)
        write_report(result, parts)
        if overwrite and main.is_file():  # what lies beside the file that is replaced would speak for the new one
            stale = [f".{kind}" for kind in REPORTS["html"] if kind not in parts]
            for suffix in (*GDAL_SIDECARS, *stale):
                _beside(out, suffix).unlink(missing_ok=True)
            if "tfw" not in also:
                out.with_suffix(".tfw").unlink(missing_ok=True)
    return result


def _check_dense(source: Source) -> None:
    """Refuse early what `fix` could not write in the end."""
    if source.unit == "m/px":
        raise UsageError("--dense is for COLMAP models", f"{source.path} is an image: leave --dense away.")
    cast("ColmapSource", source).dense  # noqa: B018  raises where there is none


def report_paths(out: Path, unit: str, report: str) -> dict[str, Path]:
    """Where `fix` writes the parts of a report: beside the scaled orthophoto `out`, or into the folder `out`."""
    if unit == "m/px":
        return {kind: _beside(out, f".{kind}") for kind in REPORTS[report]}
    return {kind: out / ("vehicles.png" if kind == "png" else f"report.{kind}") for kind in REPORTS[report]}


def _plain(arguments: dict[str, Any]) -> dict[str, Any]:
    """Options that say something, as values that JSON knows."""
    given = {**arguments, **arguments.get("effort", {})}
    return {
        name: value if isinstance(value, (bool, int, float, list, tuple)) else str(value)
        for name, value in given.items()
        if name not in ("path", "progress", "effort") and value is not None
    }


def _beside(out: Path, suffix: str) -> Path:
    return out.with_name(out.name + suffix)


def _path(value: str | Path | None) -> Path | None:
    return None if value is None else Path(value)


def _sampling(source: Source, fleet: Fleet) -> Callable[[Detections], float] | None:
    """The sampling part of the uncertainty after a part of a sweep.

    An orthophoto's tiles show different vehicles; frames show the same ones again, and need each other.
    """
    if source.unit != "m/px":
        return None

    def sampling(found: Detections) -> float:
        try:
            return measure(source, found, fleet).scale.parts["sampling"]
        except TooLittleEvidence:
            return np.inf

    return sampling


def _typical_length(found: Detections) -> float:
    lengths = [boxes.length for boxes in found.boxes.values() if len(boxes)]
    return float(np.median(np.concatenate(lengths))) if lengths else 0.0
