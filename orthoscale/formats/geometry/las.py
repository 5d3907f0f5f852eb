"""LAS and LAZ (ASPRS, LAS 1.4 R15): coordinates are whole numbers times a factor plus an offset, both in the header. So
only the header changes, whether points are compressed or not.
"""

from __future__ import annotations

import shutil
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...errors import InputError, UsageError, shown
from ..reading import EXPORT_ANEW
from .mark import MARK, refuse_marked
from .ply import ROWS
from .properties import left_as_they_are

# Offsets in the header [bytes].
SOFTWARE, HEADER_SIZE, RECORDS, POINT_FORMAT, HEADER_LENGTHS, EXTENDED = 58, 94, 100, 104, 131, 235
LEAST_HEADER, WHOLE_HEADER = 227, 375  # [bytes] smallest size of a header, and largest
POINTS_AT, COUNT, COMPRESSED = 96, 247, 0xC0  # where the points begin; 64 bits of their number; LAZ in their format
DOUBLES = 12  # numbers from HEADER_LENGTHS on: factors and offsets by axis, then largest and smallest coordinates
WAVES = (4, 5, 9, 10)  # point formats with waveforms, whose directions have a length
PROJECTION, GEOKEYS, WKT = b"LASF_Projection", 34735, 2112
SPECIFICATION, EXTRA = b"LASF_Spec", 4  # the record that describes the numbers that points have besides the usual ones
EXTRA_NUMBER = "<2xBB32s"  # type, options and name of such a number, at the beginning of EXTRA_SIZE bytes
EXTRA_SIZE = 192
FLOATS, WITH_FACTOR = (9, 10, 19, 20, 29, 30), 8  # types of decimal numbers; the option that a factor makes them such
MOST_RECORD = 65_535  # [bytes] of a record that are read: all that one before the points may have


def scale_las(source: Path, target: Path, scale: float) -> list[str]:
    """Write the LAS or LAZ file `source` to `target` in metres; returns notes for the user. Raises InputError;
    UsageError for one that is in metres already, or georeferenced."""
    extra: list[str] = []
    with source.open("rb") as file:
        head = bytearray(file.read(LEAST_HEADER))
        if len(head) < LEAST_HEADER or head[:4] != b"LASF":
            raise InputError(f"{source}: not a LAS file", EXPORT_ANEW)
        if head[SOFTWARE:].startswith(MARK.encode()):
            refuse_marked(source)
        if head[POINT_FORMAT] & 0x3F in WAVES:  # LAZ has flags in the two other bits
            raise InputError(f"{source}: points with waveforms cannot be scaled", "Write it without them first.")
        for user, record, content in _records(source, file, bytes(head)):
            if user == b"copc":
                raise InputError(f"{source}: COPC cannot be scaled", "Convert it to plain LAZ first.")
            keys = record == GEOKEYS and content[6:8].strip(b"\0")  # the number of keys
            if user == PROJECTION and (keys or (record == WKT and content.strip(b"\0 "))):
                raise UsageError(
                    f"{source} is georeferenced, and so not in the model's units",
                    "Give the cloud as it was before georeferencing; if its reference is wrong, remove that first.",
                )
            if user == SPECIFICATION and record == EXTRA:
                extra += _extra_decimals(content)
        lengths = struct.unpack_from(f"<{DOUBLES}d", head, HEADER_LENGTHS)
        struct.pack_into(f"<{DOUBLES}d", head, HEADER_LENGTHS, *(value * scale for value in lengths))
        struct.pack_into("<32s", head, SOFTWARE, f"{MARK}: metres".encode())
        file.seek(LEAST_HEADER)
        with target.open("wb") as out:
            out.write(head)
            shutil.copyfileobj(file, out, 1 << 20)
    return left_as_they_are(extra, scale)


def points_in_las(path: Path) -> Iterator[np.ndarray]:
    """Blocks (N, 3) of the points of the LAS file `path`; of LAZ only where laspy and a decompressor are installed.
    Raises ValueError, struct.error for a damaged one."""
    with path.open("rb") as file:
        head = file.read(WHOLE_HEADER)
        (start,) = struct.unpack_from("<I", head, POINTS_AT)
        form, length, count = struct.unpack_from("<BHI", head, POINT_FORMAT)
        if not count and len(head) == WHOLE_HEADER:  # more than 32 bits can count
            (count,) = struct.unpack_from("<Q", head, COUNT)
        if form & COMPRESSED:
            yield from _decompressed(path)
            return
        factor, offset = np.frombuffer(head, "<f8", 6, HEADER_LENGTHS).reshape(2, 3)
        row = np.dtype({"names": ["xyz"], "formats": ["3<i4"], "itemsize": length})
        file.seek(start)
        while count > 0 and (block := file.read(min(ROWS, count) * length)):
            with np.errstate(all="ignore"):  # a damaged header's infinities
                points = np.frombuffer(block, row)["xyz"] * factor + offset
            yield points
            count -= ROWS


def _decompressed(path: Path) -> Iterator[np.ndarray]:
    """Blocks (N, 3) of the points of the LAZ file `path`; none without laspy. Raises ValueError for a damaged one, or
    without a decompressor."""
    try:
        import laspy
    except ImportError:
        return
    try:
        with laspy.open(path) as file:
            for points in file.chunk_iterator(ROWS):
                yield np.column_stack([points.x, points.y, points.z])
    except Exception as error:  # each decompressor has errors of its own
        raise ValueError("damaged, or no decompressor") from error


def _extra_decimals(content: bytes) -> list[str]:
    """Names of the extra numbers of a point that are no whole ones: those are in a unit of their own."""
    names = []
    for start in range(0, len(content) - EXTRA_SIZE + 1, EXTRA_SIZE):
        kind, options, name = struct.unpack_from(EXTRA_NUMBER, content, start)
        if kind in FLOATS or (kind and options & WITH_FACTOR):  # the options of undescribed bytes (0) are their number
            names.append(shown(name.split(b"\0")[0].decode("latin-1").strip()) or "nameless")
    return names


def _records(path: Path, file: BinaryIO, head: bytes) -> Iterator[tuple[bytes, int, bytes]]:
    """User, number and the first bytes of each variable length record, including those after the points."""
    size = path.stat().st_size
    (start,), (count,) = struct.unpack_from("<H", head, HEADER_SIZE), struct.unpack_from("<I", head, RECORDS)
    yield from _walk(path, file, size, start, count, "<H16sHH32x")
    file.seek(EXTENDED)
    extended = file.read(12)
    if head[24:26] >= b"\1\4" and start >= EXTENDED + 12 and len(extended) == 12:
        start, count = struct.unpack("<QI", extended)
        yield from _walk(path, file, size, start, count, "<H16sHQ32x")


def _walk(
    path: Path, file: BinaryIO, size: int, start: int, count: int, form: str
) -> Iterator[tuple[bytes, int, bytes]]:
    for _ in range(count):
        file.seek(min(start, size))
        record = file.read(struct.calcsize(form))
        if len(record) < struct.calcsize(form):
            raise InputError(f"{path}: {size} bytes, but its header has records beyond its end", EXPORT_ANEW)
        _, user, number, length = struct.unpack(form, record)
        yield user.rstrip(b"\0"), number, file.read(min(length, MOST_RECORD))
        start += len(record) + length
