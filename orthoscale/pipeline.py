"""The way the data goes: source, tiles, boxes, projection, pooling, Scale, written copy, report."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from .atomic import check_free, new_file, new_folder
from .boxes import Boxes, matched
from .detections import Detections
from .errors import EvidenceDisagrees, InputError, TooLittleEvidence, UsageError
from .fleet import Fleet
from .pooling import MIN_VEHICLES, Scale, pool
from .projection.exact import Hull
from .projection.exact import ground_size as exact_size
from .projection.height import fit_height, lean
from .projection.planar import ground_size as planar_size
from .projection.view import Views
from .votes import Votes, gather

if TYPE_CHECKING:
    from .detect.zoom import ZoomChoice
    from .sources.colmap import ColmapSource
    from .sources.picture import Picture
    from .sources.source import Source

Progress = Callable[[str, int, int], None]  # what, done, total
# Boxes that were measured, the picture of each (M,), the votes, the scale, and boxes lost on the way by reason.
Measured = tuple[Boxes, np.ndarray, Votes, Scale, dict[str, int]]

CONFIRMING_ZOOM = 1 / np.sqrt(
    2
)  # the second look, half an octave coarser: half the pixels, another view of each mistake
SAME_BOX = 0.5  # overlap at which two looks show the same vehicle
ROUNDS = 6  # of exact projection and pooling; the scale enters its own projection only through the vehicles' height
SETTLED = 1e-4  # relative change of the scale at which the rounds end
# Relative uncertainty of a reconstruction's ground under the vehicles (one sigma), as a share of the camera's height:
# sparse points on bare ground scatter by about this much on the two real scenes.
GROUND_SD = 0.01
GDAL_SIDECARS = (".aux.xml", ".ovr", ".msk")
# How far a detector's effective height strays from its card between scenes (one sigma) [m], and its upper bound.
HEIGHT_SD = 0.25
MAX_HEIGHT = 1.5
CONFLICT = 4.0  # sigmas between lengths and widths from which nothing is written without being told to
NO_GROUND = "no ground under the box, or seen too flatly"
NO_HULL = "no vehicle on the ground gives this box"


@dataclass(frozen=True)
class Result:
    """What was found in one source, and the scale that follows."""

    source: Source
    fleet: Fleet
    detections: Detections
    boxes: Boxes  # all that entered the projection, of all pictures
    picture: np.ndarray = field(repr=False)  # (M,) name of each box's picture
    votes: Votes = field(repr=False)
    scale: Scale = field(repr=True)
    zoom_choice: ZoomChoice | None
    rejected_boxes: dict[str, int]  # boxes that never became votes, by reason
    seconds: float


def open_source(path: Path, images: Path | None = None, need_images: bool = True) -> Source:
    """The source at `path`: a folder is a COLMAP model, a file an image. Raises InputError."""
    if not path.exists():
        raise InputError(f"{path} does not exist", "Give an orthophoto, or the folder of a COLMAP model.")
    if path.is_dir():
        from .sources.colmap import ColmapSource

        return ColmapSource.open(path, images=images, need_images=need_images)
    if images is not None:
        raise UsageError("--images is for COLMAP models", f"{path} is a file: leave --images away.")
    from .sources.raster import RasterSource

    return RasterSource.open(path)


def find_vehicles(
    pictures: Sequence[Picture],
    detector_file: Path | None = None,
    zoom: float | None = None,
    progress: Progress | None = None,
) -> tuple[Detections, ZoomChoice | None]:
    """Sweep `pictures` at the right zoom (searched for unless given), twice; a vehicle must show in both looks."""
    from .detect.detector import Detector
    from .detect.tiles import sweep
    from .detect.zoom import search_zoom

    def step(what: str) -> Callable[[int, int], None] | None:
        return (lambda done, total: progress(what, done, total)) if progress else None

    detector = Detector(detector_file)
    choice = None
    if zoom is None:
        choice = search_zoom(pictures, detector, detector.card, step("Looking for the right zoom"))
        zoom = choice.zoom
        if choice.vehicle_px is None:
            raise TooLittleEvidence(
                f"no vehicles found at any zoom from {choice.table[0][0]:.2g} to {choice.table[-1][0]:.2g} "
                f"({sum(row[1] for row in choice.table)} doubtful boxes, {sum(row[2] for row in choice.table)} of them "
                "seen at two zooms)",
                "If there are vehicles, say how large: --gsd-hint METRES_PER_PIXEL or --zoom FACTOR.",
            )
    fine = sweep(pictures, zoom, detector, step("Finding vehicles"))
    coarse = sweep(pictures, zoom * CONFIRMING_ZOOM, detector, step("Looking twice"))
    boxes, doubtful = {}, {}
    for name, found in fine.items():
        i, j, _ = matched(found, coarse[name], SAME_BOX)
        xylwa = found.xylwa[i].copy()
        xylwa[:, 2:4] = np.sqrt(xylwa[:, 2:4] * coarse[name].xylwa[j, 2:4])
        boxes[name] = Boxes(xylwa, (found.score[i] + coarse[name].score[j]) / 2)
        alone = np.ones(len(found), bool)
        alone[i] = False
        doubtful[name] = found[alone]
    card = detector.card
    return Detections(boxes, zoom, card.ruler, card.effective_height, card.name, detector.sha256, doubtful), choice


def estimate(
    path: str | Path | Source,
    *,
    fleet: str | Path = "world",
    images: str | Path | None = None,
    detections: str | Path | None = None,
    detector: str | Path | None = None,
    zoom: float | None = None,
    gsd_hint: float | None = None,
    progress: Progress | None = None,
) -> Result:
    """Find the scale of an orthophoto (metres per pixel) or a COLMAP model (metres per model unit).

    fleet : code of the country's fleet, or a JSON file. images : folder of a model's frames, when not beside it.
    detections : boxes from a file instead of the detector. detector : an ONNX file instead of the shipped one.
    zoom, gsd_hint : detector pixels per picture pixel, or the expected metres per pixel, instead of the zoom search.
    `path` may be a source that `open_source` opened. Raises InputError, UsageError, TooLittleEvidence.
    """
    started = time.perf_counter()
    if zoom is not None and gsd_hint is not None:
        raise UsageError("--zoom and --gsd-hint say the same thing twice", "Give one of them.")
    for name, value in (("--zoom", zoom), ("--gsd-hint", gsd_hint)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise UsageError(f"{name} must be a positive number, not {value}")
    ruler_fleet = Fleet.load(fleet)
    if isinstance(path, (str, Path)):
        source = open_source(Path(path), _path(images), need_images=detections is None)
    else:
        source = path
    choice = None
    if detections is not None:
        found = Detections.load(Path(detections))
        _check_names(found, source, Path(detections))
    else:
        detector_file = _path(detector)
        if gsd_hint is not None:
            zoom = _zoom_for(gsd_hint, ruler_fleet, detector_file)
        try:
            found, choice = find_vehicles(source.pictures, detector_file, zoom, progress)
        except TooLittleEvidence as error:
            raise TooLittleEvidence(f"{source.path}: {error.message}", error.hint) from error
    try:
        boxes, picture, votes, scale, lost = measure(source, found, ruler_fleet)
    except TooLittleEvidence as error:
        raise TooLittleEvidence(
            f"{source.path}: {error.message} (looked at zoom {found.zoom:.2f}, vehicles about "
            f"{_typical_length(found):.0f} px long there)",
            "Try the fleet of the country (--fleet), another zoom (--gsd-hint METRES_PER_PIXEL, --zoom FACTOR), "
            "or a scene with more vehicles.",
        ) from error
    rejected = {reason: count for reason, count in lost.items() if count}
    seconds = time.perf_counter() - started
    return Result(source, ruler_fleet, found, boxes, picture, votes, scale, choice, rejected, seconds)


def measure(source: Source, found: Detections, fleet: Fleet) -> Measured:
    """From boxes to the scale: projection onto the ground, one vote per vehicle, pooling."""
    if source.unit == "m/px":
        return _measure_planar(source, found, fleet)
    return _measure_model(cast("ColmapSource", source), found, fleet)


def _measure_planar(source: Source, found: Detections, fleet: Fleet) -> Measured:
    (name,) = source.picture_names
    boxes = found.boxes.get(name, Boxes.empty())
    size = planar_size(boxes)
    votes = gather(size, np.full(len(boxes), 1 / found.zoom), boxes.centre, boxes.score, repeated=False)
    scale = pool(votes, fleet, found.ruler, source.unit)
    return boxes, np.full(len(boxes), name), votes, scale, _lost(found)


def _measure_model(source: ColmapSource, found: Detections, fleet: Fleet) -> Measured:
    parts, names, views, places = [], [], [], []
    lost = _lost(found)
    for name, boxes in found.boxes.items():
        if not len(boxes):
            continue
        view, place, ok = source.views(name, boxes.centre)
        parts.append(boxes[ok])
        names += [name] * int(ok.sum())
        views.append(view[ok])
        places.append(place[ok])
        lost[NO_GROUND] = lost.get(NO_GROUND, 0) + int((~ok).sum())
    if len(names) < MIN_VEHICLES:
        raise TooLittleEvidence(f"{len(names)} boxes on the ground, {MIN_VEHICLES} vehicles are needed")
    boxes, picture, place = Boxes.concatenate(parts), np.array(names), np.concatenate(places)
    view = Views.concatenate(views)
    pixel = view.unit_per_pixel / found.zoom
    leaning = lean(boxes, view)
    # The height's share of a box is a small correction, so a few rounds of measuring and pooling settle the scale.
    metres_per_unit = float(fleet.mean[0] / np.median(boxes.length * view.unit_per_pixel))
    height, height_sd = np.array(found.effective_height), np.full(2, HEIGHT_SD)
    for _ in range(ROUNDS):
        size = np.stack(
            [exact_size(boxes, view, metres_per_unit, Hull(height=h))[:, k] for k, h in enumerate(height)], 1
        )
        solved = np.isfinite(size).all(1)
        votes = gather(size[solved], pixel[solved], place[solved], boxes.score[solved], repeated=True)
        scale = pool(
            votes,
            fleet,
            found.ruler,
            source.unit,
            _geometry(size[solved], leaning[solved], height_sd / metres_per_unit),
        )
        change = abs(np.log(scale.value / metres_per_unit))
        metres_per_unit = scale.value
        if change < SETTLED:
            break
        counted = [members for members, used in zip(votes.members, scale.used, strict=True) if used]
        flat = size[solved] + leaning[solved] * height / metres_per_unit
        height, height_sd = _calibrated_height(found, flat, leaning[solved], counted, metres_per_unit)
    lost[NO_HULL] = int((~solved).sum())
    return boxes[solved], picture[solved], votes, scale, lost


def _calibrated_height(
    found: Detections, flat_size: np.ndarray, leaning: np.ndarray, members: list[np.ndarray], metres_per_unit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Effective heights for length and width [m] and their one sigma: the detector's, and what the views say."""
    seen, seen_sd = (v * metres_per_unit for v in fit_height(flat_size, leaning, members))
    weight, prior_weight = 1 / seen_sd**2, 1 / HEIGHT_SD**2
    height = (weight * seen + prior_weight * np.array(found.effective_height)) / (weight + prior_weight)
    return np.clip(height, 0.0, MAX_HEIGHT), 1 / np.sqrt(weight + prior_weight)


