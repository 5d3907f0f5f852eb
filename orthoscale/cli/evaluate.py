"""`orthoscale evaluate`: compares the method with known altitudes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import UsageError
from ..requests import PhotoRequest
from .options import (
    MEASURING,
    PATH,
    command,
    debug_option,
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
    from ..evaluate.locating import Search
    from ..evaluate.readers import Sample


@command(
    epilog="\b\nExamples:\n  orthoscale evaluate DenseUAV/test/query_drone --fleet CN\n"
    "  orthoscale evaluate UAVVisLoc_plus/ --fleet CN --ablations --out visloc.json\n"
    "  orthoscale evaluate photos.csv --fleet DE --detections b.json --out e.csv\n"
    "  orthoscale evaluate photos.csv --depth-folder depth/ --depth-factor da3\n"
    "  orthoscale evaluate DenseUAV/test/query_drone --fleet CN --locate \\\n"
    "      --satellite city.tif --scale-errors -.5,...,.5\n\n" + MEASURING
)
@click.argument("path", metavar="DATASET", type=PATH)
@option(
    "--form",
    type=click.Choice(["denseuav", "visloc", "csv"]),
    group="Input",
    help="Form of the data set; by default recognised.",
)
@option("--focal-px", type=float, metavar="PX", group="Input", help="Focal length, instead of the data set's.")
@option("--lens", "lens_file", type=PATH, group="Input", help="Camera calibration, instead of the data set's.")
@options_of(PhotoRequest, leave=("depth",))
@option(
    "--depth-folder",
    "--depth",
    "depth",
    type=PATH,
    group="Evidence",
    help="Metric depth to compare with: a folder of .npy, .tif or .png named as the photos are, or a network (.onnx).",
)
@save_option
@option("--max-pitch", type=float, metavar="DEG", group="Input", help="Skip photos with a flatter view (paper: -60).")
@option("--locate", is_flag=True, group="Input", help="Evaluate `orthoscale locate` instead, on --satellite.")
@option("--satellite", type=PATH, group="Input", help="Georeferenced map for --locate.")
@option("--method", type=click.Choice(["auto", "dense", "gradient"]), group="Input", help="How --locate compares.")
@option(
    "--scale-errors",
    metavar="LIST",
    group="Advanced",
    help="For --locate: errors of the true scale to search with, such as -.5,...,.5.",
)
@option("--ablations", is_flag=True, group="Advanced", help="Also vary the score threshold and the number of vehicles.")
@option("--sensitivity", is_flag=True, group="Advanced", help="Also with wrong pitch and wrong focal length.")
@option(
    "--out",
    "outputs",
    multiple=True,
    type=PATH,
    group="Main",
    help="File to write: .json (everything) or .csv (a line per photo); repeatable.",
)
@overwrite_option
@json_option("everything")
@debug_option
def evaluate(
    path: Path,
    form: str | None,
    focal_px: float | None,
    lens_file: Path | None,
    save_detections: Path | None,
    max_pitch: float | None,
    locate: bool,
    satellite: Path | None,
    method: str | None,
    scale_errors: str | None,
    ablations: bool,
    sensitivity: bool,
    outputs: tuple[Path, ...],
    overwrite: bool,
    as_json: bool,
    **looking: Any,
) -> None:
    """Compare altitudes by vehicles with true ones, on a data set.

    Prints the paper's tables for your data. DATASET is a folder of photos named by their altitude (DenseUAV:
    000001/H80.JPG), a folder of regions with drone/, reference.txt, camera.xml and a *_dsm.tif (UAV-VisLoc+), or a
    CSV with the columns image, altitude_m and, where wanted, region, focal_px, pitch_deg, roll_deg. Three methods
    side by side: `exact` is this program's, `paper` the paper's formula, `program` what its authors' program
    computes. With --locate, how often the photos are found on a map by the vehicles' scale, by the true one and by
    wrong ones; their places come from Dense_GPS_*.txt, the CSV's longitude and latitude, or GPS tags.
    """
    from ..actions.kept_boxes import KeptBoxes
    from ..evaluate import report
    from ..photos.depth.maps import Depths
    from ..photos.looking import Album, Looking, boxes_of
    from ..photos.tables import check_ending
    from ..system.outputs import Outputs

    refuse_idle_overwrite(overwrite, outputs, save_detections)
    of_altitudes = ablations or sensitivity or looking["depth"] is not None
    _check_locate(locate, satellite, of_altitudes, method=method, scale_errors=scale_errors)
    how = Looking.of(looking)
    with Outputs(overwrite, (path, satellite, lens_file, how.inputs)) as files, progress_bars() as progress:
        for output in outputs:
            check_ending(output, (".json", ".csv"))
        partials = [files.file(output) for output in outputs]
        boxes = KeptBoxes(files, save_detections)
        samples, notes = report.samples_of(path, form, lens_file, focal_px, max_pitch)
        photos = [sample.photo for sample in samples]
        album = Album(photos)
        boxes.check(album)
        search = None
        if satellite is not None:
            search, more = _search(path, samples, satellite, method, scale_errors)
            notes = [*notes, *more]
        depths = Depths.asked(how, several=len(photos) > 1)
        ruler, why = how.ruler_fleet([photo.path for photo in photos])
        notes = [*notes, *why]
        found = boxes_of(photos, how, ruler, progress)
        notes += found.notes
        boxes.keep(found, album)
        written = outputs if save_detections is None else (*outputs, save_detections)
        with boxes.telling():
            if search is None:
                text = report.document(samples, found, ruler, notes, ablations, sensitivity, progress, depths)
                lines = report.tables(text, written)
            else:
                from ..evaluate import locating

                text = locating.document(search, found, ruler, notes, progress)
                lines = [*locating.table(text), *(f"written    {output}" for output in written)]
        for partial in partials:
            report.write(text, partial)
    say_json(text) if as_json else say(*lines)


def _check_locate(locate: bool, satellite: Path | None, of_altitudes: bool, **more: object) -> None:
    """Raise UsageError for options that would have no effect with, or without, --locate."""
    if locate and satellite is None:
        raise UsageError("--locate needs a map", "Give it: --satellite MAP.tif.")
    if locate and of_altitudes:
        raise UsageError(
            "--ablations, --sensitivity and --depth-folder are for altitudes, not for --locate", "Remove them."
        )
    for name, value in {"satellite": satellite, **more}.items():
        if value is not None and not locate:
            raise UsageError(f"--{name.replace('_', '-')} does nothing without --locate", "Add --locate.")


def _search(
    path: Path, samples: Sequence[Sample], satellite: Path, method: str | None, errors: str | None
) -> tuple[Search, list[str]]:
    """What --locate searches for, and notes on its places."""
    from ..actions.locate import LocateRequest
    from ..evaluate import locating
    from ..evaluate.places import placed
    from ..sources.satellite import Satellite

    wrong = [] if errors is None else locating.scale_errors(errors)
    request = LocateRequest(method=method or "auto")
    known, notes = placed(path, samples)
    return locating.Search.of(known, Satellite.open(satellite), request, wrong), list(notes)
