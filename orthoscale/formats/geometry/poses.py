"""Camera files in JSON: nerfstudio's and instant-ngp's transforms.json, OpenSfM's and ODM's reconstruction.json, and
the cameras.json that trainers of Gaussian splats write beside them (Kerbl et al. 2023)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.spatial.transform import Rotation

from ...errors import InputError, UsageError
from ..other_programs import BY_KEY, what_instead
from ..reading import HUGE, checked, read_plain
from .beside import Referred, beside
from .mark import MARK, mark, refuse_marked

INTEGER_DEPTH = "integer_depth_scale"
POSES = ("transform_matrix", "transform_matrix_start", "transform_matrix_end")  # the last two for a rolling shutter
# Other lengths: what bounds the part of the world that is rendered, and the velocity of a camera [units / s], for
# rolling shutters and motion blur (3DGS with motion deblurring, Seiskari et al. 2024).
OTHER_LENGTHS = ("aabb", "near", "far", "camera_linear_velocity")
CLOUD_FILE = "sparse_pc.ply"  # nerfstudio's point cloud, beside a transforms.json that names none
SPLAT_CAMERAS = "cameras.json"
POSES_HINT = 'Expected nerfstudio\'s {"frames": [...]} or OpenSfM\'s [{"cameras", "shots", "points"}].'


def read_poses(path: Path) -> dict[str, Any] | list[dict[str, Any]]:
    """The plain values of a transforms.json, a mapping, or of a reconstruction.json, a list. Raises InputError."""
    from ..schemas.models import OpensfmPart, Transforms

    text = read_plain(path, "a JSON of cameras", POSES_HINT, HUGE)
    keys = BY_KEY.keys() & text if isinstance(text, dict) else ()
    hint = what_instead(path) or next((BY_KEY[key] for key in keys), POSES_HINT)
    if isinstance(text, list):
        checked(text, list[OpensfmPart], str(path), "an OpenSfM reconstruction", hint)
        if not text:
            raise InputError(f"{path}: not an OpenSfM reconstruction (it holds none)", POSES_HINT)
    else:
        checked(text, Transforms, str(path), "a transforms.json", hint)
    return text


def read_splat_cameras(path: Path) -> list[dict[str, Any]]:
    """The plain values of a splat's cameras.json. Raises InputError."""
    from ..schemas.models import SplatCamera

    hint = 'Expected [{"img_name", "position", "rotation" ...}], as it lies beside a Gaussian splat.'
    text = read_plain(path, "a splat's list of cameras", hint, HUGE)
    checked(text, list[SplatCamera], str(path), "a splat's list of cameras", hint)
    if not text:
        raise InputError(f"{path}: not a splat's list of cameras (it holds none)", hint)
    return text


def splat_centres(path: Path) -> dict[str, np.ndarray]:
    """(3,) centre of each camera of a splat's cameras.json, by its image's name. Raises InputError."""
    return {each["img_name"]: np.array(each["position"], float) for each in read_splat_cameras(path)}


def scale_splat_cameras(source: Path, target: Path, scale: float) -> None:
    """Write a splat's cameras.json with the positions in metres. Raises InputError; UsageError for one in metres
    already."""
    text = read_splat_cameras(source)
    for each in text:
        if MARK in each:
            refuse_marked(source)
        each["position"] = _grown(each["position"], scale)
        each[MARK] = mark(scale)
    target.write_text(json.dumps(text), encoding="utf-8")


