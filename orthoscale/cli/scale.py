"""`orthoscale estimate` and `orthoscale fix`: print the scale of an orthophoto or a model, or write a scaled copy."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext, suppress
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from ..errors import Incomplete, UsageError
from ..requests import EstimateRequest, FixRequest
from .dry_run import rehearse, rehearse_in_new_folder
from .many import Many, inputs, run
from .options import (
    EXIT_CODES,
    MEASURING,
    PATH,
    command,
    debug_option,
    dry_run_option,
    json_option,
    option,
    options_of,
    overwrite_option,
    progress_bars,
    refuse_idle_overwrite,
    save_option,
    say,
    say_json,
)

if TYPE_CHECKING:
    from ..actions.workspace import ModelOutcome


@command(
    epilog="\b\nExamples:\n  orthoscale estimate ortho.tif --fleet DE\n"
    "  orthoscale estimate sparse/0 --images frames/ --fleet US --json\n"
    "  orthoscale estimate sparse/0 --images frames/ --ground-cloud fused.ply\n"
    "  orthoscale estimate 'surveys/*.tif' --fleet DE --summary scales.csv\n\n" + MEASURING
)
@inputs
@options_of(EstimateRequest)
@save_option
@overwrite_option
@json_option()
@dry_run_option
@debug_option
def estimate(
    path: Path,
    many: Many | None,
    as_json: bool,
    dry_run: bool,
    save_detections: Path | None,
    overwrite: bool,
    **options: Any,
) -> None:
    """Print the scale of an orthophoto or a reconstruction.

    INPUT is an orthophoto (any raster that GDAL reads), the folder of a COLMAP model, or a model of OpenSfM, ODM,
    nerfstudio, Bundler or VisualSFM. Several INPUTs, a pattern in quotes, or a folder of inputs: each gets its own
    scale, and one line. Nothing is written but what --summary and --save-detections name.
    """
    from ..actions import estimate as pipeline
    from ..actions import workspace
    from ..actions.kept_boxes import KeptBoxes
    from ..system.outputs import Outputs

    request = EstimateRequest.of(options)
    refuse_idle_overwrite(overwrite, save_detections, many is not None and many.summaries)
    if many is not None:
        _refuse_boxes_of_many(save_detections)
        run("estimate", many, request, as_json, overwrite, dry_run=dry_run)
    models = workspace.models_in(path)
    _refuse_one_file_for_many(models, save_detections)
    if dry_run:
        rehearse(models or [path], request, save_detections=save_detections, overwrite=overwrite, as_json=as_json)
    with Outputs(overwrite, (path, request.inputs)) as outputs, progress_bars() as progress:
        if models:
            outcomes = workspace.estimate_all(models, request, progress)
        else:
            boxes = KeptBoxes(outputs, save_detections)
            with boxes.also_without_scale():
                result = pipeline.noted(pipeline.measured(path, request, progress, boxes.take, boxes.check))
            boxes.take(result.detections, result.source)
            boxes.save()
    if models:
        _finish_all(outcomes, as_json)
        results = [outcome.result for outcome in outcomes if outcome.result is not None]
        if not any(each.useful for each in results):
            results[0].require_useful()
        return
    _finish(result, as_json, _saved(save_detections))
    with boxes.telling():
        result.require_useful()  # after the figures are printed; the exit code keeps scripts from using them


@command(
    epilog="\b\nExamples:\n  orthoscale fix ortho.tif --out scaled.tif --fleet PH\n"
    "  orthoscale fix utm.tif --out scaled.tif --override --keep-origin --also gpkg\n"
    "  orthoscale fix ortho.tif --out placed.tif --fleet PH --against map.tif\n"
    "  orthoscale fix model/ --out scaled/ --fleet US\n"
    "  orthoscale fix model/ --out scaled/ --detections boxes.json\n"
    "  orthoscale fix model/ --out scaled/ --ground-cloud dense/fused.ply\n"
    "  orthoscale fix surveys/ --out scaled/ --fleet US --summary out.csv --jobs 2\n\n" + EXIT_CODES
)
@inputs
@options_of(FixRequest)
@option("--out", required=True, type=PATH, group="Main", help="GeoTIFF (orthophoto) or folder (model) to write.")
@save_option
@json_option()
@dry_run_option
@debug_option
def fix(
    path: Path,
    many: Many | None,
    out: Path,
    as_json: bool,
    dry_run: bool,
    save_detections: Path | None,
    **options: Any,
) -> None:
    """Write a copy of an orthophoto or a reconstruction in metres.

    INPUT as for `estimate`; it is never touched. An orthophoto's pixels are copied unchanged; OUT.html, OUT.json
    and OUT.png come with it. A model is scaled about its own origin; sim3.txt, sim3_4x4.txt, sim3.json,
    report.html, report.json and vehicles.png come with it. In a workspace with several models (sparse/0, sparse/1
    ...) each gets its own scale and its own folder in OUT. With several INPUTs OUT is the folder for all copies.
    """
    from ..actions import fix as writing
    from ..actions import workspace
    from ..system.outputs import Outputs

    request = FixRequest.of(options)
    if many is not None:
        _refuse_boxes_of_many(save_detections)
        run("fix", many, request, as_json, request.overwrite, out, dry_run)
    models = workspace.models_in(path)
    _refuse_one_file_for_many(models, save_detections)
    if dry_run and models:
        with Outputs(request.overwrite, (path, models, request.inputs)) as outputs:
            outputs.check(out)
        rehearse_in_new_folder(models, request, out, lambda folder: [folder / model.name for model in models], as_json)
    if dry_run:
        rehearse([path], request, [out], save_detections=save_detections, as_json=as_json)
    missing = None
    with progress_bars() as progress:
        try:
            if models:
                done: Any = workspace.fix_all(models, out, request, path, progress)
            else:
                done = writing.written(path, out, request, progress, save_detections)
        except Incomplete as error:
            done, missing = error.result, error
    with suppress(Exception) if missing else nullcontext():  # a result that could not be written may fail to print, too
        if models:
            _finish_all(done, as_json, out, request.report)
        else:
            _finish(done, as_json, _written(done, out, request.report) | _saved(save_detections))
    if missing:
        raise missing


def _refuse_boxes_of_many(save_detections: Path | None) -> None:
    if save_detections is not None:
        raise UsageError(
            "--save-detections keeps the boxes of one input", "Name one input, without --summary, or remove it."
        )


def _refuse_one_file_for_many(models: list[Path], save_detections: Path | None) -> None:
    if models and save_detections is not None:
        names = ", ".join(str(model) for model in models)
        raise UsageError("--save-detections keeps the boxes of one model", f"Give one of {names}.")


def _written(result: Any, out: Path, report: str) -> dict[str, Path]:
    """The paths that a user will look for."""
    from ..actions.fix import report_paths

    page = report_paths(out, result.source.posed is not None, report).get("html")
    return {"written": out} | ({"report": page} if page and page.is_file() else {})


def _saved(boxes: Path | None) -> dict[str, Path]:
    """The file of the boxes, where they were saved."""
    return {"boxes": boxes} if boxes is not None and boxes.is_file() else {}


def _finish_all(outcomes: list[ModelOutcome], as_json: bool, out: Path | None = None, report: str = "none") -> None:
    if as_json:
        say_json({outcome.model.name: outcome.document() for outcome in outcomes})
        return
    from ..report.terminal import show

    for outcome in outcomes:
        say(f"--- {outcome.model}")
        if outcome.result is not None:
            show(outcome.result, {} if out is None else _written(outcome.result, out / outcome.model.name, report))
        else:
            say(*f"no scale   {outcome.error}".split("\n"))


def _finish(result: Any, as_json: bool, written: Mapping[str, Path] = MappingProxyType({})) -> None:
    if as_json:
        say_json(result.to_dict())
    else:
        from ..report.terminal import show

        show(result, written)
