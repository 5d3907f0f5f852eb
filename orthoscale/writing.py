"""Writing the scaled copy of a source and what goes with it: all of it appears, or nothing."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, cast

from .atomic import check_free, new_file, new_folder
from .errors import UsageError
from .pipeline import measured
from .requests import FixRequest
from .result import Result
from .sources.opening import open_source

if TYPE_CHECKING:
    from typing import Unpack

    from .detect.find import Progress
    from .requests import FixOptions
    from .sources.colmap import ColmapSource
    from .sources.raster import RasterSource

GDAL_SIDECARS = (".aux.xml", ".ovr", ".msk")
REPORTS = {"none": (), "json": ("json", "png"), "html": ("json", "png", "html")}  # parts of a report, by its level


def fix(
    path: str | Path,
    out: str | Path,
    *,
    progress: Progress | None = None,
    **options: Unpack[FixOptions],
) -> Result:
    """Estimate the scale of `path` (see `estimate` for its options) and write a copy of it in metres at `out`.

    An orthophoto becomes the GeoTIFF `out` with `out`.json, `out`.png and `out`.html beside it; a model the folder
    `out` with sim3.txt, report.json, vehicles.png and report.html in it. All of them appear, or none.

    overwrite : replace what is at `out`. override : rescale although the input's own georeferencing gives a scale.
    keep_origin : an orthophoto keeps its coordinate reference system, first corner and direction; else local metres.
    cog : write a cloud-optimised GeoTIFF. also : more files for other programs, of `orthoscale.report.extras.EXTRAS`.
    force : write although the evidence is too uncertain to be useful (verdict ``unusable``) or contradicts itself.
    dense : write the model's dense workspace in metres too, as ``dense/``: depth maps, cloud, meshes.
    report : ``html``, ``json`` (without the page) or ``none``.
    Raises what `estimate` raises, OutputError.
    """
    return written(Path(path), Path(out), FixRequest.of(options), progress)


def written(path: Path, out: Path, request: FixRequest, progress: Progress | None = None) -> Result:
    """What `request` asks of the input at `path`, written at `out`; see `fix`."""
    overwrite = request.overwrite
    check_free(out, overwrite)
    if out.resolve() == path.resolve():
        raise UsageError(f"{out} is the input itself", "The input is never touched: choose another --out.")
    source = open_source(path, request.images, need_images=request.detections is None)
    from .report.extras import chosen

    wanted = chosen(request.also)
    extras = [(extra.place(out), extra.write) for extra in wanted]
    parts = report_paths(out, source.unit, request.report)
    if source.unit == "m/px":
        request.for_orthophoto(path)
        for beside in (*parts.values(), *(place for place, _ in extras)):
            check_free(beside, overwrite)
        for extra in wanted:
            extra.check(source)
    else:
        request.for_model(path)
    if source.metric_already and not request.override:  # not behind its owner's back
        raise UsageError(
            f"{path} is in metres already: {source.metric_already}",
            "Compare that with the vehicles by `orthoscale estimate`, or replace its scale with --override.",
        )
    if request.dense:
        cast("ColmapSource", source).dense  # noqa: B018  raises where there is none, before any work is done
    result = measured(source, request.estimating(), progress)
    if not request.force:
        result.require_useful()
    from .report.files import write_report

    with ExitStack() as outputs:  # renamed into place in reverse order, the main output last
        if source.unit == "m/px":
            main = outputs.enter_context(new_file(out, overwrite))
            parts = {kind: outputs.enter_context(new_file(place, overwrite)) for kind, place in parts.items()}
            raster = cast("RasterSource", source)
            raster.write(main, result.scale.value, request.keep_origin, request.cog)
            for place, write in extras:
                partial = outputs.enter_context(new_file(place, overwrite))
                write(result, raster.place(result.scale.value, request.keep_origin), partial)
        else:
            main = outputs.enter_context(new_folder(out, overwrite))
            parts = {kind: main / place.name for kind, place in parts.items()}
            source.write(main, result.scale.value)
            if request.dense:
                (main / "dense").mkdir()
                cast("ColmapSource", source).write_dense(main / "dense", result.scale.value)
        write_report(result, parts)
        if overwrite and main.is_file():  # what lies beside the file that is replaced would speak for the new one
            stale = [f".{kind}" for kind in REPORTS["html"] if kind not in parts]
            for suffix in (*GDAL_SIDECARS, *stale):
                _beside(out, suffix).unlink(missing_ok=True)
            if "tfw" not in request.also:
                out.with_suffix(".tfw").unlink(missing_ok=True)
    return result


def report_paths(out: Path, unit: str, report: str) -> dict[str, Path]:
    """Where `fix` writes the parts of a report: beside the scaled orthophoto `out`, or into the folder `out`."""
    if unit == "m/px":
        return {kind: _beside(out, f".{kind}") for kind in REPORTS[report]}
    return {kind: out / ("vehicles.png" if kind == "png" else f"report.{kind}") for kind in REPORTS[report]}


def _beside(out: Path, suffix: str) -> Path:
    return out.with_name(out.name + suffix)
