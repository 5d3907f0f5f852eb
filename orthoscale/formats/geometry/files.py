"""Scales any file that is in a model's units to metres."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from ...errors import InputError, UsageError
from .dense import scale_depth_map
from .gltf import scale_glb, scale_gltf
from .mesh import CLOUDS, MESHES, scale_mesh
from .obj import scale_obj
from .ply import scale_ply
from .poses import read_poses, scale_reconstruction, scale_transforms
from .text_models import SUFFIXES, scale_text_model

KNOWN = (
    "PLY (splats too), OBJ, GLB, glTF, transforms.json, reconstruction.json, bundle.out, NVM, depth maps, folders of "
    "COLMAP"
)


def scale_file(source: Path, target: Path, scale: float) -> list[str]:
    """Write the file `source`, in model units, to `target`, in metres: all lengths times `scale`; returns what there is
    to say.

    Files that it refers to (materials, buffers, point clouds) come along beside `target`. Raises InputError for a
    missing, damaged or unknown file, UsageError for one that is in metres already.
    """
    suffix = source.suffix.lower()
    companions: list[Path] = []
    clouds: list[Path] = []
    if suffix == ".ply":
        scale_ply(source, target, scale)
    elif suffix == ".obj":
        companions = scale_obj(source, target, scale)
    elif suffix == ".glb":
        scale_glb(source, target, scale)
    elif suffix == ".gltf":
        companions = scale_gltf(source, target, scale)
    elif suffix == ".json" and isinstance(read_poses(source), list):
        scale_reconstruction(source, target, scale)
    elif suffix == ".json":
        clouds = scale_transforms(source, target, scale)
    elif suffix == ".bin" and source.parent.name == "depth_maps":
        scale_depth_map(source, target, scale)
    elif suffix in SUFFIXES:
        scale_text_model(source, target, scale)
    elif suffix in MESHES | CLOUDS:
        scale_mesh(source, target, scale)
    else:
        raise InputError(f"{source}: {suffix or 'a file without suffix'} cannot be scaled", f"Known are: {KNOWN}.")
    for path in companions:
        beside = _beside(path, source, target)
        if not beside.exists():
            shutil.copyfile(path, beside)
    for path in clouds:
        scale_ply(path, _beside(path, source, target), scale)
    return [f"with {path.name}" for path in (*companions, *clouds)]


def _beside(path: Path, source: Path, target: Path) -> Path:
    """Where a file that `source` refers to goes; never out of the target's folder."""
    place = Path(os.path.realpath(path))
    home = os.path.realpath(source.parent)
    if not place.is_relative_to(home):
        raise InputError(f"{source} refers to {path}, which lies outside its folder", "Move both into one folder.")
    out = target.parent / place.relative_to(home)
    out.parent.mkdir(parents=True, exist_ok=True)
    return out


def reason_left(source: Path, target: Path, scale: float) -> str:
    """Write one file of geometry in metres and return '', or return why it cannot be (no Open3D, unknown format)."""
    try:
        scale_file(source, target, scale)
    except UsageError as error:
        return error.message
    except InputError as error:
        if source.suffix.lower() in {".ply", ".obj", ".glb", ".gltf"}:
            raise  # damaged
        return error.message
    return ""
