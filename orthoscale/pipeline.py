"""The way the data goes: source, tiles, boxes, projection, pooling, Scale, written copy, report."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from .atomic import check_free, new_file, new_folder
from .boxes import Boxes
from .detect.find import Progress, find_vehicles
from .detections import Detections
from .errors import EvidenceDisagrees, InputError, TooLittleEvidence, UsageError
from .fleet import Fleet
from .looks import find_in_model, measure_model
from .measuring import Measured, measure
from .pooling import Scale
from .votes import Votes

if TYPE_CHECKING:
    from .detect.zoom import ZoomChoice
    from .sources.colmap import ColmapSource
    from .sources.picture import Picture
    from .sources.source import Source

GDAL_SIDECARS = (".aux.xml", ".ovr", ".msk")
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

    @property
    def pictures(self) -> Sequence[Picture]:
        """The pictures that the boxes lie in, as far as they are at hand."""
        if set(self.picture) <= set(self.source.picture_names):
            return self.source.pictures
        return [p for p in cast("ColmapSource", self.source).ground_pictures if p.frame is not None]

    def require_useful(self) -> None:
        """Raise TooLittleEvidence for a scale too uncertain to be written, EvidenceDisagrees for a contradiction."""
        if self.scale.verdict == "refuse":
            low, high = self.scale.interval90
            raise TooLittleEvidence(
                f"{self.source.path}: the scale is only known to lie between {low:.4g} and {high:.4g} "
                f"{self.scale.unit}",
                "Name the country's fleet (--fleet), give a scene with more vehicles, or write all the same with "
                "--force.",
            )
        agreement = self.measured.agreement
        if agreement is not None and agreement.contradicts:
            raise EvidenceDisagrees(
                f"{self.source.path}: {agreement.sentence()}",
                "Look at the boxes (--save-detections) and the poses, choose one way with --mode, or write all the "
                "same with --force.",
            )
        if self.scale.tension > CONFLICT:
            raise EvidenceDisagrees(
                f"{self.source.path}: {self.scale.remarks[0]}",
                "Look at the boxes (--save-detections), name the country's fleet, or write all the same with --force.",
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
    fleet: str | Path = "world",
    images: str | Path | None = None,
    detections: str | Path | None = None,
    detector: str | Path | None = None,
    zoom: float | None = None,
    gsd_hint: float | None = None,
    progress: Progress | None = None,
    mode: str | None = None,
) -> Result:
    """Find the scale of an orthophoto (metres per pixel) or a COLMAP model (metres per model unit).

    fleet : code of the country's fleet, or a JSON file. images : folder of a model's frames, when not beside it.
    detections : boxes from a file instead of the detector. detector : an ONNX file instead of the shipped one.
    zoom, gsd_hint : detector pixels per picture pixel, or the expected metres per pixel, instead of the zoom search.
    mode : how a model is measured, one of `looks.MODES`; by default in every way that there is evidence for.
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
    model = None if source.unit == "m/px" else cast("ColmapSource", source)
    if model is None and mode is not None:
        raise UsageError("--mode is for COLMAP models", f"{source.path} is an image: leave --mode away.")
    choice = None
    if detections is not None:
        found = Detections.load(Path(detections))
        found = _of_source(found, source, Path(detections))
    else:
        detector_file = _path(detector)
        if gsd_hint is not None:
            zoom = _zoom_for(gsd_hint, ruler_fleet, detector_file)
        try:
            if model is None:
                found, choice = find_vehicles(source.pictures, detector_file, zoom, progress)
            else:
                found, choice = find_in_model(model, mode, detector_file, zoom, progress)
        except TooLittleEvidence as error:
            raise TooLittleEvidence(f"{source.path}: {error.message}", error.hint) from error
    try:
        measured = (
            measure(source, found, ruler_fleet) if model is None else measure_model(model, found, ruler_fleet, mode)
        )
    except TooLittleEvidence as error:
        raise TooLittleEvidence(
            f"{source.path}: {error.message} (looked at zoom {found.zoom:.2f}, vehicles about "
            f"{_typical_length(found):.0f} px long there)",
            "Try the fleet of the country (--fleet), another zoom (--gsd-hint METRES_PER_PIXEL, --zoom FACTOR), "
            "or a scene with more vehicles.",
        ) from error
    return Result(source, ruler_fleet, found, choice, time.perf_counter() - started, measured)


def fix(
    path: str | Path,
    out: str | Path,
    *,
    overwrite: bool = False,
    override: bool = False,
    force: bool = False,
    dense: bool = False,
    **options: Any,
) -> Result:
    """Estimate the scale of `path` (see `estimate` for `options`) and write a copy of it in metres at `out`.

    An orthophoto becomes the GeoTIFF `out` with `out`.json and `out`.png beside it; a model the folder `out` with
    sim3.txt, report.json and vehicles.png in it. All of them appear, or none.

    overwrite : replace what is at `out`. override : rescale although the input's own georeferencing gives a scale.
    force : write although the evidence is too uncertain to be useful (verdict ``refuse``) or contradicts itself.
    dense : write the model's dense workspace in metres too, as ``dense/``: depth maps, cloud, meshes.
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
    if dense:
        _check_dense(source)
    result = estimate(source, **options)
    if not force:
        result.require_useful()
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
        if dense:
            (main / "dense").mkdir()
            cast("ColmapSource", source).write_dense(main / "dense", result.scale.value)
        draw(result, picture)
        write_json(document(result), report)
        if overwrite:
            for suffix in GDAL_SIDECARS:  # those of the file that is replaced would speak for the new one
                _beside(out, suffix).unlink(missing_ok=True)
    return result


def _check_dense(source: Source) -> None:
    """Refuse early what `fix` could not write in the end."""
    if source.unit == "m/px":
        raise UsageError("--dense is for COLMAP models", f"{source.path} is an image: leave --dense away.")
    cast("ColmapSource", source).dense  # noqa: B018  raises where there is none


def _beside(out: Path, suffix: str) -> Path:
    return out.with_name(out.name + suffix)


def _path(value: str | Path | None) -> Path | None:
    return None if value is None else Path(value)


def _of_source(found: Detections, source: Source, path: Path) -> Detections:
    """`found` without pictures that `source` does not have: those of a workspace's other models."""
    known = set(source.picture_names)
    strangers = [name for name in found.boxes if name not in known]
    if not strangers:
        return found
    if len(strangers) == len(found.boxes):
        raise InputError(
            f"{path}: {len(strangers)} of its {len(found.boxes)} pictures are not in {source.path}, "
            f"the first is {strangers[0]!r}",
            f"The source has pictures like {source.picture_names[0]!r}: give the detections that were made on it.",
        )
    source.notes.append(f"{path}: {len(strangers)} of its pictures are not in this model, the first is {strangers[0]}")
    return replace(found, boxes={name: boxes for name, boxes in found.boxes.items() if name in known})


def _typical_length(found: Detections) -> float:
    lengths = [boxes.length for boxes in found.boxes.values() if len(boxes)]
    return float(np.median(np.concatenate(lengths))) if lengths else 0.0


def _zoom_for(gsd: float, fleet: Fleet, detector_file: Path | None) -> float:
    from .detect.detector import Detector

    return Detector(detector_file).card.best_length * gsd / float(fleet.mean[0])
