"""PLY: point clouds, meshes and Gaussian splats; coordinates and the log scales of splats are scaled.

Turk's format in its three encodings. A splat (Kerbl et al. 2023) stores the logarithms of its axes in ``scale_0`` ...,
to which ``log(scale)`` is added; rotations, opacities and harmonics have no length.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...errors import InputError
from ..reading import EXPORT_ANEW, reason
from .beside import Referred
from .mark import MARK, mark, refuse_marked
from .properties import left_as_they_are
from .words import grown, header_line

PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
    **{"int64": "i8", "uint64": "u8"},  # not in Turk's format; used for point numbers and times
}
ORDER = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
ROWS = 1 << 17  # vertices in memory at once
MOST_POINTS = 500_000  # most points of a model; fewer are enough to find the ground
# `filter_3D` is the width of Mip-Splatting's filter (Yu et al. 2024), which it writes besides the splats' axes.
OF_VERTICES = ("x", "y", "z", "radius", "filter_3D")
SPLAT = {"rot_0", "f_dc_0", "opacity"}  # every Gaussian has at least one of these properties
VIEWPOINT = ("view_px", "view_py", "view_pz")  # position in MeshLab's and PCL's element `camera`, besides its axes
TEXTURE = "comment TextureFile "  # written by MeshLab and OpenMVS
XYZ = ("x", "y", "z")
COLOUR = ("red", "green", "blue")  # properties of a coloured vertex, of the type uchar


@dataclass
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str]]  # name and numpy type; '' for a list

    @property
    def fixed(self) -> bool:
        return all(kind for _, kind in self.properties)

    def row(self, order: str) -> np.dtype:
        return np.dtype([(name, order + kind) for name, kind in self.properties])

    @property
    def lengths(self) -> list[str]:
        """Names of the properties that are lengths."""
        of = {"vertex": OF_VERTICES, "camera": VIEWPOINT}.get(self.name, ())
        return [name for name, _ in self.properties if name in of]

    @property
    def logs(self) -> list[str]:
        """Names of the properties that are logarithms of lengths: a splat's axes."""
        names = [name for name, _ in self.properties if self.name == "vertex"]
        return [name for name in names if re.fullmatch(r"scale_\d", name) and SPLAT & set(names)]

    @property
    def unscaled(self) -> list[str]:
        """Names of the decimal numbers that stay as they are."""
        return [name for name, kind in self.properties if kind[:1] == "f" and name not in (*self.lengths, *self.logs)]

    def least(self, form: str) -> int:
        """The smallest number of bytes that the element takes: one for a list (its count), two for a word of text (with
        its separator)."""
        if form == "ascii":
            return self.count * max(1, 2 * len(self.properties))
        return self.count * sum(np.dtype(kind).itemsize if kind else 1 for _, kind in self.properties)


def scale_ply(source: Path, target: Path, scale: float) -> Referred:
    """Write the PLY file `source` to `target` with all lengths times `scale`; returns the textures that it refers to.
    Raises InputError, UsageError."""
    with source.open("rb") as file:
        lines, form, elements = _header(source, file)
        _require(source, file, form, elements)
        if any(line.startswith("comment " + MARK) for line in lines):
            refuse_marked(source)
        vertex = next((e for e in elements if e.name == "vertex"), None)
        names = [name for name, _ in vertex.properties] if vertex else []
        if vertex is None or not set(XYZ) <= set(names):
            raise InputError(
                f"{source}: no vertices with x, y and z among its elements ({', '.join(e.name for e in elements)})",
                "Packed splats and other exotic layouts must be unpacked first.",
            )
        last = max(k for k, element in enumerate(elements) if element.lengths)
        leading = elements[: last + 1]
        if not all(element.fixed for element in leading):
            raise InputError(f"{source}: lists before or among the vertices", "Export it with plain vertices first.")
        for element in leading:
            kinds = dict(element.properties)
            for name in (*element.lengths, *element.logs):
                if kinds[name][0] != "f":
                    raise InputError(f"{source}: {name} is a whole number and cannot be scaled", "Export it as float.")
        with target.open("wb") as out:
            lines.insert(2, "comment " + mark(scale))
            out.write(("\n".join(lines) + "\n").encode("utf-8", "surrogateescape"))
            for element in leading:
                if form == "ascii":
                    _ascii(source, file, out, element, scale)
                else:
                    _binary(source, file, out, element, ORDER[form], scale)
            shutil.copyfileobj(file, out, 1 << 20)
    textures = Referred(notes=left_as_they_are(vertex.unscaled, scale))
    textures.add(source, [line.removeprefix(TEXTURE).strip() for line in lines if line.startswith(TEXTURE)])
    return textures


def _require(path: Path, file: BinaryIO, form: str, elements: list[_Element]) -> None:
    """Raise InputError if fewer bytes follow than the header announces."""
    missing = sum(element.least(form) for element in elements) - (path.stat().st_size - file.tell())
    if missing > (form == "ascii"):  # the last line of text may lack its newline
        raise InputError(f"{path}: {missing} bytes or more are missing at its end", EXPORT_ANEW)


