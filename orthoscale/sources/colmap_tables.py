"""The content of the files of a COLMAP model as plain values, and the errors for damaged files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import InputError

NO_POINT = 2**64 - 1  # the point id of an observation without a point
CAMERA_SENSOR = 0  # a type of sensor
IDENTITY = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # a pose, qw qx qy qz tx ty tz
TABLES = ("cameras", "images", "points3D")
RIG_TABLES = ("rigs", "frames")
FILE_NAMES = {f"{table}.{form}" for table in (*TABLES, *RIG_TABLES) for form in ("bin", "txt")}
# Model id: name, number of parameters, how many of them (the first ones) are focal lengths.
CAMERA_MODELS = {
    0: ("SIMPLE_PINHOLE", 3, 1),
    1: ("PINHOLE", 4, 2),
    2: ("SIMPLE_RADIAL", 4, 1),
    3: ("RADIAL", 5, 1),
    4: ("OPENCV", 8, 2),
    5: ("OPENCV_FISHEYE", 8, 2),
    6: ("FULL_OPENCV", 12, 2),
    7: ("FOV", 5, 2),
    8: ("SIMPLE_RADIAL_FISHEYE", 4, 1),
    9: ("RADIAL_FISHEYE", 5, 1),
    10: ("THIN_PRISM_FISHEYE", 12, 2),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16, 2),
    12: ("SIMPLE_DIVISION", 4, 1),
    13: ("DIVISION", 5, 2),
    14: ("SIMPLE_FISHEYE", 3, 1),
    15: ("FISHEYE", 4, 2),
    16: ("EUCM", 6, 2),
}
MODEL_IDS = {name: model for model, (name, _, _) in CAMERA_MODELS.items()}
SENSOR_TYPES = {"CAMERA": 0, "IMU": 1}
NOT_UTF8_HINT = (
    "Older Windows programs write names beyond ASCII like this: give the images plain names and reconstruct again. "
    "Otherwise the file is damaged: copy the model again."
)
SPHERICAL = ("EQUIRECTANGULAR", "equirectangular", "spherical")  # names in COLMAP and nerfstudio, and in OpenSfM
CUT_VIEWS = "Cut perspective views out of the panoramas first."
WRITE_ANEW = "The file is damaged: copy the model again, or write it anew with `colmap model_converter`."


@dataclass(frozen=True)
class CameraRow:
    """One camera: its place in the file, its model's id, its size [px], its parameters in COLMAP's order."""

    where: str
    model: int
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True)
class ImageRow:
    """A registered image and its observations; the pose is camera_from_world. where : its place in the file."""

    where: str
    id: int
    pose: tuple[float, ...]  # qw qx qy qz tx ty tz
    camera: int
    name: str
    xy: np.ndarray  # (K, 2)
    points: np.ndarray  # (K,) uint64, NO_POINT for none


@dataclass(frozen=True)
class Points:
    """All 3D points at once."""

    path: Path
    ids: np.ndarray  # (P,) uint64
    values: np.ndarray  # (P, 4) x y z error
    track_of: np.ndarray  # (T,) index of the point each track element belongs to
    tracks: np.ndarray  # (T, 2) image id, index of the observation in the image


@dataclass(frozen=True)
class RigRow:
    """Sensors that are mounted together, each with its pose in the rig; the reference sensor has none."""

    where: str
    sensors: list[tuple[int, int, tuple[float, ...]]]  # type, id, pose or ()


@dataclass(frozen=True)
class FrameRow:
    """One pose of a rig, and the data that its sensors recorded there."""

    where: str
    rig: int
    pose: tuple[float, ...]
    data: list[tuple[int, int, int]]  # sensor type, sensor id, data id


@dataclass
class Tables:
    """A model's data as they stand in its files, unprocessed. paths : the files, by table."""

    cameras: dict[int, CameraRow] = field(default_factory=dict)
    images: list[ImageRow] = field(default_factory=list)
    points: Points = field(init=False)
    rigs: dict[int, RigRow] | None = None
    frames: dict[int, FrameRow] | None = None
    paths: dict[str, Path] = field(default_factory=dict)


def damaged(where: str, what: str, hint: str = WRITE_ANEW) -> InputError:
    """The error that says `what` is wrong, and `where`: a file and a place in it."""
    return InputError(f"{where}: {what}", hint)


def add(table: dict, key: int, value: object, where: str, kind: str) -> None:
    """Put `value`, a `kind` with the id `key`, into `table`. Raises InputError if the id is there already."""
    if key in table:
        raise damaged(where, f"{kind} {key} appears twice")
    table[key] = value


def unknown_camera(where: str, camera: int, model: object) -> InputError:
    """The error for a camera whose model (an id or a name) is not among `CAMERA_MODELS`."""
    if model == 17 or model in SPHERICAL:
        return damaged(where, f"camera {camera} is spherical (EQUIRECTANGULAR)", CUT_VIEWS)
    return damaged(where, f"camera {camera} has the unknown model {model}")
