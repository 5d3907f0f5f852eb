"""Other meshes and point clouds, by Open3D (optional: it is large, and needs libraries of the system)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, OutputError, UsageError

MESHES = {".stl", ".off"}
CLOUDS = {".pcd", ".xyz", ".xyzn", ".xyzrgb", ".pts"}


def scale_mesh(source: Path, target: Path, scale: float) -> None:
    """Write the mesh or point cloud `source` to `target` in metres. These formats have no room for a mark.

    Raises UsageError without Open3D, InputError for a file that it cannot read, OutputError if it cannot write.
    """
    io = _open3d(source)
    mesh = source.suffix.lower() in MESHES
    thing = io.read_triangle_mesh(str(source)) if mesh else io.read_point_cloud(str(source))
    if not (thing.has_triangles() if mesh else thing.has_points()):
        raise InputError(f"{source}: Open3D finds nothing in it", "The file may be damaged: export it anew.")
    thing.scale(scale, np.zeros(3))
    if source.suffix.lower() == ".stl":
        thing.compute_triangle_normals()  # which STL must have
    written = (io.write_triangle_mesh if mesh else io.write_point_cloud)(str(target), thing)
    if not written or not target.is_file():
        raise OutputError(f"{target}: Open3D could not write it", "Check permissions and free space.")


def _open3d(path: Path) -> Any:
    try:
        import open3d
    except ImportError as error:
        raise UsageError(
            f"{path}: scaling {path.suffix} files needs Open3D ({error})",
            "Install it with `pip install orthoscale[mesh]`; on Linux it also needs libusb-1.0, libgl1, libegl1 and "
            "libgomp1 of the system. PLY, OBJ, GLB and glTF files need none of that.",
        ) from error
    return open3d.io
