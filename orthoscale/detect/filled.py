"""Where a large picture shows anything: much of a mosaic of a corridor, or of one flown block, is empty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable
from weakref import WeakKeyDictionary

import numpy as np

from ..core.detections import Tile
from ..core.source import Picture
from .order import GOLDEN

# Chosen by eye: a patch for each block that GDAL would decode anyway; a picture of 12000 x 9000 px takes a second.
CELLS_ACROSS = 64  # at most, along the longer side of the picture
LEAST_CELL = 256  # least side of a cell [px], the usual block of a GeoTIFF
PATCH_SIDE = 32  # of the part of a cell that is looked at [px]; at any scale the ground has several colours in it
FIRST_EVERY = 3  # at first only every third cell across and down is looked at
# Share of empty ones among these, from which all cells are looked at. With fewer, hardly a look of the scale search is
# wasted, and a blown-out roof or still water changes nothing.
MANY_EMPTY = 0.25


@runtime_checkable
class Windowed(Picture, Protocol):
    """A picture that is decoded by windows."""

    def __hash__(self) -> int: ...

    def decoded_px(self, width: int, height: int, out_width: int, out_height: int) -> float:
        """How many pixels `read` decodes for such a window."""
        ...


@dataclass(frozen=True)
class Filled:
    """width, height : of the picture [px]. cells : (rows, columns) bool, which cells of an even grid may show anything;
    None if the picture is taken to be full."""

    width: int
    height: int
    cells: np.ndarray | None = None

    @property
    def area(self) -> float:
        """Share of the picture that may show anything."""
        return 1.0 if self.cells is None else float(self.cells.mean())

    def at(self, x: float, y: float) -> bool:
        """Whether there may be anything at (x, y), shares of the picture's width and height in [0, 1)."""
        return self.cells is None or bool(self.cells[int(y * len(self.cells)), int(x * self.cells.shape[1])])

    def share(self, tile: Tile) -> float:
        """Share of a tile that may show anything, by the cells that it touches."""
        if self.cells is None:
            return 1.0
        rows, columns = self.cells.shape
        down, across = (
            _touched(tile.y, tile.height, self.height, rows),
            _touched(tile.x, tile.width, self.width, columns),
        )
        return float(self.cells[down, across].mean())


def filled(picture: Picture) -> Filled:
    """Where a picture shows anything. One that is decoded as a whole (not `Windowed`) is taken to be full.

    A cell is empty if it and its neighbours are each of one grey, whatever the reason: a mask, blocks that were never
    written, or a white or black border that nobody declared. In a picture with overviews the whole cell is looked at,
    else a patch of it.
    """
    if not isinstance(picture, Windowed):
        return Filled(picture.width, picture.height)
    if picture not in _known:
        _known[picture] = _looked_at(picture)
    return _known[picture]


# The scale search, its tie-break and the sweep ask for the same pictures. References are weak: an unused one is freed.
_known: WeakKeyDictionary[Windowed, Filled] = WeakKeyDictionary()


def _looked_at(picture: Windowed) -> Filled:
    side = max(LEAST_CELL, -(-max(picture.width, picture.height) // CELLS_ACROSS))
    rows, columns = -(-picture.height // side), -(-picture.width // side)
    empty = np.zeros((rows, columns), bool)
    for step in (FIRST_EVERY, 1):
        for row in range(0, rows, step):
            for column in range(0, columns, step):
                empty[row, column] = _empty(picture, row, column, rows, columns)
        if empty[::step, ::step].mean() < MANY_EMPTY:
            return Filled(picture.width, picture.height)
    around = np.pad(~empty, 1)
    cells = np.any([around[y : y + rows, x : x + columns] for y in range(3) for x in range(3)], axis=0)
    return Filled(picture.width, picture.height, cells if cells.any() else None)


def _empty(picture: Windowed, row: int, column: int, rows: int, columns: int) -> bool:
    """Whether one of `rows` x `columns` cells, or the patch of it that is looked at, is of one grey."""
    x, width = _span(column, columns, picture.width)
    y, height = _span(row, rows, picture.height)
    across, down = min(PATCH_SIDE, width), min(PATCH_SIDE, height)
    if picture.decoded_px(width, height, across, down) > 4 * across * down:  # no overview is as coarse
        # Patches have different places within their cells, so that a narrow strip cannot lie between them.
        x += int((width - across) * (GOLDEN * row % 1))
        y += int((height - down) * (GOLDEN * column % 1))
        width, height = across, down
    return one_grey(picture.read(x, y, width, height, across, down))


def one_grey(image: np.ndarray) -> bool:
    """Whether an image is of one grey all over, as areas without data are."""
    return bool(image.min() == image.max())


def _span(number: int, cells: int, size: int) -> tuple[int, int]:
    """Start and length [px] of cell `number` of `cells` equal ones along `size` px."""
    start = number * size // cells
    return start, (number + 1) * size // cells - start


def _touched(start: int, length: int, size: int, cells: int) -> slice:
    """Which of `cells` equal cells along `size` px a span [px] touches."""
    return slice(start * cells // size, -(-(start + length) * cells // size))
