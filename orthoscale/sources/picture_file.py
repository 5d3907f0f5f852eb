"""Frames of a reconstruction: image files on disk, as COLMAP saw them."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from ..errors import InputError
from ..fingerprint import fingerprint

FRAMES_IN_MEMORY = 2


@dataclass
class PictureFile:
    """A `Picture` in a JPEG, PNG or TIFF file of `width` x `height` px, decoded whole when it is first read.

    The EXIF orientation is ignored, as COLMAP does. The latest frames stay in memory, the others are let go.
    """

    name: str
    path: Path
    width: int
    height: int

    def read(self, x: int, y: int, width: int, height: int, out_width: int, out_height: int) -> np.ndarray:
        """See `Picture.read`. Raises InputError for a file that is truncated, undecodable, or of another size."""
        return resized(self._pixels()[y : y + height, x : x + width], out_width, out_height)

    def fingerprint(self) -> str:
        """What cached work on this frame is keyed by."""
        return fingerprint([self.path])

    def check_size(self) -> None:
        """Raise InputError if the file's header tells another size than this picture's; pixels are not decoded."""
        size = stored_size(self.path)
        if size is not None:
            self._require(size)

    def _pixels(self) -> np.ndarray:
        pixels = _decode(self.path)
        self._require((pixels.shape[1], pixels.shape[0]))
        return pixels

    def _require(self, size: tuple[int, int]) -> None:
        if size == (self.width, self.height):
            return
        if size == (self.height, self.width):
            why = "It seems to have been rotated after COLMAP read it: give the folder of the unrotated images."
        elif abs(size[0] * self.height - size[1] * self.width) <= max(self.width, self.height, *size):
            why = "It seems to have been resized: give the images at the size COLMAP read, or undistort again."
        else:
            why = "Give the folder of the very images that COLMAP read (undistorted ones for an undistorted model)."
        raise InputError(
            f"{self.path}: image is {size[0]} x {size[1]} px, but its camera {self.width} x {self.height} px", why
        )


def resized(window: np.ndarray, width: int, height: int) -> np.ndarray:
    """A copy of the pixels `window` (H, W, 3) at another size, as `Picture.read` promises."""
    if (width, height) == (window.shape[1], window.shape[0]):
        return window.copy()
    shrinks = width * height < window.shape[0] * window.shape[1]
    return cv2.resize(window, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)


@lru_cache(maxsize=FRAMES_IN_MEMORY)
def _decode(path: Path) -> np.ndarray:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})", "Check the file and its permissions.") from error
    # OpenCV fills what is missing of a truncated file with grey and says nothing.
    pixels = None
    if _is_complete(data):
        try:
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        except cv2.error:
            pixels = None
    if pixels is None:
        raise InputError(f"{path}: image is truncated or cannot be decoded", "Copy it again from its original.")
    pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)
    pixels.flags.writeable = False
    return pixels


def _is_complete(data: bytes) -> bool:
    """Whether a JPEG or PNG has its end marker; other formats are left to their decoder."""
    if data.startswith(b"\xff\xd8"):
        frame = _jpeg_marker(data, 0xDA)
        return frame is not None and data.find(b"\xff\xd9", frame) >= 0
    if data.startswith(b"\x89PNG"):
        return b"IEND" in data[-65536:]
    return bool(data)


def stored_size(path: Path) -> tuple[int, int] | None:
    """(width, height) [px] from the header of a JPEG or PNG, before any EXIF rotation; None where it does not tell."""
    try:
        with path.open("rb") as file:
            data = file.read(1 << 20)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})", "Check the file and its permissions.") from error
    if data.startswith(b"\x89PNG") and len(data) >= 24:
        return struct.unpack_from(">II", data, 16)
    if data.startswith(b"\xff\xd8"):
        frame = _jpeg_marker(data, 0xC0, 0xC1, 0xC2)
        if frame is not None and frame + 9 <= len(data):
            height, width = struct.unpack_from(">HH", data, frame + 5)
            return width, height
    return None


def _jpeg_marker(data: bytes, *wanted: int) -> int | None:
    """Where the first segment of a `wanted` kind starts; others are stepped over, with the thumbnails in them."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        if data[at + 1] in wanted:
            return at
        if data[at + 1] == 0xFF:  # padding
            at += 1
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    return None
