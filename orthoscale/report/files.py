"""The files of a report, and a report's page drawn again."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..atomic import check_free, new_file
from ..errors import InputError, OrthoscaleError
from ..reading import is_there, reason
from ..result import Result
from ..sources.opening import open_source
from .document import document, read_json, write_json
from .page import page
from .pictures import draw
from .scene import Scene

if TYPE_CHECKING:
    from ..sources.source import Source

log = logging.getLogger(__name__)


def write_report(result: Result, paths: Mapping[str, Path]) -> None:
    """Write the parts of the report that `paths` names: ``json``, ``png``, ``html``."""
    if not paths:
        return
    report = document(result)
    if "json" in paths:
        write_json(report, paths["json"])
    if "png" in paths or "html" in paths:
        scene = Scene.of(report, result.source)
        if "png" in paths:
            draw(report, scene, paths["png"])
        if "html" in paths:
            paths["html"].write_text(_page_or_why_not(report, scene), encoding="utf-8")


def _page_or_why_not(report: Mapping[str, Any], scene: Scene) -> str:
    """The page; where it cannot be drawn, one that says so: a fault here must not cost what was measured."""
    try:
        return page(report, scene)
    except Exception:
        log.exception("the report's page could not be drawn: a bug in orthoscale; the JSON holds all figures")
        return "<!DOCTYPE html><title>orthoscale</title><p>This page could not be drawn; the JSON holds all figures.\n"


def redraw(path: Path, out: Path, images: Path | None = None, overwrite: bool = False) -> str:
    """Draw the page of the report.json at `path` to `out`, with pictures when its input is still there, unchanged.

    Returns why there are no pictures, or ''. Raises InputError for a file that is no report, and what `new_file` does.
    """
    check_free(out, overwrite)
    report = read_json(path)
    try:
        source, why = _source(report, path, images)
        html = page(report, Scene.of(report, source))
    except OrthoscaleError:
        raise
    except Exception as error:  # whatever values that do not fit together lead to
        raise InputError(
            f"{path}: a damaged report ({reason(error)})", "Make it again with `orthoscale fix`."
        ) from error
    with new_file(out, overwrite) as partial:
        partial.write_text(html, encoding="utf-8")
    return why


def _source(report: Mapping[str, Any], path: Path, images: Path | None) -> tuple[Source | None, str]:
    """The source that a report speaks of, or None and why it is not taken."""
    told = Path(report["input"]["path"])
    found = next((place for place in (told, path.parent / told) if is_there(place)), None)
    if found is None:
        return None, f"{told} is not there"
    if images is None and "images" in report["settings"]:
        images = Path(report["settings"]["images"])
    try:
        source = open_source(found, images if found.is_dir() else None, need_images=False)
    except OrthoscaleError as error:
        return None, error.message
    if source.content_hash() != report["input"]["sha256"]:
        return None, f"{found} has changed since"
    return source, ""