def _geometry(size: np.ndarray, leaning: np.ndarray, height_sd: np.ndarray) -> np.ndarray:
    """(2, 2) relative covariance of length and width from the ground's height (shared) and the effective height."""
    if not len(size):
        return np.zeros((2, 2))
    share = np.median(leaning * height_sd / size, axis=0)
    return np.diag(share**2) + GROUND_SD**2


def fix(
    path: str | Path,
    out: str | Path,
    *,
    overwrite: bool = False,
    override: bool = False,
    force: bool = False,
    **options: Any,
) -> Result:
    """Estimate the scale of `path` (see `estimate` for `options`) and write a copy of it in metres at `out`.

    An orthophoto becomes the GeoTIFF `out` with `out`.json and `out`.png beside it; a model the folder `out` with
    sim3.txt, report.json and vehicles.png in it. All of them appear, or none.

    overwrite : replace what is at `out`. override : rescale although the input's own georeferencing gives a scale.
    force : write although the evidence is too uncertain to be useful (verdict ``refuse``) or contradicts itself.
    Raises what `estimate` raises, EvidenceDisagrees, OutputError.
    """
    path, out = Path(path), Path(out)
    check_free(out, overwrite)
    if out.resolve() == path.resolve():
        raise UsageError(f"{out} is the input itself", "The input is never touched: choose another --out.")
    source = open_source(path, _path(options.get("images")), need_images=options.get("detections") is None)
    if source.metric_already and not override:  # not behind its owner's back
        raise UsageError(
            f"{path} is in metres already: {source.metric_already}",
            "Compare that with the vehicles by `orthoscale estimate`, or replace its scale with --override.",
        )
    result = estimate(source, **options)
    if result.scale.verdict == "refuse" and not force:
        low, high = result.scale.interval90
        raise TooLittleEvidence(
            f"{path}: the scale is only known to lie between {low:.4g} and {high:.4g} {result.scale.unit}",
            "Name the country's fleet (--fleet), give a scene with more vehicles, or write all the same with --force.",
        )
    if result.scale.tension > CONFLICT and not force:
        raise EvidenceDisagrees(
            f"{path}: {result.scale.remarks[0]}",
            "Look at the boxes (--save-detections), name the country's fleet, or write all the same with --force.",
        )
    from .report.document import document, write_json
    from .report.pictures import draw

    with ExitStack() as outputs:  # renamed into place in reverse order, the main output last
        if source.unit == "m/px":
            main = outputs.enter_context(new_file(out, overwrite))
            picture = outputs.enter_context(new_file(_beside(out, ".png"), overwrite))
            report = outputs.enter_context(new_file(_beside(out, ".json"), overwrite))
        else:
            main = outputs.enter_context(new_folder(out, overwrite))
            picture, report = main / "vehicles.png", main / "report.json"
        source.write(main, result.scale.value)
        draw(result, picture)
        write_json(document(result), report)
        if overwrite:
            for suffix in GDAL_SIDECARS:  # those of the file that is replaced would speak for the new one
                _beside(out, suffix).unlink(missing_ok=True)
    return result


def _beside(out: Path, suffix: str) -> Path:
    return out.with_name(out.name + suffix)


def _path(value: str | Path | None) -> Path | None:
    return None if value is None else Path(value)


def _lost(found: Detections) -> dict[str, int]:
    return {found.doubt: sum(map(len, found.doubtful.values()))}


def _check_names(found: Detections, source: Source, path: Path) -> None:
    known = source.picture_names
    strangers = [name for name in found.boxes if name not in set(known)]
    if strangers:
        raise InputError(
            f"{path}: {len(strangers)} of its {len(found.boxes)} pictures are not in {source.path}, "
            f"the first is {strangers[0]!r}",
            f"The source has pictures like {known[0]!r}: give the detections that were made on it.",
        )


def _typical_length(found: Detections) -> float:
    lengths = [boxes.length for boxes in found.boxes.values() if len(boxes)]
    return float(np.median(np.concatenate(lengths))) if lengths else 0.0


def _zoom_for(gsd: float, fleet: Fleet, detector_file: Path | None) -> float:
    from .detect.detector import Detector

    return Detector(detector_file).card.best_length * gsd / float(fleet.mean[0])
