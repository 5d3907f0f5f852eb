"""Checks the files of a COLMAP model before pycolmap reads them.

pycolmap trusts what it reads: a wrong count takes all memory, a NaN pose loads as valid, random bytes hang it. Here
every count is compared with the file's size, every number must be finite, and every reference must exist.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from .colmap_find import TABLE_READERS, choose_format, find_folder, paths_of
from .colmap_tables import (
    CAMERA_MODELS,
    CAMERA_SENSOR,
    IDENTITY,
    NO_POINT,
    SENSOR_TYPES,
    FrameRow,
    ImageRow,
    RigRow,
    Tables,
    damaged,
)
from .consistency import Observations, observations, some_of_each
from .fingerprint import Stamp

FARTHEST = 1e12  # [units] nothing on Earth is so far, not even in millimetres
NOT_UNIT = 0.01  # by which the norm of a quaternion may differ from 1
SAME_POSE = 1e-4  # [rad] and [of the largest coordinate] by which a pose may differ from that of its frame


@dataclass(frozen=True)
class ModelFiles:
    """A COLMAP model on disk whose files have been checked and are sound.

    path : what was opened, or of several models in it the one that was taken. folder : where it lies. format : 'bin' or
    'txt'. paths : its files. stamps : of these, before they were read. seen : a sample of the images' observations.
    parts : names of the images in each part of the model that shares no point with the rest, the largest first, of two
    images or more.
    notes : what was chosen or left out on the way, for the report.
    """

    path: Path
    folder: Path
    format: str
    paths: tuple[Path, ...]
    stamps: tuple[Stamp, ...]
    seen: Observations
    parts: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()


def open_model(path: Path) -> ModelFiles:
    """Find the model at or below `path` and check it.

    `path` is a folder with cameras, images and points3D (.bin or .txt), or a workspace that has them in `sparse/`,
    `sparse/0` or the like; of several models the one with the most images is taken.
    Raises InputError, saying which file, where in it and which image, for anything missing or damaged.
    """
    path = Path(path)
    folder, others = find_folder(path)
    form, more = choose_format(folder)
    paths = paths_of(folder, form)
    stamps = tuple(map(Stamp.of, paths.values()))
    tables = TABLE_READERS[form](paths)
    _check(tables)
    named, notes = folder if others else path, (*others, *more)
    return ModelFiles(named, folder, form, tuple(paths.values()), stamps, _seen(tables), _parts(tables), notes)


def check_model(folder: Path, form: str) -> None:
    """Check the files of the model in `folder` of the format `form` ('bin' or 'txt'); raises as `open_model`."""
    _check(TABLE_READERS[form](paths_of(folder, form)))


def _check(tables: Tables) -> None:
    """Raise InputError for the first value or reference that cannot be right."""
    _check_cameras(tables)
    _check_images(tables)
    _check_points(tables)
    if tables.rigs is not None and tables.frames is not None:
        _check_rigs(tables, tables.rigs, tables.frames)


def _check_pose(where: str, pose: tuple[float, ...], what: str) -> None:
    if not (np.abs(pose) <= FARTHEST).all():
        raise damaged(where, f"the pose of {what} has a value that is not a finite number, or beyond {FARTHEST:g}")
    norm = np.linalg.norm(pose[:4])
    if abs(norm - 1) > NOT_UNIT:
        raise damaged(where, f"the rotation of {what} is not a unit quaternion (its norm is {norm:.3g})")


def _check_cameras(tables: Tables) -> None:
    for number, camera in tables.cameras.items():
        if not 0 <= number < 2**32 - 1:
            raise damaged(camera.where, f"camera id {number} is out of range")
        if not (0 < camera.width < 2**20 and 0 < camera.height < 2**20):
            raise damaged(camera.where, f"camera {number} has the impossible size {camera.width} x {camera.height} px")
        if not np.isfinite(camera.params).all():
            raise damaged(camera.where, f"camera {number} has a parameter that is not a finite number")
        focals = camera.params[: CAMERA_MODELS[camera.model][2]]
        if min(focals) <= 0:
            raise damaged(camera.where, f"camera {number} has the impossible focal length {min(focals):g} px")


def _check_images(tables: Tables) -> None:
    if not tables.images:
        raise damaged(str(tables.paths["images"]), "no registered image", "Give a model that COLMAP could reconstruct.")
    ids: set[int] = set()
    names: set[str] = set()
    for image in tables.images:
        what = f"image {image.id} ({image.name})"
        if not image.name:
            raise damaged(image.where, f"image {image.id} has no name")
        if not 0 <= image.id < 2**32 - 1:
            raise damaged(image.where, f"{what}: its id is out of range")
        if image.id in ids or image.name in names:
            raise damaged(image.where, f"{what} appears twice, by its id or by its name")
        ids.add(image.id)
        names.add(image.name)
        _check_pose(image.where, image.pose, what)
        if image.camera not in tables.cameras:
            raise damaged(image.where, f"{what} refers to camera {image.camera}, which does not exist")
        if not np.isfinite(image.xy).all():
            raise damaged(image.where, f"{what} has an observation that is not a finite number")


def _check_points(tables: Tables) -> None:
    points, images = tables.points, tables.images
    if not len(points.ids):
        raise damaged(
            str(points.path),
            "no points",
            "The ground is found from sparse points: triangulate them (point_triangulator).",
        )
    # The error has no limit: COLMAP gives a point behind one of its cameras that of the largest double.
    sane = (np.abs(points.values[:, :3]) <= FARTHEST).all(1) & np.isfinite(points.values[:, 3])
    if not sane.all():
        what = f"point {points.ids[~sane][0]} has a value that is not a finite number, or beyond {FARTHEST:g}"
        raise damaged(str(points.path), what)
    order = np.argsort(points.ids)
    known = points.ids[order]
    if (known[1:] == known[:-1]).any():
        raise damaged(str(points.path), f"point {known[1:][known[1:] == known[:-1]][0]} appears twice")

    counts = np.array([len(image.points) for image in images])
    named = np.concatenate([image.points for image in images])
    place = np.minimum(np.searchsorted(known, named), len(known) - 1)
    lost = (named != NO_POINT) & (known[place] != named)
    if lost.any():
        first = int(np.argmax(lost))
        image = images[int(np.searchsorted(np.cumsum(counts), first, side="right"))]
        raise damaged(
            image.where,
            f"image {image.id} ({image.name}) observes point {named[first]}, which is not in {points.path.name}",
            "images and points3D do not belong together: copy both from the same model.",
        )

    ids = np.array([image.id for image in images])
    by_id = np.argsort(ids)
    seen_by = by_id[np.minimum(np.searchsorted(ids[by_id], points.tracks[:, 0]), len(ids) - 1)]
    wrong = (ids[seen_by] != points.tracks[:, 0]) | (points.tracks[:, 1] >= counts[seen_by])
    if not wrong.any():
        observation = (np.cumsum(counts) - counts)[seen_by] + points.tracks[:, 1]
        wrong = named[observation] != points.ids[points.track_of]
    if wrong.any():
        first = int(np.argmax(wrong))
        image, observation = points.tracks[first]
        raise damaged(
            str(points.path),
            f"the track of point {points.ids[points.track_of[first]]} refers to observation {observation} of image "
            f"{image}, which {'is of another point' if image in ids else 'does not exist'}",
            "images and points3D do not belong together: copy both from the same model.",
        )


def _seen(tables: Tables) -> Observations:
    """A sample of the observations in checked `tables`."""
    points = tables.points
    order = np.argsort(points.ids)
    known = points.ids[order]
    with_point = [np.flatnonzero(image.points != NO_POINT) for image in tables.images]
    chosen = some_of_each([len(seen) for seen in with_point])

    def pairs() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for image, seen, some in zip(tables.images, with_point, chosen, strict=True):
            yield image.xy[seen[some]], order[np.searchsorted(known, image.points[seen[some]])]

    return observations([image.name for image in tables.images], pairs(), points.values[:, :3])


def _parts(tables: Tables) -> tuple[tuple[str, ...], ...]:
    """Names of the images in the parts of a model that share no point with each other, the largest part first. Images
    of one frame of a rig are in one part; those that share no point with any other are left out."""
    points, frames = tables.points, (tables.frames or {}).values()
    rigs = [[data for kind, _, data in frame.data if kind == CAMERA_SENSOR] for frame in frames]
    seen = np.concatenate([points.tracks[:, 0], *rigs]).astype(int)  # image ids, of each point and then of each frame
    by = np.concatenate([points.track_of, len(points.ids) + np.repeat(np.arange(len(rigs)), [len(r) for r in rigs])])
    ids = np.array([image.id for image in tables.images])
    order, count = np.argsort(ids), len(ids)
    image = order[np.searchsorted(ids[order], seen)]
    nodes = count + len(points.ids) + len(rigs)
    links = coo_array((np.ones(len(image), bool), (image, count + by.astype(int))), shape=(nodes, nodes))
    _, part = connected_components(links, directed=False)
    names: dict[int, list[str]] = {number: [] for number in part[count:][: len(points.ids)].tolist()}
    for row, number in zip(tables.images, part[:count].tolist(), strict=True):
        if number in names:
            names[number].append(row.name)
    return tuple(sorted((tuple(sorted(some)) for some in names.values() if len(some) > 1), key=len, reverse=True))


def _check_rigs(tables: Tables, rigs: dict[int, RigRow], frames: dict[int, FrameRow]) -> None:
    for number, rig in rigs.items():
        if not rig.sensors:
            raise damaged(rig.where, f"rig {number} has no sensor")
        for kind, sensor, pose in rig.sensors:
            if kind not in SENSOR_TYPES.values():
                raise damaged(rig.where, f"rig {number} has a sensor of the unknown type {kind}")
            if kind == CAMERA_SENSOR and sensor not in tables.cameras:
                raise damaged(rig.where, f"rig {number} refers to camera {sensor}, which does not exist")
            if pose:
                _check_pose(rig.where, pose, f"sensor {sensor} in rig {number}")
    images = {image.id: image for image in tables.images}
    poses = {}  # by image id: the pose of its sensor in the rig, and that of the rig
    for number, frame in frames.items():
        _check_pose(frame.where, frame.pose, f"frame {number}")
        if frame.rig not in rigs:
            raise damaged(frame.where, f"frame {number} refers to rig {frame.rig}, which does not exist")
        # The first sensor is the rig's origin.
        sensors = rigs[frame.rig].sensors
        placed = {(kind, sensor): pose for kind, sensor, pose in sensors} | {sensors[0][:2]: IDENTITY}
        for kind, sensor, data in frame.data:
            if (kind, sensor) not in placed:
                raise damaged(frame.where, f"frame {number} refers to sensor {sensor}, which is not in rig {frame.rig}")
            if kind != CAMERA_SENSOR:
                continue
            if data not in images:
                raise damaged(frame.where, f"frame {number} refers to image {data}, which does not exist")
            if data in poses:
                raise damaged(frame.where, f"frame {number} refers to image {data}, which another frame has")
            if images[data].camera != sensor:
                raise damaged(frame.where, f"frame {number} has image {data} under camera {sensor}, not its own")
            if not placed[kind, sensor]:
                raise damaged(rigs[frame.rig].where, f"camera {sensor} of rig {frame.rig} has images, but no pose")
            poses[data] = (placed[kind, sensor], frame.pose)
    for image in tables.images:
        if image.id not in poses:
            raise damaged(image.where, f"image {image.id} ({image.name}) is in no frame")
    _check_agreement(tables.images, np.array([poses[image.id] for image in tables.images]))


def _check_agreement(images: list[ImageRow], poses: np.ndarray) -> None:
    """Poses are stored twice, by image and by frame, and pycolmap uses the frames'. Raise InputError if they differ."""
    own = np.array([image.pose for image in images])
    sensor, rig, camera = (Rotation.from_quat(pose[:, [1, 2, 3, 0]]) for pose in (poses[:, 0], poses[:, 1], own))
    turn = ((sensor * rig).inv() * camera).magnitude()
    shift = np.linalg.norm(sensor.apply(poses[:, 1, 4:]) + poses[:, 0, 4:] - own[:, 4:], axis=1)
    off = (turn > SAME_POSE) | (shift > SAME_POSE * np.abs(own[:, 4:]).max())
    if off.any():
        image = images[int(np.argmax(off))]
        raise damaged(
            image.where,
            f"image {image.id} ({image.name}) has another pose than its frame gives it",
            "Rigs and frames are older or newer than the images. If the images are right, move the former two away.",
        )