def camera_centres(text: dict[str, Any] | list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """(3,) centre of each camera in the result `text` of `read_poses`, by its image's name; of several reconstructions,
    those of the first."""
    if isinstance(text, dict):
        return {frame["file_path"]: np.array(frame["transform_matrix"], float)[:3, 3] for frame in text["frames"]}
    return {
        name: -Rotation.from_rotvec(shot["rotation"]).inv().apply(shot["translation"])
        for name, shot in text[0]["shots"].items()
    }


def scale_transforms(source: Path, target: Path, scale: float) -> tuple[Referred, list[str]]:
    """Write a transforms.json in metres; returns the point cloud that must be scaled as well, and notes for the user.

    Scaled are the cameras' positions and velocities, the scene's box and depth range, the shift of
    ``applied_transform``, which leads back to the world before nerfstudio rotated it, and instant-ngp's
    ``integer_depth_scale``, the length of one step of its depth maps. ``applied_scale`` stays: its world is now the
    metric one. Raises InputError, UsageError.
    """
    text = cast("dict[str, Any]", read_poses(source))
    if MARK in text:
        refuse_marked(source)
    for frame in text["frames"]:
        for name in (name for name in POSES if frame.get(name) is not None):
            frame[name] = _grown(frame[name], scale)
    for part in (text, *text["frames"]):
        for name in (name for name in OTHER_LENGTHS if name in part):
            part[name] = _each(part[name], scale)
    if "applied_transform" in text:
        text["applied_transform"] = _grown(text["applied_transform"], scale)
    notes = []
    if INTEGER_DEPTH in text:
        text[INTEGER_DEPTH] *= scale
    elif any(frame.get("depth_file_path") for frame in text["frames"]):
        notes.append(f"the depth maps that it names stay in model units: multiply them by {scale:.9g}")
    if "scale" in text:
        notes.append('its "scale", which instant-ngp multiplies positions by, is unchanged')
    text[MARK] = mark(scale)
    target.write_text(json.dumps(text, indent=1), encoding="utf-8")
    cloud = Referred()
    if "ply_file_path" in text or beside(source, CLOUD_FILE) is not None:
        cloud.add(source, [cloud_name(text)])
    return cloud, notes


def cloud_name(text: Mapping[str, Any]) -> str:
    """The path of the point cloud of a transforms.json, relative to the folder of that."""
    return text.get("ply_file_path", CLOUD_FILE)


def scale_reconstruction(source: Path, target: Path, scale: float) -> None:
    """Write an OpenSfM reconstruction.json in metres: shots, rigs and points. Raises InputError; UsageError for one
    that is in metres already, and for several reconstructions, each of which has a scale of its own."""
    text = read_poses(source)
    if len(text) > 1:
        raise UsageError(
            f"{source} holds {len(text)} reconstructions, each with a scale of its own",
            "`orthoscale fix` of that file measures and writes the largest one.",
        )
    for part in cast("list[dict[str, Any]]", text):
        if MARK in part:
            refuse_marked(source)
        for shot in (*part["shots"].values(), *part.get("pano_shots", {}).values()):
            shot["translation"] = _grown(shot["translation"], scale)
            if "vertices" in shot:  # of the mesh that OpenSfM keeps for each shot
                shot["vertices"] = _each(shot["vertices"], scale)
            if shot.get("covariance") is not None:  # (6, 6) of rotation and translation
                lengths = np.array([1, 1, 1, scale, scale, scale])
                shot["covariance"] = (np.array(shot["covariance"], float) * np.outer(lengths, lengths)).tolist()
        for rigid in (*part.get("rig_instances", {}).values(), *part.get("rig_cameras", {}).values()):
            rigid["translation"] = _grown(rigid["translation"], scale)
        for point in part.get("points", {}).values():
            point["coordinates"] = _grown(point["coordinates"], scale)
        part[MARK] = mark(scale)
    target.write_text(json.dumps(text), encoding="utf-8")


def _each(value: Any, scale: float) -> Any:
    """`value`, a number or nested lists of numbers, times `scale`."""
    if isinstance(value, list):
        return [_each(each, scale) for each in value]
    return value * scale if isinstance(value, (int, float)) else value


def _grown(values: Any, scale: float) -> list:
    """`values` with its lengths times `scale`: a vector, or the last column of a pose's first three rows."""
    array = np.array(values, float)
    if array.ndim == 1:
        array *= scale
    else:
        array[:3, 3] *= scale
    return array.tolist()
