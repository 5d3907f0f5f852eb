"""The block offsets of a TIFF, from its own directory. (GDAL would read a block whose offset is lost as empty.)

Tags and types are those of TIFF 6.0 (Adobe, 1992) and of BigTIFF.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

STRIP_OFFSETS, STRIP_COUNTS = (273, 324), (279, 325)  # StripOffsets, TileOffsets; StripByteCounts, TileByteCounts
ROWS_PER_STRIP, TILE_WIDTH = 278, 322
TAG_TYPES = {3: "u2", 4: "u4", 16: "u8"}  # SHORT, LONG, LONG8
ONE_STRIP = 2**32 - 1  # rows of a strip that holds all of the image: the default of TIFF
MOST_TAGS = 4096  # of a directory; more means damage


@dataclass(frozen=True)
class Blocks:
    """offset, count : (N,) start and length of the blocks (strips or tiles) of the first image [byte]; 0 and 0 for a
    block that was never written. Empty if the list cannot be read; `count` is None in files so old that they do not
    store lengths. strip : rows of a strip [px], which may be more than the image has; None for tiles. GDAL may report
    another number: it shows a file's only strip as if it were many."""

    offset: np.ndarray
    count: np.ndarray | None
    strip: int | None


def blocks_of(path: Path) -> Blocks | None:
    """The blocks that the TIFF at `path` lists, or None if it is not a TIFF. Raises OSError."""
    with path.open("rb") as file:
        start = file.read(16)
        order = {b"II": "<", b"MM": ">"}.get(start[:2])
        if order is None or len(start) < 16:
            return None
        (magic,) = struct.unpack_from(f"{order}H", start, 2)
        if magic not in (42, 43):
            return None
        big = magic == 43
        at = struct.unpack_from(f"{order}{'Q' if big else 'I'}", start, 8 if big else 4)[0]
        lists = _lists(file, at, order, big)
    offset, count = (next((lists[tag] for tag in tags if tag in lists), None) for tags in (STRIP_OFFSETS, STRIP_COUNTS))
    rows = [int(value) for value in lists.get(ROWS_PER_STRIP, ()) if value > 0]
    strip = None if TILE_WIDTH in lists else (*rows, ONE_STRIP)[0]
    return Blocks(np.empty(0, np.uint64) if offset is None else offset, count, strip)


def _lists(file: BinaryIO, at: int, order: str, big: bool) -> dict[int, np.ndarray]:
    head, entry, word = ("Q", "HHQ", 8) if big else ("H", "HHI", 4)
    lists: dict[int, np.ndarray] = {}
    file.seek(min(at, 2**62))
    number = file.read(struct.calcsize(order + head))
    if len(number) < struct.calcsize(order + head):
        return lists
    size = struct.calcsize(order + entry) + word
    table = file.read(size * min(struct.unpack(order + head, number)[0], MOST_TAGS))
    for k in range(0, len(table) - size + 1, size):
        tag, kind, count = struct.unpack_from(order + entry, table, k)
        if tag not in (*STRIP_OFFSETS, *STRIP_COUNTS, ROWS_PER_STRIP, TILE_WIDTH):
            continue
        if kind not in TAG_TYPES:
            lists[tag] = np.empty(0, np.uint64)
            continue
        dtype = np.dtype(order + TAG_TYPES[kind])
        value = table[k + size - word : k + size]
        if count * dtype.itemsize > word:
            file.seek(min(struct.unpack(order + ("Q" if big else "I"), value)[0], 2**62))
            value = file.read(min(count * dtype.itemsize, 2**31))
        whole = len(value) // dtype.itemsize * dtype.itemsize
        lists[tag] = np.frombuffer(value[:whole], dtype)[:count].astype(np.uint64)
    return lists
