"""Writes the files of a report, and draws a report's page or picture again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import Any

from ..core.source import Source
from ..errors import InputError, OrthoscaleError, UsageError
from ..formats.names import write_json
from ..formats.reading import is_there, reason
from ..sources.opening import NO_CLOUD, open_source
from ..system.outputs import Outputs
from ..system.signatures import ours_in_a_folder
from .inputs import replaced_inputs
from .page import page
from .pictures import draw
from .result import Result
from .scene import ReportPictures
from .stored import of_plan, read_json

DRAWN_AS = (".html", ".htm", ".png")
Attempt = Callable[[Path, str], AbstractContextManager[None]]


def write_report(result: Result, paths: Mapping[str, Path], attempt: Attempt) -> None:
    """Write the parts of the report that `paths` names, ``json`` first, then ``png``, ``html``, each in an `attempt`
    (`Outputs.attempt`), so that a failure of one does not affect the others."""
    report = cache(result.to_dict)
    scene = cache(lambda: ReportPictures.of(report(), result.source))
    writers: dict[str, Callable[[Path], None]] = {
        "json": lambda place: write_json(report(), place),
        "png": lambda place: draw(report(), scene(), place),
        "html": lambda place: _write_page(page(report(), scene()), place),
    }
    for kind, write in writers.items():
        if kind in paths:
            with attempt(paths[kind], paths[kind].name):
                write(paths[kind])


def redraw(path: Path, out: Path, images: Path | None = None, overwrite: bool = False) -> str:
    """Draw the report.json at `path` again, to `out`: its page, or its picture if `out` ends in .png. The input's own
    pictures are shown if it is still there, unchanged.

    images : folder of a model's frames, when not beside it. Returns why the input's pictures are missing, or ''.
    Raises InputError for a file that is no report, UsageError if `images` is given for an orthophoto or `out` ends in
    neither .html nor .png, and what `Outputs` raises.
    """
    if out.suffix.lower() not in DRAWN_AS:
        raise UsageError(
            f"{out}: a report is drawn as a page or a picture", "Choose a name that ends in .html or .png."
        )
    with Outputs(overwrite, (path, images)) as outputs:
        partial = outputs.file(out, ours_in_a_folder)
        report = read_json(path)
        if images is not None and of_plan(report):
            raise UsageError(f"--images are a model's frames, and {path} is of an orthophoto", "Remove --images.")
        try:
            source, why = _source(report, path, images)
            if source is not None:
                outputs.protect(*source.files)
            scene = ReportPictures.of(report, source)
            if out.suffix.lower() == ".png":
                draw(report, scene, partial)
            else:
                _write_page(page(report, scene), partial)
        except (OrthoscaleError, OSError):
            raise
        except Exception as error:  # inconsistent values may lead to any error
            raise InputError(
                f"{path}: a damaged report ({reason(error)})", "Make it again with `orthoscale fix`."
            ) from error
    return why


def _write_page(html: str, path: Path) -> None:
    path.write_bytes(html.encode("utf-8", "backslashreplace"))  # file names need not be text


def _source(report: Mapping[str, Any], path: Path, images: Path | None) -> tuple[Source | None, str]:
    """The source of a report, and ''; or None, and why it cannot be used."""
    settings = report["settings"]
    # Relative names start from the folder of the first run, or from the report's if it was moved with its input.
    starts = [Path(report["input"]["folder"]), path.parent, Path()]
    found = _there(report["input"]["path"], starts)
    if found is None:
        return None, f"{report['input']['path']} is not there"
    if images is None and "images" in settings:
        images = _there(settings["images"], starts) or Path(settings["images"])
    images = None if of_plan(report) else images
    cloud = settings.get("ground_cloud")
    if cloud not in (None, NO_CLOUD):
        cloud = _there(cloud, starts) or cloud
    clouds = [cloud] if of_plan(report) else dict.fromkeys([cloud, NO_CLOUD])  # one may lie beside the model only since
    try:
        for each in clouds:
            source = open_source(found, images, need_images=False, ground_cloud=each, compare_frames=False)
            if source.content_hash() == report["input"]["sha256"]:
                why = replaced_inputs(report, source)
                return (None, why) if why else (source, "")
    except OrthoscaleError as error:
        return None, error.message
    return None, f"{found}{', or the dense cloud of its ground,' * (not of_plan(report))} has changed since"


def _there(name: str, starts: Sequence[Path]) -> Path | None:
    """The path `name` in the first of the folders `starts` in which it exists; None if in none."""
    return next((start / name for start in starts if is_there(start / name)), None)
