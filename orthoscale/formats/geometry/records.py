"""Files of binary records of equal size: STL's triangles, and the Gaussians of .splat. They have no room for a mark.

.splat (antimatter15's): position and axes as float32 (axes not as logarithms), then colours and a rotation in eight
bytes.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...errors import InputError
from ..reading import EXPORT_ANEW
from .lines import scale_ascii_stl
from .ply import ROWS

STL_TRIANGLE = np.dtype([("normal", "<3f4"), ("length", "<9f4"), ("attribute", "<u2")])
GAUSSIAN = np.dtype([("length", "<6f4"), ("rest", "8u1")])
STL_HEAD = 84  # [bytes] 80 of free text, then the number of triangles


def scale_stl(source: Path, target: Path, scale: float) -> None:
    """Write the STL file `source`, binary or text, to `target` in metres. Raises InputError."""
    if is_binary_stl(source):
        _scale(source, target, scale, STL_HEAD, STL_TRIANGLE)
    else:
        scale_ascii_stl(source, target, scale)


def is_binary_stl(path: Path) -> bool:
    """Whether the STL file `path` is binary, not text. Raises InputError for one that is neither."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(STL_HEAD)
    count = int.from_bytes(head[80:84], "little")
    if size >= STL_HEAD and size == STL_HEAD + count * STL_TRIANGLE.itemsize:
        return True
    if head.lstrip()[:5].lower() == b"solid":  # some binary files begin like this, too
        return False
    raise InputError(f"{path}: {size} bytes do not hold an STL file of {count} triangles", EXPORT_ANEW)


def corners_of_stl(path: Path) -> Iterator[np.ndarray]:
    """Blocks (N, 3) of the corners of the triangles in the binary STL file `path`."""
    with path.open("rb") as file:
        file.seek(STL_HEAD)
        while block := file.read(ROWS * STL_TRIANGLE.itemsize):
            yield np.frombuffer(block, STL_TRIANGLE)["length"].astype(float).reshape(-1, 3)


def scale_splat(source: Path, target: Path, scale: float) -> None:
    """Write the Gaussians in the .splat file `source` to `target` in metres. Raises InputError."""
    size = source.stat().st_size
    if size == 0 or size % GAUSSIAN.itemsize:
        raise InputError(
            f"{source}: {size} bytes are not a whole number of splats of {GAUSSIAN.itemsize} bytes each", EXPORT_ANEW
        )
    _scale(source, target, scale, 0, GAUSSIAN)


def centres_of_splat(path: Path) -> Iterator[np.ndarray]:
    """Blocks (N, 3) of the Gaussians' centres in the .splat file `path`. Raises ValueError for one that was cut off."""
    with path.open("rb") as file:
        while block := file.read(ROWS * GAUSSIAN.itemsize):
            yield np.frombuffer(block, GAUSSIAN)["length"][:, :3].astype(float)


def _scale(source: Path, target: Path, scale: float, head: int, row: np.dtype) -> None:
    with source.open("rb") as file, target.open("wb") as out:
        out.write(file.read(head))
        while block := file.read(ROWS * row.itemsize):
            records = np.frombuffer(block, row).copy()
            records["length"] = records["length"].astype(float) * scale
            out.write(records.tobytes())
