"""The files of a report, and a report's page drawn again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import Any

from ..actions.result import Result
from ..core.source import Source
from ..errors import InputError, OrthoscaleError, UsageError
from ..formats.reading import is_there, reason
from ..sources.opening import open_source
from ..system.outputs import Outputs, ours_in_a_folder
from .document import of_plan, read_json, write_json
from .page import page
from .pictures import draw
from .scene import Scene

Attempt = Callable[[Path, str], AbstractContextManager[None]]


def write_report(result: Result, paths: Mapping[str, Path], attempt: Attempt) -> None:
    """Write the parts of the report that `paths` names, ``json`` first, then ``png``, ``html``, each in an `attempt`
    (`Outputs.attempt`), so that one that fails takes nothing else away."""
    report = cache(result.to_dict)
    scene = cache(lambda: Scene.of(report(), result.source))
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
    """Draw the report.json at `path` again, to `out`: its page, or its picture where `out` ends in .png; with frames
    when its input is still there, unchanged.

    images : folder of a model's frames, when not beside it. Returns why there are none, or ''.
    Raises InputError for a file that is no report, UsageError for frames of an orthophoto, and what `Outputs` does.
    """
    with Outputs(overwrite, (path, images)) as outputs:
        partial = outputs.file(out, ours_in_a_folder)
        report = read_json(path)
        if images is not None and of_plan(report):
            raise UsageError(f"--images are a model's frames, and {path} is of an orthophoto", "Remove --images.")
        try:
            source, why = _source(report, path, images)
            if source is not None:
                outputs.protect(*source.files)
            scene = Scene.of(report, source)
            if out.suffix.lower() == ".png":
                draw(report, scene, partial)
            else:
                _write_page(page(report, scene), partial)
        except (OrthoscaleError, OSError):
            raise
        except Exception as error:  # whatever values that do not fit together lead to
            raise InputError(
                f"{path}: a damaged report ({reason(error)})", "Make it again with `orthoscale fix`."
            ) from error
    return why


def _write_page(html: str, path: Path) -> None:
    path.write_bytes(html.encode("utf-8", "backslashreplace"))  # file names need not be text


def _source(report: Mapping[str, Any], path: Path, images: Path | None) -> tuple[Source | None, str]:
    """The source that a report speaks of, or None and why it is not taken."""
    told = Path(report["input"]["path"])
    found = next((place for place in (told, path.parent / told) if is_there(place)), None)
    if found is None:
        return None, f"{told} is not there"
    if images is None and "images" in report["settings"]:
        images = Path(report["settings"]["images"])
    images = None if of_plan(report) else images
    try:
        source = open_source(found, images, need_images=False, ground_cloud=report["settings"].get("ground_cloud"))
    except OrthoscaleError as error:
        return None, error.message
    if source.content_hash() != report["input"]["sha256"]:
        return None, f"{found} has changed since"
    return source, ""
