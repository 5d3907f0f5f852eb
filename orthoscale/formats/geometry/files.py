"""Scales any file that is in a model's units to metres."""

from __future__ import annotations

import filecmp
import os
import shutil
from collections.abc import Callable
from pathlib import Path

from ...errors import InputError, UsageError, shown
from .beside import Referred
from .dense import scale_depth_map
from .gltf import scale_glb, scale_gltf
from .las import scale_las
from .lines import POINTS, scale_off, scale_points
from .obj import scale_obj
from .pcd import scale_pcd
from .ply import scale_ply
from .poses import SPLAT_CAMERAS, read_poses, scale_reconstruction, scale_splat_cameras, scale_transforms
from .records import scale_splat, scale_stl
from .text_models import BUNDLER, SUFFIXES, scale_text_model

KNOWN = (
    "Convert it first. Known are PLY (splats too), OBJ, GLB, glTF, transforms.json, reconstruction.json, cameras.json, "
    "bundle.out, NVM, depth maps, folders of COLMAP, LAS, LAZ, PCD, XYZ, PTS, STL, OFF, .splat."
)
RASTER_SUFFIXES = frozenset([".tif", ".tiff", ".asc", ".vrt"])
RASTERS = (
    "Of an elevation model multiply heights, pixel size and corner by the scale, or make it again from the scaled "
    "cloud. An orthophoto gets its own scale, by `orthoscale fix`; `orthoscale check ORTHO --model MODEL` compares it."
)
# Formats that consist of a single file.
ONE_FILE: dict[str, Callable[[Path, Path, float], list[str] | None]] = {
    ".las": scale_las,
    ".laz": scale_las,
    ".off": scale_off,
    ".pcd": scale_pcd,
    ".splat": scale_splat,
    ".stl": scale_stl,
    **dict.fromkeys(POINTS, scale_points),
    **dict.fromkeys(SUFFIXES, scale_text_model),
}
WITH = "with "  # beginning of a note on a file that was written beside
WITH_OTHERS = {".ply": scale_ply, ".obj": scale_obj, ".glb": scale_glb, ".gltf": scale_gltf}


class WrittenFiles:
    """The files that one run writes, so that no file replaces a different one of the same name."""

    def __init__(self) -> None:
        self._sources: dict[Path, Path] = {}

    def take(self, place: Path, source: Path) -> bool:
        """Whether `source` must still be written to `place`. Raises UsageError if another file was written there."""
        first = self._sources.setdefault(place, source)
        if first is not source and not filecmp.cmp(first, source, shallow=False):
            raise UsageError(
                f"{first} and {source} would both become {place.name}, and differ",
                "Write the files that refer to them to different folders, one after the other.",
            )
        return first is source


def scale_file(source: Path, target: Path, scale: float, others: WrittenFiles | None = None) -> list[str]:
    """Write the file `source`, in model units, to `target`, in metres: all lengths times `scale`; returns notes for the
    user.

    Files that it refers to (materials, buffers, point clouds) are written beside `target`. others : files written
    before. Raises InputError for a missing, damaged or unknown file, UsageError for one that is in metres already.
    """
    others = others or WrittenFiles()
    others.take(target, source)
    suffix = source.suffix.lower()
    copied, scaled = Referred(), Referred()
    notes: list[str] = []
    if suffix in WITH_OTHERS:
        copied = WITH_OTHERS[suffix](source, target, scale)
    elif suffix in ONE_FILE:
        notes = ONE_FILE[suffix](source, target, scale) or []
    elif source.name == SPLAT_CAMERAS:
        scale_splat_cameras(source, target, scale)
    elif suffix == ".json" and isinstance(read_poses(source), list):
        scale_reconstruction(source, target, scale)
    elif suffix == ".json":
        scaled, notes = scale_transforms(source, target, scale)
    elif suffix == ".bin" and source.parent.name == "depth_maps":
        scale_depth_map(source, target, scale)
    else:
        raise InputError(_unknown(source), RASTERS if suffix in RASTER_SUFFIXES else KNOWN)
    for path in copied.there:
        if others.take(place := _beside(path, source, target), path):
            shutil.copyfile(path, place)
    for path in scaled.there:
        if others.take(place := _beside(path, source, target), path):
            notes = [*notes, *(f"{path.name}: {note}" for note in scale_ply(path, place, scale).notes)]
    absent = [f"refers to {shown(name)}, which is not beside it" for name in (*copied.absent, *scaled.absent)]
    return [f"{WITH}{path.name}" for path in (*copied.there, *scaled.there)] + absent + copied.notes + notes


def told_of(source: Path, notes: list[str]) -> list[str]:
    """The `notes` of `scale_file` for readers to whom `source` is one of many files: what is good to know of it."""
    return [f"{source.name}: {note}" for note in notes if not note.startswith(WITH)]


def place_beside(path: Path, source: Path) -> Path:
    """The path of a file that `source` refers to, relative to the folder of `source`; links are not resolved. Raises
    InputError for a file outside of that folder: its copy would lie outside of the output folder as well."""
    place, home = Path(os.path.abspath(path)), os.path.abspath(source.parent)
    if not place.is_relative_to(home):
        raise InputError(f"{source} refers to {path}, which lies outside its folder", "Move both into one folder.")
    return place.relative_to(home)


def _beside(path: Path, source: Path, target: Path) -> Path:
    """The path beside `target` at which to write a file that `source` refers to; its folder is created."""
    out = target.parent / place_beside(path, source)
    out.parent.mkdir(parents=True, exist_ok=True)
    return out


def reason_left(source: Path, target: Path, scale: float, notes: list[str]) -> str:
    """Write one file in metres and return ''; or return why that is impossible (unknown format, in metres already).
    notes : gets what must be said of a file that was written. Raises InputError for a damaged file."""
    suffix = source.suffix.lower()
    if suffix not in {*WITH_OTHERS, *ONE_FILE}:
        return _unknown(source)
    # Logs of other programs may end in .out, too.
    left = (UsageError, InputError) if suffix == BUNDLER else UsageError
    try:
        notes += told_of(source, scale_file(source, target, scale))
    except left as error:
        target.unlink(missing_ok=True)
        return error.message
    return ""


def _unknown(source: Path) -> str:
    return f"{source}: {source.suffix or 'a file without suffix'} cannot be scaled"
