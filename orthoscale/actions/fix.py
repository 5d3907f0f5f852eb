"""Writes the scaled copy of a source and its accompanying files: all of them, or none."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.source import Plan, PosedSet, Source
from ..errors import Incomplete, MetricAlready, UsageError
from ..formats.detections import check_name
from ..formats.pictures import PICTURES
from ..report.extras import WRITERS, chosen
from ..report.files import write_report
from ..report.result import Result
from ..requests import FixRequest
from ..sources.gdal import beside
from ..sources.opening import AN_INPUT
from ..sources.raster import RasterSource
from ..system.outputs import Outputs
from ..system.paths import path_of
from ..system.untouched import inside
from .estimate import measured, noted
from .kept_boxes import KeptBoxes
from .opening import source_of

if TYPE_CHECKING:
    from typing import Unpack

    from ..core.progress import Progress
    from ..requests import FixOptions

REPORT_FILES = {"none": (), "json": ("json", "png"), "html": ("json", "png", "html")}  # parts of a report, by --report


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
    save_detections : also keep the boxes in this file, even if the scale is refused.
    Raises what `estimate` raises, OutputError; Incomplete if the copy is verified and in its place but a file beside
    it could not be made.
    """
    keep = None if save_detections is None else path_of(save_detections, "the path of the boxes")
    given, copy = path_of(path, AN_INPUT), path_of(out, "the path of the copy")
    return written(given, copy, FixRequest.of(options), progress, keep)


def written(
    path: Path,
    out: Path,
    request: FixRequest,
    progress: Progress | None = None,
    save_detections: Path | None = None,
) -> Result:
    """Write the copy of the input at `path` that `request` asks for at `out`; see `fix`."""
    with Outputs(request.overwrite, (path, request.inputs)) as outputs:
        begun = _begin(path, out, request, outputs, save_detections, progress)
        source, writer, boxes = begun.source, begun.writer, begun.boxes
        with boxes.also_without_scale():
            result = noted(measured(source, request.estimating(), progress, boxes.take))
            boxes.take(result.detections, source)
            if not request.force:
                result.require_useful()
        result = replace(result, settings=request.without(("overwrite",)).settings(), given=request.inputs)
        writer.write(begun.main, result)
        # The copy is verified: it stays even if something fails from here on.
        write_report(result, begun.parts, outputs.attempt)
        writer.write_more(result, outputs)
        if boxes.partial is not None:
            with outputs.attempt(boxes.partial, boxes.partial.name):
                boxes.save()
    if missing := outputs.missing():
        raise Incomplete(
            f"{out.name} is written and verified, but {missing}",
            "`orthoscale report` makes page and picture from the report's JSON; else run again with --overwrite.",
            result,
        )
    return result


def rehearsed(path: Path, out: Path, request: FixRequest, save_detections: Path | None = None) -> list[Path]:
    """The paths that `written` would write, the copy first; writes nothing. Raises what that raises before it
    measures."""
    with Outputs(request.overwrite, (path, request.inputs), dry_run=True) as outputs:
        _begin(path, out, request, outputs, save_detections)
    return outputs.places


@dataclass(frozen=True)
class _Begun:
    """Where a copy, the parts of its report and its boxes are being written."""

    source: Source
    writer: _PlanWriter | _PosedWriter
    main: Path
    parts: dict[str, Path]
    boxes: KeptBoxes


def _begin(
    path: Path,
    out: Path,
    request: FixRequest,
    outputs: Outputs,
    save_detections: Path | None,
    progress: Progress | None = None,
) -> _Begun:
    """Open the input, refuse what makes no sense, and reserve all outputs."""
    if os.path.lexists(out) and path.is_file() and path.suffix.lower() in PICTURES:
        # Check the name first: an existing file matters only if its name is one that could be written.
        RasterSource.check_name(out)
    outputs.check(out)
    if save_detections is not None:
        check_name(save_detections)
        outputs.check(save_detections)
    source = source_of(path, request, progress)
    request.check_for(source)
    writer = _writer(source, out, request)
    if source.metric_already and not request.override:  # an existing scale is replaced only if the user says so
        raise MetricAlready(
            f"{path} is in metres already: {source.metric_already}",
            "Compare that with the vehicles using `orthoscale check`, or replace its scale with --override.",
        )
    main, parts = writer.places(outputs)
    boxes = KeptBoxes(outputs, save_detections)
    boxes.check(source)
    outputs.protect(*source.files, *writer.more_inputs)
    return _Begun(source, writer, main, parts, boxes)


