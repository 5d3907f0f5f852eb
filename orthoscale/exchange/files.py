"""Detections in and out, by what the file's name ends in."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..boxes import Boxes
from ..detect.classes import plain
from ..detections import Detections
from ..errors import InputError, UsageError
from ..evidence.objects import known_objects
from ..sources.source import Pictures
from . import coco, dota, geo
from .items import Item, boxes_by_picture

FORMATS = {
    ".json": "orthoscale's own (COCO too, when reading)",
    ".coco.json": "COCO",
    ".txt": "DOTA text",
    ".geojson": "GeoJSON",
    ".gpkg": "GeoPackage",
}


def check_name(path: Path) -> None:
    """Raises UsageError for a file name that says no format, or one that cannot be written here."""
    if path.suffix.lower() not in FORMATS:
        known = ", ".join(f"{suffix} ({what})" for suffix, what in FORMATS.items())
        raise UsageError(f"{path.name}: no format of detections ends like this", f"Known: {known}.")


def save(found: Detections, path: Path, source: Pictures) -> None:
    """Write `found` to `path` in the format that its name says. Raises UsageError.

    All but DOTA's text also keep the zoom and the ruler, so that `load` gives back what was saved.
    """
    check_name(path)
    suffix = path.suffix.lower()
    if suffix == ".txt":
        dota.write(path, found.boxes, source.picture_names)
    elif suffix == ".gpkg":
        geo.write_geopackage(path, found.boxes, _place(source), found.about())
    elif suffix == ".geojson":
        _write(geo.geojson(found.boxes, _place(source), found.about()), path)
    elif path.name.lower().endswith(".coco.json"):
        _write(coco.document(found.boxes, _sizes(source), found.about()), path)
    else:
        found.save(path)


def load(path: Path, source: Pictures, vehicle_classes: Sequence[str] = ()) -> Detections:
    """The vehicles that a file, or a folder of DOTA labels, has of the pictures of `source`.

    vehicle_classes : names of the classes that count, instead of those called small vehicles. Standard objects (tennis
    courts ...) come along as `Detections.objects`. Boxes of others have no ruler: theirs is one that nobody has
    measured. Raises InputError.
    """
    suffix = path.suffix.lower()
    about: Mapping[str, Any] | None = None
    sizes: dict[str, tuple[int, int]] = {}
    items: list[Item]
    if path.is_dir() or suffix == ".txt":
        items = dota.read(path, only_picture=len(source.picture_names) == 1 and not path.is_dir())
    elif suffix == ".gpkg":
        if not path.is_file():
            raise InputError(f"{path}: cannot be read (no such file)", "Give a detections file.")
        items, about = geo.read_geopackage(path, _place(source))
    else:
        text = _json(path)
        if geo.is_geojson(text):
            items, about = geo.read_geojson(text, str(path), _place(source)), text.get("orthoscale")
        elif coco.is_coco(text):
            items, sizes = coco.read(text, str(path))
            about = text.get("info", {}).get("orthoscale") if isinstance(text, dict) else None
        else:
            return _checked(Detections.load(path), source, path)
    boxes = boxes_by_picture(items, source.picture_names, vehicle_classes, str(path))
    found = Detections.of(boxes, about, f"boxes of {path.name}", str(path))
    found = replace(found, objects=_objects(items, source, path))
    _check_sizes(sizes, source, path)
    return _checked(found, source, path)


def _objects(items: Sequence[Item], source: Pictures, path: Path) -> dict[str, dict[str, Boxes]]:
    """Boxes of standard objects among `items`, by picture and class."""
    objects: dict[str, dict[str, Boxes]] = {}
    for kind in known_objects():
        those = [item for item in items if plain(item.label or "") == plain(kind)]
        for name, boxes in boxes_by_picture(those, source.picture_names, [kind], str(path)).items():
            objects.setdefault(name, {})[kind] = boxes
    return objects


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})", "Give a detections file.") from error
    except ValueError as error:
        raise InputError(
            f"{path}: not a detections file ({error})", f"Detections end in {', '.join(FORMATS)}."
        ) from error


def _write(text: Any, path: Path) -> None:
    path.write_text(json.dumps(text) + "\n", encoding="utf-8")


def _place(source: Pictures) -> geo.Place | None:
    return geo.Place.of(source.path) if source.unit == "m/px" else None


def _sizes(source: Pictures) -> dict[str, tuple[int, int]]:
    return {p.name: (p.width, p.height) for p in source.pictures}


def _check_sizes(sizes: Mapping[str, tuple[int, int]], source: Pictures, path: Path) -> None:
    for name, size in _sizes(source).items():
        if sizes.get(name, size) not in (size, (0, 0)):
            raise InputError(
                f"{path}: its {name} has {sizes[name][0]} x {sizes[name][1]} px, the source's {size[0]} x {size[1]}",
                "Give detections made on this very picture; boxes of another size measure another scale.",
            )


def _checked(found: Detections, source: Pictures, path: Path) -> Detections:
    """`found` without pictures that `source` does not have, those of a workspace's other models.

    Raises InputError where it has none of them, or boxes outside of them.
    """
    known = source.picture_names
    strangers = [name for name in found.boxes if name not in set(known)]
    if strangers and len(strangers) == len(found.boxes):
        raise InputError(
            f"{path}: {len(strangers)} of its {len(found.boxes)} pictures are not in {source.path}, "
            f"the first is {strangers[0]!r}",
            f"The source has pictures like {known[0]!r}: give the detections that were made on it.",
        )
    if strangers:
        note = f"{path}: {len(strangers)} of its pictures are not in this model, the first is {strangers[0]}"
        source.notes.append(note)
        found = replace(found, boxes={name: boxes for name, boxes in found.boxes.items() if name not in strangers})
    for name, size in _sizes(source).items():
        boxes = found.boxes.get(name, Boxes.empty())
        outside = ((boxes.centre < 0) | (boxes.centre > np.array(size))).any(1)
        if outside.any():
            x, y = boxes.centre[outside][0]
            raise InputError(
                f"{path}: {int(outside.sum())} of {len(boxes)} boxes lie outside of {name} ({size[0]} x {size[1]} px), "
                f"the first at x {x:.6g}, y {y:.6g}",
                "Give detections made on this very picture, in its pixels or its coordinates.",
            )
    return found
