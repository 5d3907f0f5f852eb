"""Fits boxes from a file to the pictures of a source, or says why they are not of these."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...core.boxes import Boxes, distinct
from ...core.detections import Detections
from ...core.remarks import CAUTION, INFO, Remark
from ...core.source import Pictures
from ...errors import InputError, shown
from ..names import composed, in_utf8
from .items import sizes_of


def sizes_in(source: Pictures) -> dict[str, tuple[int, int]]:
    """Width and height of each picture of `source` [px], by its name."""
    return {name: source.image_size(name) for name in source.picture_names}


def fitted(found: Detections, source: Pictures, path: Path, other: str | None) -> Detections:
    """`found` without pictures that `source` does not have (as of a workspace's other models), and without boxes that
    repeat another. other : the file's name for the single picture, if it differs from the source's.

    Raises InputError if `found` has none of the source's pictures, boxes outside of them, or impossible boxes.
    """
    sizes = sizes_in(source)
    _check_sizes(sizes_of(found.sizes, source.picture_names), sizes, path)
    found = _in_source(_named_as_in(sizes, found), source, path)
    _check_boxes(found, sizes, path)
    _check_places(found.boxes, sizes, path, other)
    if other is not None:
        text = f"{path}: its boxes are of {shown(other)!r}, and were taken for those of {shown(next(iter(sizes)))!r}"
        source.notes.append(Remark(CAUTION, text))
    single = _without_copies(found, path)
    if copies := len(found) - len(single):
        text = f"{path}: {copies} of its {len(found)} boxes repeat the vehicle of another and were left out"
        source.notes.append(Remark(INFO, text))
    return single


def _check_sizes(told: Sequence[tuple[str, tuple[int, int]]], sizes: Mapping[str, tuple[int, int]], path: Path) -> None:
    for name, (width, height) in told:
        if (width, height) not in (sizes[name], (0, 0)):
            raise InputError(
                f"{path}: its {name} has {width} x {height} px, the source's {sizes[name][0]} x {sizes[name][1]}",
                "Give detections made on this picture at this size; boxes of another size measure another scale.",
            )


def _named_as_in(names: Collection[str], found: Detections) -> Detections:
    """`found` with the source's own `names` for pictures whose names are written in another way: escaped as in UTF-8,
    or of other Unicode characters that look the same."""
    exact = {in_utf8(name): name for name in names}
    found = found.renamed(lambda name: exact.get(name, name))
    forms = Counter(map(composed, found.boxes))  # a file with both forms of a name means two pictures
    alike = _by_composed([name for name in names if forms[composed(name)] < 2])
    return found.renamed(lambda name: name if name in names else alike.get(composed(name), name))


def _by_composed(names: Sequence[str]) -> dict[str, str]:
    """`names` by their `composed` form; without those that differ only by it."""
    forms = [composed(name) for name in names]
    count = Counter(forms)
    return {form: name for form, name in zip(forms, names, strict=True) if count[form] == 1}


def _in_source(found: Detections, source: Pictures, path: Path) -> Detections:
    """`found` in the pictures that `source` has, with a caution if there are others. Raises InputError if it has none
    of them."""
    known = dict.fromkeys(source.picture_names)
    strangers = [name for name in found.boxes if name not in known]
    if strangers and len(strangers) == len(found.boxes):
        of = f"none of its {len(strangers)} pictures is" if len(strangers) > 1 else "its only picture is not"
        raise InputError(
            f"{path}: {of} in {source.path}{', the first is' if len(strangers) > 1 else ':'} {shown(strangers[0])!r}",
            f"The source has pictures like {next(iter(known))!r}: give the detections that were made on it.",
        )
    if strangers:
        note = f"{path}: {len(strangers)} of its pictures are not in this model, the first is {shown(strangers[0])}"
        source.notes.append(Remark(CAUTION, note))
    return found.only_in(known)


def _check_boxes(found: Detections, sizes: Mapping[str, tuple[int, int]], path: Path) -> None:
    """Raise InputError for impossible boxes, whatever format they came in."""
    if found.planar is not None:
        _check_boxes(found.planar, {}, path)  # in ground pictures, whose sizes are not in the file
    every = (found.boxes, found.doubtful, *found.set_aside.values())
    parts = [part for some in every for part in some.items()]
    parts += [(name, boxes) for name, kinds in found.objects.items() for boxes in kinds.values()]
    for name, boxes in parts:
        if fault := boxes.fault(*sizes.get(name, (np.inf, np.inf))):
            raise InputError(f"{path}: box {fault[0] + 1} of {shown(name)} {fault[1]}", "Remove it or correct it.")


def _check_places(
    found: Mapping[str, Boxes], sizes: Mapping[str, tuple[int, int]], path: Path, other: str | None
) -> None:
    """Raise InputError for boxes whose centre lies outside of their picture; `other` as for `fitted`."""
    for name, size in sizes.items():
        boxes = found.get(name, Boxes.empty())
        outside = ((boxes.centre < 0) | (boxes.centre > np.array(size))).any(1)
        if outside.any():
            x, y = boxes.centre[outside][0]
            of = "" if other is None else f" of {shown(other)!r}"
            raise InputError(
                f"{path}: {int(outside.sum())} of {len(boxes)} boxes{of} lie outside of {name} "
                f"({size[0]} x {size[1]} px), the first at x {x:.6g}, y {y:.6g}",
                "Give detections made on this picture, in its pixels or its coordinates.",
            )


def _without_copies(found: Detections, path: Path) -> Detections:
    """`found` with one box for each vehicle, in ground pictures too. Raises InputError for heaps of boxes."""
    try:
        single = {name: distinct(boxes) for name, boxes in found.boxes.items()}
    except ValueError as error:
        raise InputError(f"{path}: {error}", "Give detections with one box for each vehicle.") from error
    return replace(found, boxes=single, planar=None if found.planar is None else _without_copies(found.planar, path))
