"""Reconstructions of other programs: OpenSfM's and ODM's reconstruction.json, nerfstudio's transforms.json.

They are read into the same model as COLMAP's, measured in the same way, and written back in their own format, in
metres.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..core.claims import BY_ORTHOSCALE
from ..core.remarks import informing
from ..errors import InputError
from ..formats.geometry.beside import beside
from ..formats.geometry.files import place_beside, scale_file, told_of
from ..formats.geometry.mark import MARK
from ..formats.geometry.ply import read_points
from ..formats.geometry.poses import cloud_name, read_poses
from ..formats.reading import reason
from .colmap_check import FARTHEST
from .colmap_read import cameras_of
from .colmap_tables import CUT_VIEWS, SPHERICAL
from .consistency import Observations, check_consistency, loose_images, observations, some_of_each
from .fingerprint import Stamp
from .frame_check import check_frames, points_seen
from .frames import find_frames
from .one_file import OneFileSource

if TYPE_CHECKING:
    import pycolmap

READ_WHOLE = 4e6  # [bytes] up to which a file of tracks is read whole: some 40,000 observations
# A longer one is read at READ_AT places for each image, READ_BYTES each, which is some 40 observations.
READ_AT, READ_BYTES = 4, 4096
GPS_DOP = 1000.0  # a DOP from which OpenSfM means that there was no GPS
# OpenSfM's projection types: COLMAP's camera model and its parameters, from focal lengths, centre [px] and distortion.
OPENSFM = {
    "perspective": ("RADIAL", ("f", "cx", "cy", "k1", "k2")),
    "simple_radial": ("OPENCV", ("fx", "fy", "cx", "cy", "k1", "0", "0", "0")),
    "radial": ("OPENCV", ("fx", "fy", "cx", "cy", "k1", "k2", "0", "0")),
    "brown": ("FULL_OPENCV", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "0", "0", "0")),
    "fisheye": ("RADIAL_FISHEYE", ("f", "cx", "cy", "k1", "k2")),
    "fisheye_opencv": ("OPENCV_FISHEYE", ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")),
}
NERFSTUDIO = {
    "SIMPLE_PINHOLE": ("PINHOLE", ("fx", "fy", "cx", "cy")),
    "PINHOLE": ("PINHOLE", ("fx", "fy", "cx", "cy")),
    "OPENCV": ("FULL_OPENCV", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "0", "0", "0")),
    "OPENCV_FISHEYE": ("OPENCV_FISHEYE", ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")),
}


@dataclass(frozen=True, eq=False)
class ExchangeSource(OneFileSource):
    """A reconstruction in one JSON file, with its frames. Made by `ExchangeSource.open`."""

    _marked: bool = False  # as in `_Content`
    _aligned: bool = False

    @classmethod
    def open(
        cls, path: Path | str, images: Path | str | None = None, need_images: bool = True, compare_frames: bool = True
    ) -> ExchangeSource:
        """Open the file `path`; otherwise like `ColmapSource.open`. Raises InputError."""
        path = Path(path)
        stamp = Stamp.of(path)
        content = _read(path)
        model, seen = content.model, _seen(path, content)
        # Of a sample it cannot be told what an image has: those with few observations may have none in it.
        loose = loose_images(model, seen) if _read_whole(_tracks_of(path)) else frozenset()
        consistency = check_consistency(path, model, seen, loose)
        pictures, missing = find_frames(model, path.parent, images, need_images, loose)
        notes = [*informing(content.notes), *consistency, *missing]
        if compare_frames:
            notes += check_frames(model, pictures, points_seen(model, seen))
        return cls(
            path=path,
            folder=path.parent,
            input_format="json",
            pictures=pictures,
            notes=notes,
            images=None if images is None else Path(images),
            need_images=need_images,
            _paths=(path, *content.clouds),
            _model=model,
            _stamps=(stamp, *map(Stamp.of, content.clouds)),
            _loose=loose,
            _marked=content.marked,
            _aligned=content.aligned,
        )

    @property
    def by_orthoscale(self) -> bool:
        """Whether orthoscale wrote it, and left its mark in it."""
        return self._marked

    @property
    def metric_already(self) -> str:
        """Why it counts as metric: orthoscale's mark, OpenSfM's alignment with GPS, or as for any model; or empty."""
        if self.by_orthoscale:
            return BY_ORTHOSCALE
        return "OpenSfM aligned it with the GPS of its images" if self._aligned else self._georeferenced

    def check_writable(self) -> None:
        """Raise InputError for a point cloud outside the file's folder: its copy would have no place in the output."""
        for path in self._paths[1:]:
            place_beside(path, self.path)

    def _write_file(self, out: Path, scale: float) -> None:
        text = read_poses(self.path)
        if isinstance(text, list) and len(text) > 1:  # each has its own scale, and only one was found
            alone = out.parent / "largest.json"
            alone.write_text(json.dumps([_largest(self.path, text)[0]]), encoding="utf-8")
            scale_file(alone, out, scale)
            alone.unlink()
        else:
            self.notes.extend(informing(told_of(self.path, scale_file(self.path, out, scale))))

    def _read_back(self, out: Path) -> pycolmap.Reconstruction:
        return _read(out).model


