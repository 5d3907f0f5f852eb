"""Writes a COLMAP model in metres, and reads it back as a check."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError, OutputError
from ..formats.geometry.sim3 import Sim3
from .colmap_check import check_model
from .colmap_read import read_model

if TYPE_CHECKING:
    import pycolmap

POSITION = 1e-9  # how far rounding may move a point or a camera, as a share of the model's size
REPROJECTION = 1e-9  # [px] how far rounding may move a projection in a model near its origin
ROUNDINGS = 64  # rounding error from file to pixel, at most, in machine epsilons of the coordinates


def write_scaled(source: Path, form: str, model: pycolmap.Reconstruction, folder: Path, scale: float) -> None:
    """Write the model in `source`, which was read as `model`, into the empty `folder` with all lengths times `scale`.

    Raises InputError if `source` has changed since, OutputError if the written files do not read back as `model` in
    metres: the same cameras, tracks and observations, all positions to 1e-9 and all projections to 1e-9 px.
    """
    from .colmap_library import pycolmap

    scaled = read_model(source, form)
    if len(scaled.points3D) != len(model.points3D):
        raise InputError(f"{source} changed while it was being worked on", "Run again.")
    scaled.transform(pycolmap.Sim3d(Sim3(scale).scale, pycolmap.Rotation3d(), np.zeros(3)))
    try:
        scaled.write_binary(str(folder)) if form == "bin" else scaled.write_text(str(folder))
    except (OSError, RuntimeError, ValueError) as error:
        raise OutputError(f"{folder}: writing failed ({error})", "Check permissions and free space.") from error
    del scaled
    try:
        check_model(folder, form)
        written = read_model(folder, form)
    except InputError as error:
        raise OutputError(f"{error.message} (just written)", "The disk may be full. Nothing was kept.") from error
    require_same(model, written, scale, folder)


def require_same(
    model: pycolmap.Reconstruction,
    written: pycolmap.Reconstruction,
    scale: float,
    out: Path,
    position: float = POSITION,
) -> None:
    """Raise OutputError if the model `written` to `out` differs from `model` scaled by `scale`.

    position : by how much a point or a camera may be off, as a share of the model's size.
    """
    problem = (
        _other_contents(model, written)
        or _moved(model, written, scale, position)
        or _seen_otherwise(model, written, scale)
    )
    if problem:
        raise OutputError(f"{out}: the written model differs: {problem}", "Please report this with the model.")


def _other_contents(model: pycolmap.Reconstruction, written: pycolmap.Reconstruction) -> str:
    """What differs, in words, or '', of what the scale does not change: the numbers of everything, the cameras, the
    sensors of rigs, and which images are registered."""
    for what in ("cameras", "images", "points3D", "frames", "rigs"):
        if set(getattr(model, what)) != set(getattr(written, what)):
            return f"{len(getattr(model, what))} {what} became {len(getattr(written, what))}"
    if model.compute_num_observations() != written.compute_num_observations():
        return f"{model.compute_num_observations()} observations became {written.compute_num_observations()}"
    for number, camera in model.cameras.items():
        other = written.cameras[number]
        if camera.model != other.model or (camera.width, camera.height) != (other.width, other.height):
            return f"camera {number} has another model or size"
        if not np.allclose(camera.params, other.params, rtol=1e-12, atol=0):
            return f"camera {number} has other parameters"
    if _sensor_places(model).keys() != _sensor_places(written).keys():
        return "rigs have other sensors"
    if sorted(model.reg_image_ids()) != sorted(written.reg_image_ids()):
        return "other images are registered"
    return ""


def _moved(model: pycolmap.Reconstruction, written: pycolmap.Reconstruction, scale: float, position: float) -> str:
    """The same of the positions of points, cameras and sensors, and of the points' stored errors."""
    # This includes sensors without images, whose positions cannot be checked by cameras.
    places, new_places = (_sensor_places(m) for m in (model, written))
    sensors, new_sensors = (np.array([p[key] for key in sorted(places)]).reshape(-1, 3) for p in (places, new_places))
    ids, image_ids = sorted(model.points3D), model.reg_image_ids()
    points, new_points = (np.array([m.points3D[i].xyz for i in ids]) for m in (model, written))
    errors, new_errors = (np.array([m.points3D[i].error for i in ids]) for m in (model, written))
    centres, new_centres = (np.array([m.image(i).projection_center() for i in image_ids]) for m in (model, written))
    size = scale * max(np.abs(points).max(), np.abs(centres).max(), np.abs(sensors).max(initial=0))
    moved = ("point", points, new_points), ("camera", centres, new_centres), ("sensor of a rig", sensors, new_sensors)
    for what, old, new in moved:
        error = np.abs(new - scale * old).max(initial=0)
        if not error <= position * size:
            return f"a {what} is {error:.3g} off"
    if np.abs(new_errors - errors).max() > REPROJECTION:
        return f"point {ids[np.abs(new_errors - errors).argmax()]} has another stored error"
    return ""


def _seen_otherwise(model: pycolmap.Reconstruction, written: pycolmap.Reconstruction, scale: float) -> str:
    """The same of the images' names, of which points they observe, and of where they project these."""
    ids = np.array(sorted(model.points3D))
    points = np.array([model.points3D[number].xyz for number in ids])
    for i in model.reg_image_ids():
        before, after = model.image(i), written.image(i)
        if before.name != after.name or before.num_points2D() != after.num_points2D():
            return f"image {i} has another name or other observations"
        seen = [p.point3D_id for p in before.points2D if p.has_point3D()]
        if seen != [p.point3D_id for p in after.points2D if p.has_point3D()]:
            return f"image {i} ({before.name}) observes other points"
        if problem := _reprojection(before, after, points[np.searchsorted(ids, np.array(seen, ids.dtype))], scale):
            return problem
    return ""


def _sensor_places(model: pycolmap.Reconstruction) -> dict[tuple[int, str, int], np.ndarray]:
    """(3,) translations of the sensors in their rigs, by rig, kind and number, as far as known."""
    return {
        (number, sensor.type.name, sensor.id): pose.translation
        for number, rig in model.rigs.items()
        for sensor, pose in rig.non_ref_sensors.items()
        if pose is not None
    }


def _reprojection(before: pycolmap.Image, after: pycolmap.Image, points: np.ndarray, scale: float) -> str:
    """What is wrong, in words, if `after` projects `points` (K, 3) [old model units] elsewhere than `before`; empty if
    nothing is."""
    if not len(points):
        return ""
    camera, old, new = before.camera, before.cam_from_world(), after.cam_from_world()
    assert camera is not None, "an image of a model has its camera"
    there = points @ old.rotation.matrix().T + old.translation
    then = (scale * points) @ new.rotation.matrix().T + new.translation
    ahead = there[:, 2] > 0
    if (ahead != (then[:, 2] > 0)).any():
        return f"a point went behind image {before.name}"
    first, second = (np.array(camera.img_from_cam(p[ahead]), float).reshape(-1, 2) for p in (there, then))
    move = np.abs(first - second).max(1)
    # Far from the origin (map coordinates) rounding alone moves a projection.
    reach = np.abs(points[ahead]).max(1) + np.abs(old.translation).max()
    rounding = ROUNDINGS * np.finfo(float).eps * reach / there[ahead, 2] * camera.mean_focal_length()
    excess = move - (REPROJECTION + rounding)
    if (excess > 0).any():  # not for NaN, where a lens has no image of a point
        return f"image {before.name}: a point is projected {move[excess.argmax()]:.3g} px elsewhere"
    return ""
