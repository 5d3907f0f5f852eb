"""Detection in pictures of any size: in overlapping tiles, whose boxes are converted to the picture's own pixels."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import cv2
import numpy as np

from ..core.boxes import SAME_VEHICLE, Boxes, matched, suppress
from ..core.detections import Tile
from ..core.source import Picture
from ..system.budget import require
from ..system.threads import Threads
from .detector import CUT, CUT_OBJECT, OVERLAP, VEHICLES, Passes
from .filled import one_grey

TILE = 1024  # side of the network's input [px]
TILE_SIZE = 600  # [byte] of memory that a tile takes while it waits for its turn
# The coarser of the two passes is half an octave coarser: half the pixels, and mistakes look different.
CONFIRMING_ZOOM = float(1 / np.sqrt(2))
# Border around the boxes of the first pass that the second one sees [px of its input]: the rest of the vehicle, and as
# much again.
PART_BORDER = 96
PART_GRID = 128  # parts of a tile begin and end at multiples of this [px of the input]: few sizes, and whole strides

Detect = Callable[[np.ndarray], Boxes]


class AnyDetector(Protocol):
    """What can make the two passes over a tile: a `Detector`, or a `FunctionDetector`.

    passes : which network makes which pass. confirming : the finder, if `passes` need one. takes_parts : whether it
    detects the same in a part of an image as in the whole.
    """

    @property
    def passes(self) -> Passes: ...
    @property
    def confirming(self) -> AnyDetector | None: ...
    @property
    def takes_parts(self) -> bool: ...

    def see(self, image: np.ndarray) -> dict[str, Boxes]:
        """Boxes by kind in `image`, RGB uint8 (h, w, 3), before non-maximum suppression [px of the image]."""
        ...


@dataclass(frozen=True)
class FunctionDetector:
    """A detector from a function that knows vehicles only. confirming : makes the coarse pass instead."""

    detect: Detect
    confirming: AnyDetector | None = None

    @property
    def passes(self) -> Passes:
        """CONFIRMED if there is another one for the coarse pass, else FINE_FIRST."""
        return Passes.CONFIRMED if self.confirming else Passes.FINE_FIRST

    @property
    def takes_parts(self) -> bool:
        """No: nothing is known of the function."""
        return False

    def see(self, image: np.ndarray) -> dict[str, Boxes]:
        """See `AnyDetector.see`."""
        return {VEHICLES: self.detect(image)}


@dataclass(frozen=True)
class Looks:
    """Whole vehicles in one tile: those of the fine pass, at the tile's zoom, and those of the coarse pass, at
    CONFIRMING_ZOOM times that [px of the picture].

    objects : by kind, the whole objects of standard size that the fine and the coarse pass found.
    """

    fine: Boxes
    coarse: Boxes
    objects: dict[str, tuple[Boxes, Boxes]] = field(default_factory=dict)


def tiles(picture: Picture, zoom: float, tile: int = TILE, overlap: int = OVERLAP) -> list[Tile]:
    """Tiles that cover the picture at `zoom` (network pixels per picture pixel), each at most `tile` px wide."""
    columns = list(_spans(picture.width, zoom, tile, overlap))
    return [
        Tile(x, y, w, h, max(1, round(w * zoom)), max(1, round(h * zoom)))
        for y, h in _spans(picture.height, zoom, tile, overlap)
        for x, w in columns
    ]


def check_number(
    pictures: Sequence[Picture], zoom: float, tile: int = TILE, overlap: int = OVERLAP, lists: int = 1
) -> None:
    """Raise InputError if the `tiles` of all `pictures` together, held `lists` times, would exceed the memory
    budget."""
    if not pictures:
        return
    counts = [
        math.prod(_division(side, zoom, tile, overlap)[1] for side in (picture.width, picture.height))
        for picture in pictures
    ]
    largest = pictures[counts.index(max(counts))]
    what = f"{largest.name}, {largest.width} x {largest.height} px"
    if len(pictures) > 1:
        what = f"a set of {len(pictures):,} pictures, the largest of which is {what}"
    require(lists * sum(counts) * TILE_SIZE, f"{what}, at zoom {zoom:.2g}")


def _spans(size: int, zoom: float, tile: int, overlap: int) -> Iterator[tuple[int, int]]:
    """(start, length) pairs [px of the picture] that cover 0..size evenly; neighbours share `overlap` [px of the input]
    or more."""
    span, count = _division(size, zoom, tile, overlap)
    for k in range(count):
        yield round(k * (size - span) / max(count - 1, 1)), span


def _division(size: int, zoom: float, tile: int, overlap: int) -> tuple[int, int]:
    """Length of each span [px of the picture], and their number."""
    span, shared = min(size, max(1, int(tile / zoom))), int(np.ceil(overlap / zoom))
    if span >= size:
        return size, 1
    return span, int(np.ceil((size - shared) / max(span - shared, 1)))


def look(picture: Picture, tile: Tile, detect: Detect) -> Boxes:
    """Whole vehicles in one tile, in the picture's pixels. Boxes that the tile's edge may cut are left to the
    neighbouring tile (and dropped at the picture's edge, where no tile shows them whole)."""
    return place(detect(read(picture, tile)), tile)


def look_twice(picture: Picture, tile: Tile, detector: AnyDetector) -> Looks:
    """Two passes over one tile, whose pixels are read once. A tile of one grey (no data) is left out.

    Only what both passes show counts, and most of the area of many surveys is empty, so the second pass looks only
    around the boxes of the first. The detector's `passes` say which is the first, and which network makes each.
    """
    image = read(picture, tile)
    if one_grey(image):
        return Looks(Boxes.empty(), Boxes.empty())
    width, height = (max(1, round(side * CONFIRMING_ZOOM)) for side in (tile.out_width, tile.out_height))
    passes, finder = detector.passes, detector.confirming
    fine = _Pass(detector, image, tile.out_width, tile.out_height)
    coarse = _Pass(finder if finder and passes == Passes.CONFIRMED else detector, image, width, height)
    if passes == Passes.COARSE_FIRST:
        seen_coarsely = coarse.whole()
        seen_finely = fine.around(seen_coarsely, coarse)
    else:
        seen_finely = fine.whole()
        seen_coarsely = coarse.around(seen_finely, fine)
    if passes == Passes.TWICE_CONFIRMED and finder:
        by_finder = _Pass(finder, coarse.image, width, height).around(seen_coarsely, coarse)
        known, _, _ = matched(seen_coarsely[VEHICLES], by_finder[VEHICLES], SAME_VEHICLE)
        seen_coarsely[VEHICLES] = seen_coarsely[VEHICLES][known]
    coarse_tile = replace(tile, out_width=width, out_height=height)
    objects = {
        kind: (place(boxes, tile, CUT_OBJECT), place(seen_coarsely[kind], coarse_tile, CUT_OBJECT))
        for kind, boxes in seen_finely.items()
        if kind != VEHICLES and kind in seen_coarsely
    }
    return Looks(place(seen_finely[VEHICLES], tile), place(seen_coarsely[VEHICLES], coarse_tile), objects)


@dataclass(frozen=True)
class _Pass:
    """One pass over a tile.

    pixels : of the tile. width, height : of the image that the detector sees [px]. Boxes are by kind.
    """

    detector: AnyDetector
    pixels: np.ndarray
    width: int
    height: int

    @cached_property
    def image(self) -> np.ndarray:
        """What the detector sees; resampled on first use, since most second passes are not needed."""
        if self.pixels.shape[:2] == (self.height, self.width):
            return self.pixels
        return cv2.resize(self.pixels, (self.width, self.height), interpolation=cv2.INTER_AREA)

    def whole(self) -> dict[str, Boxes]:
        """Boxes in all of the image [px of the image]."""
        return self.detector.see(self.image)

    def around(self, seen: dict[str, Boxes], by: _Pass) -> dict[str, Boxes]:
        """Boxes around those that the pass `by` has `seen`; none if it saw none. A detector that may see less in a part
        of an image than in the whole gets all of it."""
        boxes = Boxes.concatenate(list(seen.values()))
        if not len(boxes):
            return {VEHICLES: boxes}
        if not self.detector.takes_parts:
            return self.whole()
        centre = (boxes.xylwa[:, :2] * (self.width / by.width)).clip(0, (self.width - 1, self.height - 1))
        x, y = (np.maximum(centre.min(0) - PART_BORDER, 0) // PART_GRID * PART_GRID).astype(int).tolist()
        right, bottom = (-(-(centre.max(0) + PART_BORDER) // PART_GRID) * PART_GRID).astype(int).tolist()
        part = self.image[y:bottom, x:right]
        return {
            kind: boxes[boxes.inside(part.shape[1], part.shape[0], CUT)].mapped(1, (x, y))
            for kind, boxes in self.detector.see(part).items()
        }


def read(picture: Picture, tile: Tile) -> np.ndarray:
    """The tile's pixels at its zoom: RGB uint8 (out_height, out_width, 3)."""
    return picture.read(tile.x, tile.y, tile.width, tile.height, tile.out_width, tile.out_height)


def place(boxes: Boxes, tile: Tile, border: float = CUT) -> Boxes:
    """`boxes` of a tile [px of the input] in pixels of its picture. Those nearer than `border` [px of the input] to the
    tile's edge are left out: they may be cut, and a neighbouring tile shows them whole."""
    whole = boxes[boxes.inside(tile.out_width, tile.out_height, border)]
    return whole.mapped(tile.width / tile.out_width, (tile.x, tile.y))


def one_pass(
    pictures: Iterable[Picture], zoom: float, detect: Detect, progress: Callable[[int, int], None] | None = None
) -> dict[str, Boxes]:
    """One detection pass: all whole vehicles of each picture, by its name, after non-maximum suppression.

    The next tile is read while the network works on this one. `progress(done, total)` counts tiles.
    """
    jobs = [(picture, tile) for picture in pictures for tile in tiles(picture, zoom)]
    found: dict[str, list[Boxes]] = {picture.name: [] for picture, _ in jobs}
    with Threads(1) as reader:
        ahead = deque(reader.submit(read, *job) for job in jobs[:1])
        for k, (picture, tile) in enumerate(jobs):
            image = ahead.popleft().result()
            ahead.extend(reader.submit(read, *job) for job in jobs[k + 1 : k + 2])
            found[picture.name].append(place(detect(image), tile))
            if progress:
                progress(k + 1, len(jobs))
    return {name: suppress(Boxes.concatenate(parts)) for name, parts in found.items()}
