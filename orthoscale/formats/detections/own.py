"""orthoscale's own JSON of detections, which files of other formats also carry as a note."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.boxes import KINDS, Boxes
from ...core.detections import UNKNOWN_HEIGHT, UNKNOWN_RULER, Detections
from ...errors import UsageError
from ...system.paths import path_of
from ..names import json_in_utf8
from ..reading import LARGE, checked, read_plain
from ..tables import known_objects

if TYPE_CHECKING:
    from ..schemas.detections import BoxEntry, DetectionsEntry, NoteEntry

FIELDS = ("cx", "cy", "length", "width", "angle")
WHAT = "a detections file"
BOXES_HINT = 'Expected {"picture name": [{"cx", "cy", "length", "width", "angle", "score"}]} in pixels and radians.'


def save_detections(found: Detections, path: str | Path) -> None:
    """Write as JSON: ``pictures: {name: [{cx, cy, length, width, angle, score}]}`` in pixels and radians; names that
    are not UTF-8 are escaped by `in_utf8`.

    Raises UsageError if `path` is no path or has another ending (the other formats need the pictures too, see
    `files.save`); OSError.
    """
    path = path_of(path, f"the path of {WHAT}")
    if path.suffix.lower() != ".json" or path.name.lower().endswith(".coco.json"):
        raise UsageError(
            f"{path}: boxes are written as JSON here", "Choose a name that ends in .json, not in .coco.json."
        )
    path.write_text(json_in_utf8(_document(found), indent=0))


def load_detections(path: str | Path) -> Detections:
    """Read what `save_detections` wrote, or a plain ``{name: [box, ...]}``. Raises InputError; UsageError if `path` is
    no path."""
    path = path_of(path, f"the path of {WHAT}")
    return of_document(read_plain(path, WHAT, BOXES_HINT, LARGE), path)


def of_document(text: Any, path: Path) -> Detections:
    """The same from `text`, the plain values in the file `path`. Raises InputError."""
    from ..schemas.detections import BoxesByPicture, DetectionsEntry

    name = f"boxes of {path.name}"
    if not (isinstance(text, dict) and "pictures" in text):
        pictures = checked(text, BoxesByPicture, str(path), WHAT, BOXES_HINT)
        return replace(noted(_vehicles(pictures), None, name, str(path)), objects=_objects(pictures))
    return _whole(checked(text, DetectionsEntry, str(path), WHAT, BOXES_HINT), name)


def about(found: Detections) -> dict[str, Any]:
    """All that is needed to measure with the boxes, as plain values."""
    return {
        "detector": found.detector,
        "detector_sha256": found.detector_sha256,
        "zoom": found.zoom,
        "effective_height": list(found.effective_height),
        "undercut": list(found.undercut),
        "body": found.body,
        "ruler": asdict(found.ruler),
    }


def note(found: Detections) -> dict[str, Any]:
    """What a file of another format keeps besides the vehicles' boxes, so that `noted` can restore everything: `about`,
    the boxes that do not count, the objects, `planar` and the pictures' sizes, as plain values."""
    objects = {name: rows for name in found.objects if (rows := _object_rows(found, name))}
    return {**about(found), **_rest(found), **({"objects": objects} if objects else {})}


def noted(boxes: dict[str, Boxes], note: Mapping[str, Any] | None, name: str, origin: str) -> Detections:
    """Boxes from a file, with the `note` in it; without a note they get the unknown ruler of an unmeasured detector
    called `name`. Raises InputError, which calls the file `origin`."""
    if note is None:
        return Detections(boxes, 1.0, UNKNOWN_RULER, UNKNOWN_HEIGHT, name)
    from ..schemas.detections import NoteEntry

    return _of_entry(boxes, checked(note, NoteEntry, origin, WHAT, "Save the detections again."), name)


