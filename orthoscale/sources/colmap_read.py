"""Reads a COLMAP model with pycolmap, once its files have been checked, and finds its registered images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError

if TYPE_CHECKING:
    import pycolmap


def read_model(folder: Path, form: str) -> pycolmap.Reconstruction:
    """The model in `folder` of the format `form` ('bin' or 'txt'), whose files have been checked before.

    Raises InputError for one that pycolmap cannot read or that has no registered image.
    """
    from .colmap_library import pycolmap

    model = pycolmap.Reconstruction()
    try:
        model.read_binary(str(folder)) if form == "bin" else model.read_text(str(folder))
    except Exception as error:  # whatever its C++ code and the bindings throw
        raise InputError(f"{folder}: pycolmap cannot read the model ({error})", "Copy the model again.") from error
    if not model.num_reg_images():
        raise InputError(f"{folder}: no registered image", "Give a model that COLMAP reconstructed.")
    # Other programs write quaternions with few digits; pycolmap normalises them when it scales, but not when it reads.
    for frame in model.frames.values():
        pose = frame.rig_from_world
        frame.rig_from_world = pycolmap.Rigid3d(_unit(pose.rotation), pose.translation)
    for rig in model.rigs.values():
        for sensor, pose in rig.non_ref_sensors.items():
            if pose is not None:
                rig.set_sensor_from_rig(sensor, pycolmap.Rigid3d(_unit(pose.rotation), pose.translation))
    return model


def _unit(rotation: pycolmap.Rotation3d) -> pycolmap.Rotation3d:
    rotation.normalize()
    return rotation


def images_of(model: pycolmap.Reconstruction) -> dict[str, pycolmap.Image]:
    """The registered images of `model` by name."""
    images = (model.image(number) for number in model.reg_image_ids())
    return {image.name: image for image in images}


def cameras_of(model: pycolmap.Reconstruction) -> dict[str, pycolmap.Camera]:
    """The camera of each registered image of `model`, by the image's name."""
    return {name: model.camera(image.camera_id) for name, image in images_of(model).items()}
