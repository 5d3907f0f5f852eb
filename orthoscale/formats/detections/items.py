"""The common form of all formats of detections: named polygons in pixels, and their conversion to boxes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

import cv2
import numpy as np

from ...core.boxes import KINDS, Boxes
from ...errors import InputError, shown
from ..names import composed, in_utf8
from .classes import is_vehicle

FARTHEST_PX = 1e7  # largest plausible coordinate of a vertex [px]
# Names that programs give to these properties of a box; the first that is present counts.
PICTURE = ("picture", "image", "file_name", "filename")
SCORE_NAMES = ("score", "confidence", "conf", "probability")
CLASS = ("class", "label", "category", "class_name", "name", "kind")
UNKNOWN = (None,) * len(KINDS)
LABEL = "small-vehicle"  # class of our own boxes in the formats of others; DOTA's name


@dataclass(frozen=True)
class Item:
    """One detection as a file has it.

    polygon : (K, 2) vertices [px of the picture]. picture : its name, None where the file has none. label : class
    name, None where the file has none; such boxes count as vehicles. sigma, kinds : as in `Boxes`, None where unknown.
    relative : the polygon's coordinates are shares of the picture's width and height instead of pixels.
    on_map : the polygon comes from coordinates on a map. length_px : the length that the file states for it [px of the
    picture it was made on], NaN where it states none.
    """

    polygon: np.ndarray
    score: float = 1.0
    label: str | None = None
    picture: str | None = None
    sigma: tuple[float | None, float | None] = (None, None)
    kinds: Sequence[float | None] | None = None
    relative: bool = False
    on_map: bool = False
    length_px: float = float("nan")


def rectangles(polygons: Sequence[np.ndarray]) -> np.ndarray:
    """(N, 5) centre x, y, length, width, angle of the rectangles that polygons (K, 2 each) stand for.

    Four corners in order give the mean of opposite sides, because the smallest rectangle around hand-drawn corners is
    always too large. Anything else gives the smallest rectangle around it; NaN if a vertex is not finite or too far.
    """
    out = np.full((len(polygons), 5), np.nan)
    opened = [p[:-1] if len(p) > 1 and (p[0] == p[-1]).all() else p for p in (np.asarray(p, float) for p in polygons)]
    four = np.array([len(p) == 4 for p in opened], bool)
    if four.any():
        corners = np.stack([p for p in opened if len(p) == 4])
        out[four] = np.where((np.abs(corners) < FARTHEST_PX).all((1, 2))[:, None], _of_corners(corners), np.nan)
    for k in np.flatnonzero(np.isnan(out).any(1)):
        p = opened[k]
        if (np.abs(p) < FARTHEST_PX).all():  # OpenCV takes single precision only
            centre = p.mean(0)
            (x, y), (w, h), degrees = cv2.minAreaRect((p - centre).astype(np.float32))
            out[k] = x + centre[0], y + centre[1], w, h, np.radians(degrees)
    return out


def _of_corners(p: np.ndarray) -> np.ndarray:
    """(N, 5) rectangles of four corners (N, 4, 2); NaN where these are not in order, or far from a rectangle."""
    with np.errstate(invalid="ignore", over="ignore"):
        sides = np.roll(p, -1, axis=1) - p  # opposite ones are antiparallel
        first, second = (sides[:, 0] - sides[:, 2]) / 2, (sides[:, 1] - sides[:, 3]) / 2
        lengths = np.linalg.norm(sides, axis=2)
        extent = (lengths[:, :2] + lengths[:, 2:]) / 2
        area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        axis = np.where((extent[:, 0] >= extent[:, 1])[:, None], first, second)
        angle = np.arctan2(axis[:, 1], axis[:, 0])
        found = np.column_stack([p.mean(1), extent.max(1), extent.min(1), angle])
        return np.where((area > 0.8 * extent[:, 0] * extent[:, 1])[:, None], found, np.nan)


def boxes_by_picture(
    items: Sequence[Item],
    pictures: Sequence[str],
    vehicle_classes: Sequence[str],
    origin: str,
    sizes: Mapping[str, tuple[int, int]],
) -> dict[str, Boxes]:
    """Boxes of the vehicles among `items`, by the source's names of its `pictures`.

    sizes : (width, height) of the pictures, for items that are `relative` to them. A picture's name in an item may lack
    its suffix or its folder, as in DOTA and COCO, if it is still unique, and have its letters `composed` or not; names
    unknown to the source stay as they are.
    Raises InputError if no item is a vehicle, or the picture of an item is ambiguous; `origin` names the file. That the
    boxes are plausible is checked by `files.load`.
    """
    labels = {item.label for item in items if item.label is not None}
    counted = [item for item in items if item.label is None or is_vehicle(item.label, vehicle_classes)]
    if items and not counted:
        wanted = f"called {' or '.join(vehicle_classes)}" if vehicle_classes else "whose name means small vehicles"
        listed = shown(", ".join(sorted(labels)), 300)
        raise InputError(
            f"{origin}: {len(items)} boxes, none of a class {wanted}; its classes are {listed}",
            "Name the right one by --vehicle-class.",
        )
    names = _names(pictures)
    rows: dict[str, list[np.ndarray]] = {}
    rest: dict[str, list[tuple]] = {}
    for item in counted:
        name = _resolved(item.picture, pictures, names, origin)
        polygon = item.polygon * sizes.get(name, (1, 1)) if item.relative else item.polygon
        rows.setdefault(name, []).append(polygon)
        rest.setdefault(name, []).append((item.score, *item.sigma, *(item.kinds or UNKNOWN)))
    found = {}
    for name in rows:
        score, sigma, kinds = np.split(np.array(rest[name], float), [1, 3], axis=1)
        found[name] = Boxes(rectangles(rows[name]), score, sigma, kinds)
    return found


def other_name(named: Collection[str | None], pictures: Sequence[str]) -> str | None:
    """The boxes' name for their only picture, if the source has a single picture of another name; else None. named :
    the pictures of all boxes."""
    if len(pictures) != 1 or len(set(named)) != 1:
        return None
    (name,) = set(named)
    return None if name is None or _known(name, _names(pictures))[0] else name


def sizes_of(told: Mapping[str, tuple[int, int]], pictures: Sequence[str]) -> list[tuple[str, tuple[int, int]]]:
    """The source's name and the size of each of `pictures` in a file that has these by its own names (`told`)."""
    names = _names(pictures)
    found = [(_known(name, names)[1], size) for name, size in told.items()]
    return [(picture, size) for picture, size in found if picture is not None]