class _Content(NamedTuple):
    """What a file holds. clouds : files of its points. notes : for the user. tracks : of the model's points, in their
    order. marked : whether orthoscale left its mark in it. aligned : whether OpenSfM aligned it with the GPS of its
    images."""

    model: pycolmap.Reconstruction
    clouds: list[Path]
    notes: list[str]
    tracks: list[str]
    marked: bool
    aligned: bool


def _read(path: Path) -> _Content:
    """The content of the file `path`. Raises InputError."""
    text = read_poses(path)
    try:
        if isinstance(text, list):
            part, notes = _largest(path, text)
            return _Content(_opensfm(path, part), [], notes, list(part["points"]), MARK in part, _aligned(part))
        return _Content(*_nerfstudio(path, text), [], [], MARK in text, False)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, RuntimeError) as error:
        raise InputError(
            f"{path}: neither OpenSfM's reconstruction.json nor nerfstudio's transforms.json ({reason(error)})",
            "The file may be damaged: copy it again, or export it again.",
        ) from error


def _largest(path: Path, text: list[dict[str, Any]]) -> tuple[dict[str, Any], list[str]]:
    """The reconstruction with the most images in OpenSfM's list, and a note if there are others."""
    sizes = [len(part["shots"]) for part in text]
    best = text[int(np.argmax(sizes))]
    if len(text) == 1:
        return best, []
    note = f"{path} holds {len(text)} reconstructions: that of {max(sizes)} images is scaled, the others are left out"
    return best, [note]


def _aligned(part: dict[str, Any]) -> bool:
    """Whether OpenSfM aligned its reconstruction `part` with the GPS of its images."""
    placed = [s for s in part["shots"].values() if s.get("gps_dop", GPS_DOP) < GPS_DOP and "gps_position" in s]
    return "reference_lla" in part and len(placed) >= 3


def _seen(path: Path, content: _Content) -> Observations:
    """A sample of observations from OpenSfM's tracks.csv beside the reconstruction; none if that is missing.

    The lines hold image, track, feature, x, y and more, separated by tabs; x and y are in units of `_opensfm`. Other
    lines are skipped.
    """
    cameras = cameras_of(content.model)
    points = {track: k for k, track in enumerate(content.tracks)}
    found: dict[str, list[tuple[float, float, int]]] = {name: [] for name in cameras}
    for line in _some_lines(_tracks_of(path), READ_AT * len(cameras)) if points else ():
        name, track, _, x, y, *_ = [*line.split("\t"), *[""] * 5]
        if name in found and track in points:
            with contextlib.suppress(ValueError):
                found[name].append((float(x), float(y), points[track]))
    place = np.array([point.xyz for _, point in sorted(content.model.points3D.items())])
    pairs = []
    for (name, seen), some in zip(found.items(), some_of_each([len(v) for v in found.values()]), strict=True):
        x, y, number = np.array(seen, float).reshape(-1, 3)[some].T
        size = np.array([cameras[name].width, cameras[name].height])
        pairs.append((np.column_stack([x, y]) * size.max() + size / 2, number.astype(int)))
    return observations(list(cameras), pairs, place)


def _tracks_of(path: Path) -> Path:
    return path.with_name("tracks.csv")


def _read_whole(path: Path) -> bool:
    """Whether the file `path` is so short that it is read whole; also if there is none."""
    return not path.exists() or path.stat().st_size <= READ_WHOLE


def _some_lines(path: Path, places: int) -> Iterator[str]:
    """The lines of a text file; of a long one some at `places` places, spread over it; of a missing one, nothing."""
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            parts = 1 if _read_whole(path) else places
            for k in range(parts):
                file.seek(k * size // parts)
                lines = file.read(size if parts == 1 else READ_BYTES).decode("utf-8", "replace").split("\n")
                yield from lines[1:-1]  # the first is a header or, like the last, incomplete
    except OSError:
        return


def build_model(
    cameras: dict[Any, tuple[str, int, int, list[float]]],
    poses: dict[str, tuple[Any, np.ndarray, np.ndarray]],
    points: np.ndarray,
    colours: np.ndarray,
) -> pycolmap.Reconstruction:
    """A COLMAP model of `cameras` (model, width, height, parameters), `poses` by image name (camera, camera_from_world
    rotation (3, 3) and translation (3,)), and `points` (N, 3). Raises ValueError for impossible values."""
    from .colmap_library import pycolmap

    model = pycolmap.Reconstruction()
    numbers = {key: k for k, key in enumerate(cameras, 1)}
    for key, (name, width, height, params) in cameras.items():
        if not (0 < width < 2**20 and 0 < height < 2**20 and np.isfinite(params).all() and params[0] > 0):
            raise ValueError(f"camera {key} has an impossible size or focal length")
        camera = pycolmap.Camera(camera_id=numbers[key], model=name, width=width, height=height, params=params)
        model.add_camera_with_trivial_rig(camera)
    for k, (name, (key, rotation, translation)) in enumerate(poses.items(), 1):
        values = np.concatenate([rotation.ravel(), translation])
        if not (np.abs(values) <= FARTHEST).all() or np.abs(rotation @ rotation.T - np.eye(3)).max() > 0.01:
            raise ValueError(f"the pose of {name} is not a rotation and a finite position")
        quaternion = Rotation.from_matrix(rotation).as_quat()
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(quaternion), translation)
        image = pycolmap.Image(name=name, camera_id=numbers[key], image_id=k)
        model.add_image_with_trivial_frame(image, pose)
    if not poses or not len(points) or not (np.abs(points) <= FARTHEST).all():
        raise ValueError("no images, no points, or points that are not finite")
    for point, colour in zip(points, colours, strict=True):
        model.add_point3D(point, pycolmap.Track(), colour)
    return model


