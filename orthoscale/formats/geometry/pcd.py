"""PCD, the point clouds of PCL (0.7), in its three encodings; compressed files are written uncompressed."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...errors import InputError
from ..reading import EXPORT_ANEW, HUGE, MIB
from .mark import MARK, mark, refuse_marked
from .ply import ROWS
from .properties import left_as_they_are
from .words import grown, header_line

FORMS = ("ascii", "binary", "binary_compressed")
LENGTHS = ("x", "y", "z", "vp_x", "vp_y", "vp_z")  # position of a point, and of the sensor that saw it
SIZES = ("radius", "range")  # of a surfel, and its distance from the sensor; whole numbers are in a sensor's own unit


def scale_pcd(source: Path, target: Path, scale: float) -> list[str]:
    """Write the PCD file `source` to `target` in metres; returns notes for the user. Raises InputError, UsageError."""
    with source.open("rb") as file, target.open("wb") as out:
        lines, row, count = _header(source, file)
        if any(line.startswith("# " + MARK) for line in lines):
            refuse_marked(source)
        decimal = [name for name in row.names or () if row[name].base.kind == "f"]
        lengths = [name for name in row.names or () if name in LENGTHS or (name in SIZES and name in decimal)]
        if len({"x", "y", "z"} & set(lengths)) < 3 or not set(lengths) <= set(decimal):
            raise InputError(
                f"{source}: x, y and z are missing or not decimal numbers", "Export it with float coordinates."
            )
        form = lines[-1].split()[1]
        lines[-1] = "DATA " + form.removesuffix("_compressed")
        for k, line in enumerate(lines):
            name, *words = line.split() or [""]
            if name == "VIEWPOINT":  # the sensor's position, then its orientation
                lines[k] = " ".join([name, *(f"{float(word) * scale:.10g}" for word in words[:3]), *words[3:]])
        out.write("\n".join([f"# {mark(scale)}", *lines, ""]).encode("utf-8", "surrogateescape"))
        if form == "ascii":
            _ascii(source, file, out, row, lengths, count, scale)
        elif form == "binary":
            if count * row.itemsize > source.stat().st_size - file.tell():  # checked before memory is allocated
                raise InputError(f"{source}: ends within its {count} points", EXPORT_ANEW)
            for start in range(0, count, ROWS):
                points = np.frombuffer(file.read(min(ROWS, count - start) * row.itemsize), row)
                out.write(_bytes(points.copy(), lengths, scale))
            shutil.copyfileobj(file, out, 1 << 20)
        else:
            out.write(_bytes(_decompressed(source, file, row, count), lengths, scale))
    return left_as_they_are([name for name in decimal if name not in lengths], scale)


def points_in_pcd(path: Path) -> Iterator[np.ndarray]:
    """Blocks (N, 3) of the points of the PCD file `path`, not a compressed one, without those that the sensor did not
    see (NaN). Raises InputError; ValueError, IndexError for a damaged one."""
    with path.open("rb") as file:
        lines, row, count = _header(path, file)
        columns = [_words_of(row).index(axis) for axis in "xyz"]
        for start in range(0, count, ROWS):
            many = min(ROWS, count - start)
            if lines[-1].split()[1] == "ascii":
                words = [file.readline().split() for _ in range(many)]
                block = np.array([[each[k] for k in columns] for each in words], float)
            else:
                table = np.frombuffer(file.read(many * row.itemsize), row)
                block = np.column_stack([table[axis].astype(float).reshape(-1) for axis in "xyz"])
            yield block[np.isfinite(block).all(1)]


def _words_of(row: np.dtype) -> list[str]:
    """The field of each word of a point as text."""
    return [name for name in row.names or () for _ in range(row[name].shape[0])]


def _header(path: Path, file: BinaryIO) -> tuple[list[str], np.dtype, int]:
    """The header's lines, the fields of a point, and the number of points. Raises InputError."""
    lines: list[str] = []
    told: dict[str, list[str]] = {}
    while "DATA" not in told:
        if (line := header_line(file)) is None:
            raise InputError(f"{path}: no header of a PCD file", EXPORT_ANEW)
        lines.append(line)
        if words := line.split():
            told[words[0]] = words[1:]
    try:
        # All padding fields have the same name, _.
        names = [name if name != "_" else f"_{k}" for k, name in enumerate(told["FIELDS"])]
        counts = [int(word) for word in told.get("COUNT", ["1"] * len(names))]
        kinds = ["<" + kind.lower() + size for kind, size in zip(told["TYPE"], told["SIZE"], strict=True)]
        row = np.dtype([(n, kind, (c,)) for n, kind, c in zip(names, kinds, counts, strict=True)])
        count = int(told["POINTS"][0]) if "POINTS" in told else int(told["WIDTH"][0]) * int(told["HEIGHT"][0])
        if min(counts) < 1 or count < 0 or told["DATA"][0] not in FORMS:
            raise ValueError("no known form, or an impossible count")
        [float(word) for line in lines if line.split()[:1] == ["VIEWPOINT"] for word in line.split()[1:]]
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise InputError(f"{path}: not a PCD header", EXPORT_ANEW) from error
    return lines, row, count


def _ascii(
    path: Path, file: BinaryIO, out: BinaryIO, row: np.dtype, lengths: list[str], count: int, scale: float
) -> None:
    words_of = _words_of(row)
    columns = [words_of.index(name) for name in lengths]
    digits = 15 if any(row[name].base == "f8" for name in lengths) else 9
    for k in range(count):
        words = file.readline().split()
        try:
            if len(words) < len(words_of):
                raise ValueError("some are missing")
            out.write(b" ".join(grown(words, columns, scale, digits)) + b"\n")
        except (ValueError, IndexError) as error:
            raise InputError(f"{path}: point {k} of {count} is missing or malformed", EXPORT_ANEW) from error


def _bytes(points: np.ndarray, lengths: list[str], scale: float) -> bytes:
    """The bytes of `points` (N,), whose `lengths` are multiplied by `scale` in place."""
    for name in lengths:
        points[name] = points[name].astype(float) * scale
    return points.tobytes()


def _decompressed(path: Path, file: BinaryIO, row: np.dtype, count: int) -> np.ndarray:
    """(count,) points from the compressed form, which stores the points field by field."""
    packed, size = (int.from_bytes(file.read(4), "little") for _ in range(2))
    if size > HUGE:
        raise InputError(f"{path}: larger than the {HUGE // MIB} MiB that may be compressed", "Save it as binary PCD.")
    try:
        if size != count * row.itemsize or packed > path.stat().st_size:
            raise ValueError("another number of points, or fewer bytes")
        data = _lzf(file.read(packed), size)
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: its compressed points are damaged", EXPORT_ANEW) from error
    points, at = np.empty(count, row), 0
    for name in row.names or ():
        points[name] = np.frombuffer(data, row[name], count, at)
        at += count * row[name].itemsize
    return points


def _lzf(data: bytes, size: int) -> bytes:
    """`data` decompressed by Lehmann's LZF to `size` bytes. Raises ValueError, IndexError."""
    out = bytearray()
    at = 0
    while at < len(data) and len(out) <= size:
        control = data[at]
        at += 1
        if control < 32:  # control + 1 literal bytes follow
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[at]
            at += 1
        start = len(out) - ((control & 31) << 8) - data[at] - 1
        at += 1
        if start < 0:
            raise ValueError("a copy from before the start")
        copied = out[start : start + length + 2]  # fewer if the copy overlaps its own output: then they are repeated
        out += (copied * (length + 2))[: length + 2]
    if len(out) != size:
        raise ValueError("another size than announced")
    return bytes(out)