def first(properties: Mapping[Any, Any], names: Sequence[str]) -> Any:
    """The value of the first of a box's properties that is called one of `names` and is not None; None without one."""
    return next((properties[name] for name in names if properties.get(name) is not None), None)


def short_name(picture: str, pictures: Sequence[str]) -> str:
    """A picture's name without its suffix, as in DOTA, unless another picture has the same; then its full name."""
    short = str(PurePosixPath(picture).with_suffix(""))
    shared = sum(str(PurePosixPath(p).with_suffix("")) == short for p in pictures) > 1
    return picture if shared else short


def _names(pictures: Sequence[str]) -> dict[str, str | None]:
    """The picture meant by each name, `composed`, that files may use for it, with slashes or backslashes between
    folders; None where it is ambiguous. And by each picture's own name, as it is."""
    names: dict[str, str | None] = {}
    for picture in pictures:
        path = PureWindowsPath(picture)
        whole = {picture, path.as_posix(), str(PurePosixPath(picture).with_suffix(""))}
        for name in {composed(each) for each in (*whole, (path.parent / path.stem).as_posix(), path.name, path.stem)}:
            names[name] = None if name in names else picture
    return {**names, **{in_utf8(p): p for p in pictures}, **{p: p for p in pictures}}


def _known(name: str, names: Mapping[str, str | None]) -> tuple[bool, str | None]:
    """Whether the source has a picture of that name (see `_names`), and which; None where it is ambiguous."""
    key = name if name in names else composed(name)
    return key in names, names.get(key)


def _resolved(name: str | None, pictures: Sequence[str], names: dict[str, str | None], origin: str) -> str:
    if name is not None:
        known, picture = _known(name, names)
        if known and picture is None:
            raise InputError(f"{origin}: several pictures are called {name!r}", "Write their names with the folder.")
        return picture or name  # or one that the source does not have
    if len(pictures) == 1:
        return pictures[0]
    raise InputError(
        f"{origin}: a box names no picture, but there are {len(pictures)} pictures",
        f"Name the picture of each, {pictures[0]!r} for instance.",
    )
