"""Camera files in JSON: nerfstudio's and instant-ngp's transforms.json, OpenSfM's and ODM's reconstruction.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .beside import beside
from .mark import MARK, mark, refuse_marked


def read_json(path: Path) -> Any:
    """The JSON in `path`. Raises InputError."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})", "Check the file and its permissions.") from error
    except ValueError as error:
        raise InputError(f"{path}: not JSON ({error})", "The file is damaged or was cut off: copy it again.") from error


def scale_transforms(source: Path, target: Path, scale: float) -> list[Path]:
    """Write a transforms.json in metres; returns the point cloud beside it that must be scaled as well.

    The cameras' positions grow, and the shift of ``applied_transform``, which leads back to the world before
    nerfstudio turned it. ``applied_scale`` stays: its world is now the metric one. Raises InputError, UsageError.
    """
    text = read_json(source)
    try:
        if MARK in text:
            refuse_marked(source)
        for frame in text["frames"]:
            frame["transform_matrix"] = _grown(frame["transform_matrix"], (4, 4), scale)
        if "applied_transform" in text:
            text["applied_transform"] = _grown(text["applied_transform"], (3, 4), scale)
        cloud = text.get("ply_file_path")
        text[MARK] = mark(scale)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{source}: not a transforms.json ({error!r})", 'Expected {"frames": [...]}.') from error
    target.write_text(json.dumps(text, indent=1), encoding="utf-8")
    found = beside(source, cloud or "")
    return [] if found is None else [found]


def scale_reconstruction(source: Path, target: Path, scale: float) -> None:
    """Write an OpenSfM reconstruction.json in metres: shots, rigs and points. Raises InputError, UsageError."""
    text = read_json(source)
    try:
        for part in text:
            if MARK in part:
                refuse_marked(source)
            for shot in part["shots"].values():
                shot["translation"] = _grown(shot["translation"], (3,), scale)
            for rigid in (*part.get("rig_instances", {}).values(), *part.get("rig_cameras", {}).values()):
                rigid["translation"] = _grown(rigid["translation"], (3,), scale)
            for point in part.get("points", {}).values():
                point["coordinates"] = _grown(point["coordinates"], (3,), scale)
            part[MARK] = mark(scale)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{source}: not an OpenSfM reconstruction ({error!r})", 'Expected [{"cameras", "shots", "points"}].'
        ) from error
    target.write_text(json.dumps(text), encoding="utf-8")


def _grown(values: Any, shape: tuple[int, ...], scale: float) -> list:
    """`values` with its lengths times `scale`: a vector, or the last column of a pose's first three rows."""
    array = np.array(values, float)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{np.shape(values)} values where {shape} finite ones belong")
    if len(shape) == 1:
        array *= scale
    else:
        array[:3, 3] *= scale
    return array.tolist()
