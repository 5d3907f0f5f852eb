"""Reads and writes detections in the format given by the file's name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ...core.boxes import Boxes
from ...core.detections import Detections
from ...core.remarks import INFO, Remark
from ...core.source import Pictures
from ...errors import InputError, UsageError, shown
from ...system.outputs import Outputs
from ..names import in_utf8, json_in_utf8
from ..reading import LARGE, read_plain
from ..tables import known_objects
from . import coco, dota, geo, table
from .classes import plain
from .fitting import fitted, sizes_in
from .items import Item, boxes_by_picture, other_name, rectangles, sizes_of
from .own import WHAT, note, noted, of_document, save_detections

FORMATS = {
    ".json": "orthoscale's own (COCO too, when reading)",
    ".coco.json": "COCO",
    ".txt": "DOTA text",
    ".geojson": "GeoJSON",
    ".gpkg": "GeoPackage",
}
# Boxes that differ by more from their stated lengths are in a resampled picture. Hands that redraw boxes change their
# lengths by a few percent; less resampling changes little, since the boxes themselves follow the map.
RESAMPLED = 1.2
READABLE = {**FORMATS, ".txt": "DOTA or Ultralytics text", ".csv": "a table"}


def check_name(path: Path) -> None:
    """Raise UsageError if the ending of `path` is not that of a format that can be written here."""
    if path.suffix.lower() not in FORMATS:
        known = ", ".join(f"{suffix} ({what})" for suffix, what in FORMATS.items())
        raise UsageError(f"{path.name}: not an ending of a detections format", f"Known: {known}.")


def check_pictures(path: Path, source: Pictures) -> None:
    """Raise UsageError if the format that the ending of `path` names cannot hold the boxes of the pictures of `source`,
    by their names."""
    if path.suffix.lower() == ".txt":
        dota.names_in_text(source.picture_names, source.picture_names)


def output_of(outputs: Outputs, path: Path | None) -> Path | None:
    """The temporary path at which to write the boxes that are to be saved at `path`, which is added to `outputs`; None
    if none are to be saved. Raises UsageError, OutputError."""
    if path is None:
        return None
    check_name(path)
    return outputs.file(path)


def save(found: Detections, path: Path, source: Pictures) -> None:
    """Write `found` to `path` in the format of its ending, with the sizes of its pictures. Raises UsageError.

    From all formats but DOTA's text, `load` restores everything that was saved, to the digits written. DOTA's text has
    only the vehicles' corners, scores and pictures: no zoom, ruler, sigmas, kinds, boxes that do not count, objects,
    ground pictures or sizes.
    """
    check_name(path)
    suffix = path.suffix.lower()
    found = found.made_on(source).renamed(in_utf8)
    if suffix == ".txt":
        dota.write(path, found.boxes, [in_utf8(name) for name in source.picture_names])
    elif suffix == ".gpkg":
        geo.write_geopackage(path, found.boxes, _place(source), note(found))
    elif suffix == ".geojson":
        _write(geo.geojson(found.boxes, _place(source), note(found)), path)
    elif path.name.lower().endswith(".coco.json"):
        # COCO has a place of its own for the sizes.
        _write(coco.document(found.boxes, found.sizes, note(replace(found, sizes={}))), path)
    else:
        save_detections(found, path)


def load(path: Path, source: Pictures, vehicle_classes: Sequence[str] = (), alone: bool = True) -> Detections:
    """The vehicles in the pictures of `source`, from a file or from a folder of DOTA's or Ultralytics' labels.

    vehicle_classes : names or numbers of the classes that count, instead of those called small vehicles. alone :
    whether the file is for this source only. Standard objects (tennis courts ...) become `Detections.objects`. Boxes
    from other programs have no known ruler: they get that of an unmeasured detector. Boxes that repeat a vehicle are
    left out. If file and source have a single picture each, the names need not agree, with a note, if it is `alone`.
    Raises InputError, also for boxes that were made on a picture of another size, where the file tells.
    """
    content = _content(path, source)
    if isinstance(content, Detections):
        return _of_own_document(content, source, path, alone)
    items, own_sizes = content.items, sizes_in(source)
    if any(item.relative for item in items):
        items = _of_vehicles(items, vehicle_classes, path)
    other = other_name([item.picture for item in items], source.picture_names) if alone else None
    if other is not None:
        (name,) = source.picture_names
        items = [replace(item, picture=name) for item in items]
    boxes = boxes_by_picture(items, source.picture_names, vehicle_classes, str(path), own_sizes)
    found = noted(boxes, content.note, f"boxes of {path.name}", str(path))
    if not found.objects:
        found = replace(found, objects=_objects(items, own_sizes, path))
    if content.note is not None:
        _check_resampled(items, path)
    found = replace(found, sizes={**found.sizes, **content.sizes})
    if other is not None:
        found = found.renamed(lambda picture: name if picture == other else picture)
    if any(item.on_map for item in items):
        found = _on_this_map(found, source, path)
    return fitted(found, source, path, other)


class _Content(NamedTuple):
    """What a file of another format than our own has. note : that of `own.note`, if we wrote the file. sizes : width
    and height of its pictures [px], by its names for them."""

    items: list[Item]
    note: Mapping[str, Any] | None = None
    sizes: Mapping[str, tuple[int, int]] = MappingProxyType({})


def _content(path: Path, source: Pictures) -> _Content | Detections:
    """What the file or folder at `path` has; of one in our own format, the detections. Raises InputError."""
    suffix = path.suffix.lower()
    if path.is_dir() or suffix == ".txt":
        return _Content(dota.read(path, only_picture=len(source.picture_names) == 1 and not path.is_dir()))
    if suffix == ".csv":
        return _Content(table.read(path))
    if suffix == ".gpkg":
        return _Content(*geo.read_geopackage(path, _place(source)))
    text = read_plain(path, WHAT, f"Detections end in {', '.join(READABLE)}.", LARGE)
    if geo.is_geojson(text):
        return _Content(geo.read_geojson(text, str(path), _place(source)), text.get("orthoscale"))
    if coco.is_coco(text):
        items, sizes = coco.read(text, str(path))
        return _Content(items, (text.get("info") or {}).get("orthoscale") if isinstance(text, dict) else None, sizes)
    return of_document(text, path)


def _of_own_document(found: Detections, source: Pictures, path: Path, alone: bool) -> Detections:
    """The vehicles in the pictures of `source`, from a file in our own format. Raises InputError."""
    other = None
    if alone and len(found) and found.planar is None:
        other = other_name(found.pictures, source.picture_names)
    if other is not None:
        found = found.renamed(lambda name: source.picture_names[0])
    return fitted(found, source, path, other)


def _check_resampled(items: Sequence[Item], path: Path) -> None:
    """Raise InputError if `items`, which we saved in coordinates of a map, are longer or shorter now, in pixels: the
    picture was resampled, and the resampling factor and sigmas in the file are of other pixels."""
    lengths = rectangles([item.polygon for item in items])[:, 2] / [item.length_px for item in items]
    lengths = lengths[np.isfinite(lengths) & (lengths > 0)]
    if len(lengths) and abs(np.log(ratio := float(np.median(lengths)))) > np.log(RESAMPLED):
        raise InputError(
            f"{path}: its boxes are {ratio:.3g} times as long in this picture as in the one they were made on [px]",
            "The picture was resampled: give the original, or detect anew.",
        )


def _on_this_map(found: Detections, source: Pictures, path: Path) -> Detections:
    """`found`, whose vehicles have coordinates on a map, which fit other cuts of the same picture too. What a file has
    besides, in pixels, fits only the picture it was made on, and is left out of others, with a note."""
    if all(size == source.image_size(name) for name, size in sizes_of(found.sizes, source.picture_names)):
        return found
    if found.doubtful or found.set_aside or found.objects:
        text = "was made on another cut of this picture: its vehicles count, but not what else was found there"
        source.notes.append(Remark(INFO, f"{path} {text}"))
    return replace(found, doubtful={}, set_aside={}, objects={}, sizes={})


def _of_vehicles(items: Sequence[Item], vehicle_classes: Sequence[str], path: Path) -> list[Item]:
    """The items to use from a format whose classes have numbers but no names: all, their labels removed unless the user
    wants certain classes. Raises InputError if there are several classes and the user chose none."""
    numbers = sorted({item.label for item in items if item.label is not None}, key=int)
    if not vehicle_classes and len(numbers) > 1:
        raise InputError(
            f"{path}: its classes have numbers and no names ({shown(', '.join(numbers), 200)})",
            f"Name the class of small vehicles: --vehicle-class {numbers[0]}, for instance.",
        )
    return list(items) if vehicle_classes else [replace(item, label=None) for item in items]


def _objects(items: Sequence[Item], sizes: Mapping[str, tuple[int, int]], path: Path) -> dict[str, dict[str, Boxes]]:
    """Boxes of standard objects among `items`, by picture and class."""
    objects: dict[str, dict[str, Boxes]] = {}
    for kind in known_objects():
        those = [item for item in items if plain(item.label or "") == plain(kind)]
        for name, boxes in boxes_by_picture(those, list(sizes), [kind], str(path), sizes).items():
            objects.setdefault(name, {})[kind] = boxes
    return objects


def _write(text: Any, path: Path) -> None:
    path.write_text(json_in_utf8(text) + "\n", encoding="utf-8")


def _place(source: Pictures) -> geo.Georeference | None:
    return None if source.claimed is None else geo.Georeference.of(source.claimed)