def _unknown_camera(text: str, kind: str, known: Iterable[str]) -> InputError:
    return InputError(text, CUT_VIEWS if kind in SPHERICAL else f"Known are: {', '.join(known)}.")


def _opensfm(path: Path, part: dict[str, Any]) -> pycolmap.Reconstruction:
    """A model from OpenSfM's: lengths in its images are shares of the longer side, from the middle; its axes are
    COLMAP's."""
    cameras = {}
    used = {shot["camera"] for shot in part["shots"].values()}
    for key, camera in part["cameras"].items():
        if key not in used:  # cameras of unregistered images are listed, too
            continue
        kind = camera.get("projection_type", "perspective")
        if kind not in OPENSFM:
            raise _unknown_camera(f"{path}: camera {key} is of the type {kind}", kind, OPENSFM)
        width, height = int(camera["width"]), int(camera["height"])
        side = max(width, height)
        focal = camera.get("focal_x", camera.get("focal"))
        values = {
            **camera,
            "f": focal * side,
            "fx": focal * side,
            "fy": camera.get("focal_y", focal) * side,
            "cx": width / 2 + camera.get("c_x", 0.0) * side,
            "cy": height / 2 + camera.get("c_y", 0.0) * side,
        }
        name, wanted = OPENSFM[kind]
        cameras[key] = (name, width, height, [float(values.get(k, 0.0)) for k in wanted])
    poses = {
        name: (
            shot["camera"],
            Rotation.from_rotvec(np.array(shot["rotation"], float)).as_matrix(),
            np.array(shot["translation"], float).reshape(3),
        )
        for name, shot in part["shots"].items()
    }
    points = list(part["points"].values())
    xyz = np.array([point["coordinates"] for point in points], float).reshape(-1, 3)
    colours = np.array([point.get("color", (128, 128, 128)) for point in points], float).reshape(-1, 3)
    return build_model(cameras, poses, xyz, colours.clip(0, 255).astype(np.uint8))


def _nerfstudio(path: Path, text: dict[str, Any]) -> tuple[pycolmap.Reconstruction, list[Path]]:
    """A model from nerfstudio's, and the file of its point cloud: its poses are world_from_camera with y up and z back,
    as in OpenGL."""
    cameras: dict[Any, tuple[str, int, int, list[float]]] = {}
    poses = {}
    for frame in text["frames"]:
        own = {**text, **frame}
        # instant-ngp and its colmap2nerf.py mark a fisheye by this alone; its lens model is OpenCV's.
        kind = own.get("camera_model", "OPENCV_FISHEYE" if own.get("is_fisheye") else "OPENCV")
        if kind not in NERFSTUDIO:
            raise _unknown_camera(f"{path}: cameras of the model {kind}", kind, NERFSTUDIO)
        width, height = int(own["w"]), int(own["h"])
        fx = own["fl_x"] if "fl_x" in own else width / 2 / np.tan(own["camera_angle_x"] / 2)
        values = {
            **own,
            "fx": fx,
            "fy": own.get("fl_y", fx),
            "cx": own.get("cx", width / 2),
            "cy": own.get("cy", height / 2),
        }
        name, wanted = NERFSTUDIO[kind]
        params = [float(values.get(k, 0.0)) for k in wanted]
        key = (name, width, height, *params)
        cameras.setdefault(key, (name, width, height, params))
        matrix = np.array(frame["transform_matrix"], float).reshape(4, 4)
        world_from_camera = matrix[:3, :3] * (1.0, -1.0, -1.0)
        rotation = world_from_camera.T
        file = PureWindowsPath(frame["file_path"]).as_posix()
        if file in poses:
            raise ValueError(f"{file} appears twice")
        poses[file] = (key, rotation, -rotation @ matrix[:3, 3])
    name = cloud_name(text)
    cloud = beside(path, name)
    if cloud is None:
        raise InputError(
            f"{path} has no sparse points (there is no {name[:80]} beside it), and the ground is found from them",
            "Make it with a newer ns-process-data, or give the COLMAP model that it came from.",
        )
    return build_model(cameras, poses, *read_points(cloud)), [cloud]
