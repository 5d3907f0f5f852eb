"""The vertices of clouds and meshes, to tell of which model they are."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from ...errors import InputError
from ..reading import EXPORT_ANEW
from .gltf_vertices import vertices_of_gltf
from .las import points_in_las
from .lines import POINTS, corners_of_ascii_stl, points_in_lines, vertices_of_off
from .obj import vertices_of_obj
from .pcd import points_in_pcd
from .ply import ROWS, points_in
from .records import centres_of_splat, corners_of_stl, is_binary_stl

READERS: dict[str, Callable[[Path], Iterator[np.ndarray]]] = {
    ".glb": vertices_of_gltf,
    ".gltf": vertices_of_gltf,
    ".las": points_in_las,
    ".laz": points_in_las,
    ".obj": lambda path: _in_blocks(vertices_of_obj(path)),
    ".off": lambda path: _in_blocks(vertices_of_off(path)),
    ".pcd": points_in_pcd,
    ".splat": centres_of_splat,
    ".stl": lambda path: corners_of_stl(path) if is_binary_stl(path) else _in_blocks(corners_of_ascii_stl(path)),
    **dict.fromkeys(POINTS, lambda path: _in_blocks(points_in_lines(path))),
}
WITH_VERTICES = (".ply", *READERS)


def vertices_in(path: Path, most: int) -> Iterator[np.ndarray]:
    """Blocks (N, 3) of the vertices of the file `path` with one of the endings WITH_VERTICES; of a PLY file, `most` of
    them at most. Raises InputError."""
    suffix = path.suffix.lower()
    try:
        for block in points_in(path, most) if suffix == ".ply" else READERS[suffix](path):
            if not np.isfinite(block).all():
                raise ValueError("not finite")
            yield block
    except (ValueError, IndexError, TypeError, struct.error) as error:  # numpy's for a short buffer is a TypeError
        raise InputError(f"{path}: a vertex is missing or malformed", EXPORT_ANEW) from error


def _in_blocks(points: Iterable[list[float]]) -> Iterator[np.ndarray]:
    points = iter(points)
    while block := list(islice(points, ROWS)):
        yield np.array(block, float).reshape(-1, 3)