def _of_entry(boxes: dict[str, Boxes], entry: NoteEntry, name: str) -> Detections:
    from msgspec import UNSET

    return Detections(
        boxes=boxes,
        zoom=entry.zoom,
        ruler=UNKNOWN_RULER if entry.ruler is UNSET else entry.ruler.ruler,
        effective_height=entry.effective_height,
        undercut=entry.undercut,
        detector=name if entry.detector is UNSET else entry.detector,
        detector_sha256=entry.detector_sha256,
        doubtful=_vehicles(entry.doubtful),
        objects=_objects(entry.objects),
        planar=None if entry.planar is None else _whole(entry.planar, name),
        body=entry.body,
        set_aside={why: _vehicles(pictures) for why, pictures in entry.set_aside.items()},
        sizes=entry.picture_sizes,
        zoom_given=entry.zoom_given,
    )


def _whole(text: DetectionsEntry, name: str) -> Detections:
    return replace(_of_entry(_vehicles(text.pictures), text, name), objects=_objects(text.pictures))


def _document(found: Detections) -> dict[str, Any]:
    names = dict.fromkeys([*found.boxes, *found.objects])
    pictures = {name: _rows(found.boxes.get(name, Boxes.empty())) + _object_rows(found, name) for name in names}
    return {**about(found), **_rest(found), "pictures": pictures}


def _rest(found: Detections) -> dict[str, Any]:
    rest: dict[str, Any] = {}
    if found.doubtful:
        rest["doubtful"] = _pictures(found.doubtful)
    if found.set_aside:
        rest["set_aside"] = {why: _pictures(boxes) for why, boxes in found.set_aside.items()}
    if found.planar is not None:
        rest["planar"] = _document(found.planar)
    if found.sizes:
        rest["picture_sizes"] = {name: list(size) for name, size in found.sizes.items()}
    if found.zoom_given:
        rest["zoom_given"] = True
    return rest


def _pictures(boxes: Mapping[str, Boxes]) -> dict[str, list[dict[str, Any]]]:
    return {name: _rows(some) for name, some in boxes.items()}


def _object_rows(found: Detections, name: str) -> list[dict[str, Any]]:
    others = found.objects.get(name, {})
    return [{**row, "kind": kind} for kind, boxes in others.items() for row in _rows(boxes)]


def _vehicles(pictures: Mapping[str, Sequence[BoxEntry]]) -> dict[str, Boxes]:
    return {name: _boxes(rows) for name, rows in pictures.items()}


def _objects(pictures: Mapping[str, Sequence[BoxEntry]]) -> dict[str, dict[str, Boxes]]:
    """Boxes of standard objects, by picture and kind."""
    objects = {}
    for name, rows in pictures.items():
        kinds = {row.kind for row in rows} & set(known_objects())
        if kinds:
            objects[name] = {kind: _boxes(rows, kind) for kind in sorted(kinds)}
    return objects


def _rows(boxes: Boxes) -> list[dict[str, Any]]:
    rows = []
    for row, score, more in zip(boxes.xylwa, boxes.score, measured_notes(boxes), strict=True):
        plain = {k: round(float(v), 4 if k == "angle" else 2) for k, v in zip(FIELDS, row, strict=True)}
        rows.append({**plain, "score": round(float(score), 3), **more})
    return rows


def measured_notes(boxes: Boxes) -> list[dict[str, list[float | None]]]:
    """For each box, what a file says about its sigma and kinds; empty where they are not known."""
    notes: list[dict[str, list[float | None]]] = []
    for sigma, kinds in zip(boxes.sigma.tolist(), boxes.kinds.tolist(), strict=True):
        known = {} if np.isnan(sigma).all() else {"sigma": [round(v, 5) if np.isfinite(v) else None for v in sigma]}
        notes.append(known | ({} if np.isnan(kinds).any() else {"kinds": [round(v, 3) for v in kinds]}))
    return notes


def _boxes(rows: Sequence[BoxEntry], kind: str = "vehicle") -> Boxes:
    rows = [row for row in rows if row.kind == kind]
    xylwa = np.array([[getattr(row, k) for k in FIELDS] for row in rows], float).reshape(-1, 5)
    sigma = np.array([row.sigma for row in rows], float).reshape(-1, 2)  # None becomes NaN
    kinds = np.array([row.kinds or (None,) * len(KINDS) for row in rows], float).reshape(-1, len(KINDS))
    return Boxes(xylwa, np.array([row.score for row in rows], float), sigma, kinds)