def read_points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) vertices of the PLY file `path`, MOST_POINTS of them at most, and their colours (N, 3) uint8, black where
    it has none. Raises InputError."""
    with path.open("rb") as file:
        kinds = dict(property for element in _header(path, file)[2][:1] for property in element.properties)
    coloured = all(kinds.get(name) == "u1" for name in COLOUR)
    names = (*XYZ, *COLOUR) if coloured else XYZ
    table = np.concatenate([np.empty((0, len(names))), *points_in(path, MOST_POINTS, properties=names)])
    points, colours = np.split(table, [len(XYZ)], axis=1)
    return points, colours.astype(np.uint8) if coloured else np.zeros(points.shape, np.uint8)


def vertex_count(path: Path) -> int:
    """The number of vertices that the header of the PLY file `path` announces. Raises InputError, OSError."""
    with path.open("rb") as file:
        return sum(element.count for element in _header(path, file)[2] if element.name == "vertex")


def points_in(
    path: Path,
    most: int,
    progress: Callable[[int, int], None] | None = None,
    properties: Sequence[str] = XYZ,
) -> Iterator[np.ndarray]:
    """Blocks (N, K) of the K `properties` of the vertices of the PLY file `path`, thinned to `most` vertices at most.
    Never more than ROWS are in memory. progress : called with the number of vertices passed, and their total. Raises
    InputError."""
    with path.open("rb") as file:
        _, form, elements = _header(path, file)
        vertex = elements[0] if elements else None
        names = [name for name, _ in vertex.properties] if vertex else []
        if vertex is None or vertex.name != "vertex" or not vertex.fixed or not set(properties) <= set(names):
            raise InputError(f"{path}: it does not begin with vertices that have x, y and z", "Export it again.")
        _require(path, file, form, elements)
        # More points would not improve the ground: of very many, only every `step`-th is taken.
        step = -(-vertex.count // most)
        columns = [names.index(name) for name in properties]
        row = vertex.row(ORDER[form])
        for start in range(0, vertex.count, ROWS):
            many = min(ROWS, vertex.count - start)
            if form == "ascii":
                lines = [file.readline() for _ in range(many)][-start % step :: step]
                try:
                    words = [line.split() for line in lines]
                    block = np.array([[each[k] for k in columns] for each in words], float).reshape(-1, len(columns))
                except (ValueError, IndexError) as error:
                    raise InputError(f"{path}: a vertex is missing or malformed", EXPORT_ANEW) from error
            else:
                table = np.frombuffer(file.read(many * row.itemsize), row)[-start % step :: step]
                block = np.column_stack([table[name].astype(float) for name in properties])
            if not np.isfinite(block).all():
                raise InputError(f"{path}: a vertex after number {start} is not finite", EXPORT_ANEW)
            yield block
            if progress is not None:
                progress(start + many, vertex.count)


def _header(path: Path, file: BinaryIO) -> tuple[list[str], str, list[_Element]]:
    """The header's lines, the encoding and the elements; the file is left at the first byte of data."""
    lines: list[str] = []
    elements: list[_Element] = []
    form = ""
    try:
        while not lines or lines[-1] != "end_header":
            if (line := header_line(file)) is None:
                raise ValueError("no end_header")
            lines.append(line)
            words = line.split()
            if len(lines) == 1 and line != "ply":
                raise ValueError("it does not start with 'ply'")
            if words[:1] == ["format"]:
                form = words[1]
            elif words[:1] == ["element"]:
                elements.append(_Element(words[1], int(words[2]), []))
            elif words[:1] == ["property"]:
                kind = "" if words[1] == "list" else PLY_TYPES[words[1]]
                if words[-1] in (name for name, _ in elements[-1].properties):
                    raise ValueError(f"{words[-1][:40]} appears twice")
                elements[-1].properties.append((words[-1], kind))
        if form not in ORDER or any(e.count < 0 for e in elements):
            raise ValueError("no known format, or a negative count")
    except (ValueError, IndexError, KeyError) as error:
        raise InputError(
            f"{path}, line {max(len(lines), 1)}: not a PLY header ({reason(error)})", EXPORT_ANEW
        ) from error
    return lines, form, elements


def _binary(path: Path, file: BinaryIO, out: BinaryIO, element: _Element, order: str, scale: float) -> None:
    row = element.row(order)
    for start in range(0, element.count if row.itemsize else 0, ROWS):
        many = min(ROWS, element.count - start)
        block = np.frombuffer(file.read(many * row.itemsize), row).copy()
        if len(block) != many:
            raise InputError(f"{path}: ends within {element.name} {start + len(block)} of {element.count}", EXPORT_ANEW)
        for name in element.lengths:
            block[name] = block[name].astype(float) * scale
        for name in element.logs:
            block[name] = block[name].astype(float) + np.log(scale)
        out.write(block.tobytes())


def _ascii(path: Path, file: BinaryIO, out: BinaryIO, element: _Element, scale: float) -> None:
    names = [name for name, _ in element.properties]
    grow, add = [names.index(n) for n in element.lengths], [names.index(n) for n in element.logs]
    digits = 15 if "f8" in dict(element.properties).values() else 9
    for k in range(element.count):
        line = file.readline()
        if not grow:
            out.write(line)
            continue
        words = line.split()
        try:
            if len(words) < len(names):
                raise ValueError("some are missing")
            words = grown(words, grow, scale, digits)
            for j in add:
                words[j] = f"{float(words[j]) + np.log(scale):.{digits}g}".encode()
        except (ValueError, IndexError) as error:
            where = f"{path}: {element.name} {k} of {element.count}"
            raise InputError(f"{where} is missing or malformed", EXPORT_ANEW) from error
        out.write(b" ".join(words) + b"\n")
