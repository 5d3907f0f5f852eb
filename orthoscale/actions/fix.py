"""Writing the scaled copy of a source and what goes with it: all of it appears, or nothing."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, cast

from ..errors import Incomplete, UsageError
from ..sources.opening import open_source
from ..system.outputs import Outputs
from .estimate import measured
from .requests import FixRequest
from .result import Result

if TYPE_CHECKING:
    from typing import Unpack

    from ..detect.find import Progress
    from ..sources.colmap import ColmapSource
    from ..sources.raster import RasterSource
    from .requests import FixOptions

GDAL_SIDECARS = (".aux.xml", ".ovr", ".msk")
REPORT_FILES = {"none": (), "json": ("json", "png"), "html": ("json", "png", "html")}  # parts of a report, by its level


def fix(
    path: str | Path,
    out: str | Path,
    *,
    progress: Progress | None = None,
    save_detections: str | Path | None = None,
    **options: Unpack[FixOptions],
) -> Result:
    """Estimate the scale of `path` (see `estimate` for its options) and write a copy of it in metres at `out`.

    An orthophoto becomes the GeoTIFF `out` with `out`.json, `out`.png and `out`.html beside it; a model the folder
    `out` with sim3.txt, report.json, vehicles.png and report.html in it. No input is touched, see `outputs`.

    overwrite : replace what orthoscale wrote at `out` before. override : rescale although the input's own
    georeferencing gives a scale. keep_origin : an orthophoto keeps its coordinate reference system, first corner and
    direction; else local metres.
    cog : write a cloud-optimised GeoTIFF. also : more files for other programs, of `orthoscale.report.extras.WRITERS`.
    force : write although the evidence is too uncertain to be useful (verdict ``unusable``) or contradicts itself.
    dense : write the model's dense workspace in metres too, as ``dense/``: depth maps, cloud, meshes.
    report : ``html``, ``json`` (without the page) or ``none``.
    save_detections : also keep the boxes in this file.
    Raises what `estimate` raises, OutputError; Incomplete if the copy is verified and in its place but something beside
    it could not be made.
    """
    keep = None if save_detections is None else Path(save_detections)
    return written(Path(path), Path(out), FixRequest.of(options), progress, keep)


def written(
    path: Path, out: Path, request: FixRequest, progress: Progress | None = None, save_detections: Path | None = None
) -> Result:
    """What `request` asks of the input at `path`, written at `out`; see `fix`."""
    from ..formats.detections import check_name, save
    from ..report.extras import WRITERS, chosen
    from ..report.files import write_report

    with Outputs(request.overwrite, (path, vars(request))) as outputs:
        outputs.check(out)
        if save_detections is not None:
            check_name(save_detections)
            outputs.check(save_detections)
        source = open_source(path, request.images, need_images=request.detections is None)
        parts, extras = report_paths(out, source.unit, request.report), chosen(request.also)
        picture = source.unit == "m/px"
        if picture:
            request.for_orthophoto(path)
            for extra in extras:
                extra.check(source)
        else:
            request.for_model(path)
        if source.metric_already and not request.override:  # not behind its owner's back
            raise UsageError(
                f"{path} is in metres already: {source.metric_already}",
                "Compare that with the vehicles by `orthoscale estimate`, or replace its scale with --override.",
            )
        dense = cast("ColmapSource", source).dense if request.dense else None  # raises where there is none
        if picture:
            for suffix in GDAL_SIDECARS:
                if os.path.lexists(beside := _beside(out, suffix)):
                    raise UsageError(f"{beside} would be taken for a part of {out}", "Move it away, or delete it.")
            main = outputs.file(out)
            parts = {kind: outputs.file(place) for kind, place in parts.items()}
            places = [outputs.file(extra.place(out), extra.known(out)) for extra in extras]
            # What lies beside the file that is replaced would speak for the new one.
            for kind in set(REPORT_FILES["html"]) - set(parts):
                outputs.retire(_beside(out, f".{kind}"))
            for extra in WRITERS.values():
                if extra not in extras:
                    outputs.retire(extra.place(out), extra.known(out))
        else:
            main = outputs.folder(out)
            parts = {kind: main / place.name for kind, place in parts.items()}
        if save_detections is not None:
            save_detections = outputs.file(save_detections)
        outputs.protect(*source.files, *([] if dense is None else [dense]))
        result = measured(source, request.estimating(), progress)
        if not request.force:
            result.require_useful()
        if picture:
            raster = cast("RasterSource", source)
            raster.write(main, result.scale.value, request.keep_origin, request.cog)
        else:
            source.write(main, result.scale.value)
            if request.dense:
                (main / "dense").mkdir()
                cast("ColmapSource", source).write_dense(main / "dense", result.scale.value)
        # The copy is verified: what fails from here on does not take it away.
        write_report(result, parts, outputs.attempt)
        if picture:
            for extra, partial in zip(extras, places, strict=True):
                with outputs.attempt(partial, partial.name):
                    extra.write(result, raster.place(result.scale.value, request.keep_origin), partial)
        if save_detections is not None:
            with outputs.attempt(save_detections, save_detections.name):
                save(result.detections, save_detections, source)
    if missing := outputs.missing():
        raise Incomplete(
            f"{out.name} is written and verified, but {missing}",
            "`orthoscale report` makes the page and the picture from the report's JSON; else run again.",
            result,
        )
    return result


def report_paths(out: Path, unit: str, report: str) -> dict[str, Path]:
    """Where `fix` writes the parts of a report: beside the scaled orthophoto `out`, or into the folder `out`."""
    if unit == "m/px":
        return {kind: _beside(out, f".{kind}") for kind in REPORT_FILES[report]}
    return {kind: out / ("vehicles.png" if kind == "png" else f"report.{kind}") for kind in REPORT_FILES[report]}


def _beside(out: Path, suffix: str) -> Path:
    return out.with_name(out.name + suffix)