def report_paths(out: Path, in_folder: bool, report: str) -> dict[str, Path]:
    """Where `fix` writes the parts of a report: into the folder `out` of a model, or beside the scaled orthophoto."""
    if in_folder:
        return {kind: out / ("vehicles.png" if kind == "png" else f"report.{kind}") for kind in REPORT_FILES[report]}
    return {kind: _beside(out, f".{kind}") for kind in REPORT_FILES[report]}


def _writer(source: Source, out: Path, request: FixRequest) -> _PlanWriter | _PosedWriter:
    return _PosedWriter(source, out, request) if source.plan is None else _PlanWriter(source, out, request)


class _PlanWriter:
    """Writes an orthophoto: one file, and others beside it that are named after it."""

    more_inputs: Sequence[Path] = ()

    def __init__(self, plan: Plan, out: Path, request: FixRequest):
        self.plan, self.out, self.request = plan, out, request
        self.extras = chosen(request.also)
        self.places_of_extras: list[Path] = []
        plan.check_name(out)
        if request.against is None:  # with a map, the copy may get a place that the input lacks
            for extra in self.extras:
                extra.check(self.plan, request.keep_origin)

    def places(self, outputs: Outputs) -> tuple[Path, dict[str, Path]]:
        main = outputs.file(self.out)
        parts = report_paths(self.out, False, self.request.report)
        parts = {kind: outputs.file(place) for kind, place in parts.items()}
        self.places_of_extras = [outputs.file(extra.place(self.out), extra.known(self.out)) for extra in self.extras]
        # Files beside a replaced copy would be taken for those of the new one.
        for kind in set(REPORT_FILES["html"]) - set(parts):
            outputs.retire(_beside(self.out, f".{kind}"))
        taken = []
        for extra in WRITERS.values():
            place = extra.place(self.out)
            if extra in self.extras or outputs.retire(place, extra.known(self.out)):
                taken.append(place)
        self._refuse_beside(taken)
        return main, parts

    def _refuse_beside(self, taken: Sequence[Path]) -> None:
        """Raise UsageError for a file that programs would read together with the copy, and that is none of the outputs
        `taken`: a world file that was edited would give the copy another scale."""
        given = self.plan.path
        of_input = [given.with_name(name) for name in beside(given)]
        for place in map(self.out.with_name, beside(self.out)):
            if os.path.lexists(place) and not any(inside(place, each) for each in taken):
                mine = any(inside(place, each) for each in of_input)
                hint = (
                    f"It belongs to {given}: choose another name." if mine else "Move it away, or choose another name."
                )
                raise UsageError(f"{place} would be taken for a part of {self.out}", hint)

    def write(self, main: Path, result: Result) -> None:
        scale, place = result.scale, result.place(self.request.keep_origin)
        low, high = scale.interval90
        by = f"{scale.vehicles_used} vehicles, fleet {scale.fleet}"
        said = f"{scale.value:.6g} m/px, 90 % {low:.6g} to {high:.6g} m/px, {scale.verdict}; {by}"
        self.plan.write(main, scale.value, place, self.request.cog, said)

    def write_more(self, result: Result, outputs: Outputs) -> None:
        for extra, partial in zip(self.extras, self.places_of_extras, strict=True):
            with outputs.attempt(partial, partial.name):
                extra.write(result, result.place(self.request.keep_origin), partial)


class _PosedWriter:
    """Writes a reconstruction: a folder with all its files."""

    def __init__(self, posed: PosedSet, out: Path, request: FixRequest):
        self.posed, self.out, self.request = posed, out, request
        posed.check_writable()
        self.more_inputs = [self.posed.dense] if request.dense else []  # raises where there is none

    def places(self, outputs: Outputs) -> tuple[Path, dict[str, Path]]:
        main = outputs.folder(self.out, metres=True)
        return main, report_paths(main, True, self.request.report)

    def write(self, main: Path, result: Result) -> None:
        scale = result.scale.value
        self.posed.write(main, scale)
        if self.request.dense:
            (main / "dense").mkdir()
            self.posed.write_dense(main / "dense", scale)

    def write_more(self, result: Result, outputs: Outputs) -> None:
        """Nothing: all of it is in the folder."""


def _beside(out: Path, suffix: str) -> Path:
    return out.with_name(out.name + suffix)
