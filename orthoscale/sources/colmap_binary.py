"""Reads and checks the binary files of a COLMAP model: every count is compared with what is left of the file."""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

import numpy as np

from ..formats.reading import refuse_pointer
from .colmap_tables import (
    CAMERA_MODELS,
    NOT_UTF8_HINT,
    CameraRow,
    FrameRow,
    ImageRow,
    Points,
    RigRow,
    Tables,
    add,
    damaged,
    unknown_camera,
)


class _Bytes:
    """A binary file that is read from front to back, never past its end and always to its end."""

    def __init__(self, path: Path):
        self.path, self.at = path, 0
        try:
            with path.open("rb") as file:
                self.size = path.stat().st_size
                self.data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if self.size else b""
        except OSError as error:
            raise damaged(str(path), f"cannot be read ({error.strerror})", "Check its permissions.") from error

    @property
    def where(self) -> str:
        return f"{self.path}, byte {self.at}"

    def need(self, size: int, what: str) -> None:
        if self.at + size > self.size:
            raise damaged(self.where, f"file ends ({self.size} bytes) within {what}")

    def take(self, form: str, what: str) -> tuple:
        form = "<" + form
        self.need(struct.calcsize(form), what)
        values = struct.unpack_from(form, self.data, self.at)
        self.at += struct.calcsize(form)
        return values

    def count(self, smallest: int, what: str) -> int:
        """A count of records that take at least `smallest` bytes each."""
        where = self.where
        (count,) = self.take("Q", f"the number of {what}")
        if count * smallest > self.size - self.at:
            raise damaged(where, f"{count} {what} announced, but only {self.size - self.at} bytes follow")
        return count

    def text(self, what: str) -> str:
        end = self.data.find(b"\0", self.at, self.at + 4096)
        if end < 0:
            raise damaged(self.where, f"no end of {what} within 4096 bytes")
        try:
            text = self.data[self.at : end].decode()
        except UnicodeDecodeError:
            raise damaged(self.where, f"{what} is not UTF-8 text", NOT_UTF8_HINT) from None
        self.at = end + 1
        return text

    def done(self) -> None:
        if self.at != self.size:
            raise damaged(self.where, f"{self.size - self.at} bytes more than the announced records need")


# Records of fixed size, and heads of longer ones.
_CAMERA, _IMAGE, _RIG, _FRAME, _DATUM = "IiQQ", "I7dI", "II", "II7dI", "iIQ"
_OBSERVATION = np.dtype([("xy", "<f8", 2), ("point", "<u8")])
_POINT = np.dtype([("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")])
CAMERA_BYTES = struct.calcsize(f"<{_CAMERA}2d")  # at least: a spherical one has two parameters
IMAGE_BYTES = struct.calcsize(f"<{_IMAGE}xQ")  # at least: no name but its end, and a count of no observations
RIG_BYTES, FRAME_BYTES, DATUM_BYTES = (struct.calcsize(f"<{form}") for form in (_RIG, _FRAME, _DATUM))


def read_binary(paths: dict[str, Path]) -> Tables:
    """The tables of the .bin files at `paths`, each read to its end. Raises InputError."""
    tables = Tables(paths=paths)
    readers = {
        "cameras": _binary_cameras,
        "images": _binary_images,
        "points3D": _binary_points,
        "rigs": _binary_rigs,
        "frames": _binary_frames,
    }
    for table, path in paths.items():
        refuse_pointer(path)
        file = _Bytes(path)
        readers[table](file, tables)
        file.done()
    return tables


def _binary_cameras(file: _Bytes, tables: Tables) -> None:
    for _ in range(file.count(CAMERA_BYTES, "cameras")):
        where = file.where
        camera, model, width, height = file.take(_CAMERA, "a camera")
        if model not in CAMERA_MODELS:
            raise unknown_camera(where, camera, model)
        params = file.take(f"{CAMERA_MODELS[model][1]}d", f"the parameters of camera {camera}")
        add(tables.cameras, camera, CameraRow(where, model, width, height, params), where, "camera")


def _binary_images(file: _Bytes, tables: Tables) -> None:
    for _ in range(file.count(IMAGE_BYTES, "images")):
        where = file.where
        image, *pose, camera = file.take(_IMAGE, "an image")
        name = file.text(f"the name of image {image}")
        count = file.count(_OBSERVATION.itemsize, f"observations of image {image} ({name})")
        seen = np.frombuffer(file.data, _OBSERVATION, count, file.at) if count else np.empty(0, _OBSERVATION)
        file.at += _OBSERVATION.itemsize * count
        tables.images.append(ImageRow(where, image, tuple(pose), camera, name, seen["xy"], seen["point"]))


def _binary_points(file: _Bytes, tables: Tables) -> None:
    count = file.count(_POINT.itemsize, "points")
    starts = np.empty(count, np.int64)
    data, size, at, head = file.data, file.size, file.at, _POINT.itemsize
    track = struct.Struct("<Q").unpack_from
    for k in range(count):
        starts[k] = at
        at += head
        if at <= size:
            at += 8 * track(data, at - 8)[0]
        if at > size:
            file.at = int(starts[k])
            raise damaged(file.where, f"file ends ({size} bytes) within the record of point {k + 1} of {count}")
    file.at = at
    # Records differ in length: a running sum that is 1 inside their heads separates these from the tracks.
    inside = np.zeros(size + 1, np.int8)
    inside[starts] += 1
    inside[starts + head] -= 1
    inside = np.cumsum(inside, dtype=np.int8)[:at].astype(bool)
    raw = np.frombuffer(data, np.uint8, at)
    heads = raw[inside].view(_POINT)
    tracks = raw[8:][~inside[8:]].view("<u4").reshape(-1, 2).astype(np.int64)
    values = np.column_stack([heads["xyz"], heads["error"]])
    track_of = np.repeat(np.arange(count), heads["track"].astype(np.int64))
    tables.points = Points(file.path, heads["id"].astype(np.uint64), values, track_of, tracks)


def _binary_rigs(file: _Bytes, tables: Tables) -> None:
    tables.rigs = {}
    for _ in range(file.count(RIG_BYTES, "rigs")):
        where = file.where
        sensors: list[tuple[int, int, tuple[float, ...]]] = []
        rig, count = file.take(_RIG, "a rig")
        for k in range(count):
            kind, sensor = file.take("iI", f"the sensors of rig {rig}")
            pose: tuple[float, ...] = ()
            if k and file.take("B", f"the sensors of rig {rig}")[0]:
                pose = file.take("7d", f"the sensors of rig {rig}")
            sensors.append((kind, sensor, pose))
        add(tables.rigs, rig, RigRow(where, sensors), where, "rig")


def _binary_frames(file: _Bytes, tables: Tables) -> None:
    tables.frames = {}
    for _ in range(file.count(FRAME_BYTES, "frames")):
        where = file.where
        frame, rig, *pose, count = file.take(_FRAME, "a frame")
        file.need(DATUM_BYTES * count, f"the {count} data of frame {frame}")
        data = [file.take(_DATUM, "") for _ in range(count)]
        add(tables.frames, frame, FrameRow(where, rig, tuple(pose), data), where, "frame")
