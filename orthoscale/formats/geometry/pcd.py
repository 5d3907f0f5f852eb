"""PCD, the point clouds of PCL (0.7), in its three forms; what was compressed is written uncompressed."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from ...errors import InputError
from ..reading import EXPORT_ANEW, HUGE, MIB
from .mark import MARK, mark, refuse_marked

LONGEST_HEADER = 1 << 16  # [bytes]
ROWS = 1 << 17  # points in memory at once
LENGTHS = ("x", "y", "z", "vp_x", "vp_y", "vp_z")  # where a point is, and from where it was seen


class _Field(NamedTuple):
    """at, width : where it is in a point's bytes. kind : numpy's type. column : its first word in a line."""

    name: str
    at: int
    width: int
    kind: str
    column: int


def scale_pcd(source: Path, target: Path, scale: float) -> None:
    """Write the PCD file `source` to `target` in metres. Raises InputError, UsageError."""
    with source.open("rb") as file, target.open("wb") as out:
        lines, fields, count = _header(source, file)
        lengths = [field for field in fields if field.name in LENGTHS]
        if len({"x", "y", "z"} & {f.name for f in lengths}) < 3 or any(f.kind[0] != "f" for f in lengths):
            raise InputError(f"{source}: no x, y and z that are decimal numbers", "Export it with float coordinates.")
        form = lines[-1].split()[1]
        for k, line in enumerate(lines):
            words = line.split()
            if words[:1] == ["VIEWPOINT"]:
                lines[k] = " ".join(["VIEWPOINT", *(f"{float(w) * scale:.10g}" for w in words[1:4]), *words[4:]])
        lines[-1] = "DATA " + form.removesuffix("_compressed")
        out.write("\n".join([f"# {mark(scale)}", *lines, ""]).encode("utf-8", "surrogateescape"))
        stride = sum(field.width for field in fields)
        if form == "ascii":
            digits = 15 if any(f.kind == "f8" for f in lengths) else 9
            _ascii(source, file, out, fields, count, scale, digits)
        elif form == "binary":
            if count * stride > source.stat().st_size:  # before memory is asked for
                raise InputError(f"{source}: ends within its {count} points", EXPORT_ANEW)
            for start in range(0, count, ROWS):
                many = min(ROWS, count - start)
                points = np.frombuffer(file.read(many * stride), np.uint8).copy()
                if len(points) < many * stride:
                    raise InputError(f"{source}: ends within its {count} points", EXPORT_ANEW)
                out.write(_grown(points.reshape(many, stride), lengths, scale))
            shutil.copyfileobj(file, out, 1 << 20)
        else:
            out.write(_grown(_decompressed(source, file, fields, count, stride), lengths, scale))


def _header(path: Path, file: BinaryIO) -> tuple[list[str], list[_Field], int]:
    """The header's lines, the fields of a point, and how many points there are. Raises InputError, UsageError."""
    lines: list[str] = []
    told: dict[str, list[str]] = {}
    while "DATA" not in told:
        line = file.readline(LONGEST_HEADER).decode("utf-8", "surrogateescape").rstrip()
        if file.tell() > LONGEST_HEADER or not (line or file.peek(1)):  # type: ignore[attr-defined]
            raise InputError(f"{path}: no header of a PCD file", EXPORT_ANEW)
        if line.startswith("# " + MARK):
            refuse_marked(path)
        lines.append(line)
        if words := line.split():
            told[words[0]] = words[1:]
    try:
        names = told["FIELDS"]
        counts = [int(word) for word in told.get("COUNT", ["1"] * len(names))]
        kinds = [k.lower() + s for k, s in zip(told["TYPE"], told["SIZE"], strict=True)]
        sizes = [np.dtype(kind).itemsize * n for kind, n in zip(kinds, counts, strict=True)]
        points = int(told["POINTS"][0]) if "POINTS" in told else int(told["WIDTH"][0]) * int(told["HEIGHT"][0])
        if min(*counts, points) < 0 or told["DATA"][0] not in ("ascii", "binary", "binary_compressed"):
            raise ValueError("no known form, or a negative count")
        fields = [_Field(name, sum(sizes[:k]), sizes[k], kinds[k], sum(counts[:k])) for k, name in enumerate(names)]
        if len(fields) != len(kinds):
            raise ValueError("as many types as fields belong there")
        [float(word) for word in told.get("VIEWPOINT", [])]
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise InputError(f"{path}: not a PCD header", EXPORT_ANEW) from error
    return lines, fields, points


def _ascii(
    path: Path, file: BinaryIO, out: BinaryIO, fields: list[_Field], count: int, scale: float, digits: int
) -> None:
    columns = [field.column for field in fields if field.name in LENGTHS]
    for k in range(count):
        words = file.readline().split()
        try:
            if len(words) <= fields[-1].column:
                raise ValueError("some are missing")
            for column in columns:
                words[column] = f"{float(words[column]) * scale:.{digits}g}".encode()
        except (ValueError, IndexError) as error:
            raise InputError(f"{path}: point {k} of {count} is missing or malformed", EXPORT_ANEW) from error
        out.write(b" ".join(words) + b"\n")


def _grown(points: np.ndarray, lengths: list[_Field], scale: float) -> bytes:
    """The bytes of `points`, uint8 (N, stride), with these fields times `scale`."""
    for field in lengths:
        part = slice(field.at, field.at + field.width)
        values = points[:, part].copy().view("<" + field.kind).astype(float) * scale
        points[:, part] = values.astype("<" + field.kind).view(np.uint8)
    return points.tobytes()


def _decompressed(path: Path, file: BinaryIO, fields: list[_Field], count: int, stride: int) -> np.ndarray:
    """Points, uint8 (N, stride), from the compressed form, which has each field of all points together."""
    packed, size = (int.from_bytes(file.read(4), "little") for _ in range(2))
    if size > HUGE:
        raise InputError(f"{path}: larger than the {HUGE // MIB} MiB that may be compressed", "Save it as binary PCD.")
    try:
        if size != count * stride or packed > path.stat().st_size:
            raise ValueError("another number of points, or fewer bytes")
        data = _lzf(file.read(packed), size)
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: its compressed points are damaged", EXPORT_ANEW) from error
    points = np.empty((count, stride), np.uint8)
    for field in fields:
        block = np.frombuffer(data, np.uint8, count * field.width, field.at * count)
        points[:, field.at : field.at + field.width] = block.reshape(count, field.width)
    return points


def _lzf(data: bytes, size: int) -> bytes:
    """What Lehmann's LZF made `data` of. Raises ValueError, IndexError."""
    out = bytearray()
    at = 0
    while at < len(data) and len(out) <= size:
        control = data[at]
        at += 1
        if control < 32:  # that many bytes and one as they are
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
        for k in range(start, start + length + 2):  # which may reach into what it writes
            out.append(out[k])
    if len(out) != size:
        raise ValueError("another size than announced")
    return bytes(out)
