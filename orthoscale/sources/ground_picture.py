"""Ground pictures: the near-nadir part of frames of a reconstruction, warped onto the ground, in model units per pixel.

They look like an orthophoto, but not like a true orthophoto: objects above the ground lean outwards (relief
displacement).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from ..core.projection.view import even_pixels
from ..core.source import GROUND_FOLDER, NEAR_NADIR, NO_DATA_GREY, PosedSet
from ..errors import InputError
from ..system import budget
from .picture_file import ALONE_SHARE, PictureFile, covering, memory, resized, shrunk

SHOWN_BELOW = 8.0  # [deg] shown beyond the limit NEAR_NADIR, so that a vehicle at the limit is whole
SAMPLES = (32, 24)  # points of a frame, across and down, to find which ground it sees
CELL = 8  # [px] the warp is computed at every CELL-th pixel, and linear between
MIN_SIDE = 64  # [px] smaller ground pictures are left out
ROWS_AT_ONCE = 512  # that are warped at once


@dataclass(eq=False)
class GroundPicture:
    """A `Picture` of the ground under one frame; x and y run along the ground, `unit_per_pixel` model units per pixel.

    name : GROUND_FOLDER + the frame's name. image : the frame's name. size : (2,) width and height of the frame [px].
    origin : (2,) plane coordinates of the outer corner of the first pixel. axes : (2, 2) unit vectors of x and y in
    plane coordinates (see `Ground.plane`). frame : its file, None if that is not available.
    """

    name: str
    image: str
    size: tuple[int, int]
    width: int
    height: int
    unit_per_pixel: float
    origin: np.ndarray
    axes: np.ndarray
    frame: PictureFile | None
    source: PosedSet
    # The key of this picture in the memory of pictures; the picture itself as a key would keep its source alive.
    _key: object = field(default_factory=object, init=False, repr=False)

    def read(self, x: int, y: int, width: int, height: int, out_width: int, out_height: int) -> np.ndarray:
        """See `Picture.read`. Raises InputError as the frame does."""
        if self.frame is None:
            raise InputError(
                f"{self.image}: its frame is not available", "Give the folder of the frames with --images."
            )
        size = 3 * self.width * self.height
        if self.frame.large or size > ALONE_SHARE * budget.memory():
            # Only the window, and no finer than needed: the whole would take as much memory as the frame once more.
            shrink = min(width // max(out_width, 1), height // max(out_height, 1))
            part, factor = _warped(self, x, y, width, height, shrink)
            return shrunk(part, factor, (x, y, width, height), out_width, out_height)
        key = (self._key, self.frame.stamp())
        with memory.holding(key, size, lambda: _warped(self, 0, 0, self.width, self.height)[0]) as whole:
            return resized(whole[y : y + height, x : x + width], out_width, out_height)

    def fingerprint(self) -> str:
        """Key of cached results for this picture: of the frame's content and all that determines the warp."""
        corners = np.array([[x, y] for x in (0, 0.5, 1) for y in (0, 0.5, 1)]) * (self.width, self.height)
        digest = hashlib.sha256(self.frame.fingerprint().encode() if self.frame is not None else b"")
        for values in (np.array([self.width, self.height, self.unit_per_pixel]), self.seen(corners)[0]):
            digest.update(np.round(values, 6).tobytes())
        return digest.hexdigest()

    def ground(self, points: np.ndarray) -> np.ndarray:
        """(N, 2) pixels of this picture to (N, 3) points on the ground [model units, world]."""
        plane = self.origin + np.asarray(points, float) * self.unit_per_pixel @ self.axes
        return self.source.ground.lift(plane)

    def seen(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Frame pixels (N, 2) of this picture's `points` (N, 2), NaN behind the camera; and plane vectors (N, 2) from
        below the camera to the points, in this picture's axes, in camera heights."""
        world = self.ground(points)
        centre = self.source.centre(self.image)
        offset = (self.source.ground.plane(world) - self.source.ground.plane(centre[None])) @ self.axes.T
        return self.source.project(self.image, world), offset / self.camera_height

    @property
    def camera_height(self) -> float:
        """Height of the frame's camera over the ground [model units]."""
        return float(self.source.ground.height_above(self.source.centre(self.image)[None])[0])


def ground_pictures(source: PosedSet, frames: Sequence[PictureFile]) -> list[GroundPicture]:
    """The near-nadir parts of the images of `source`, all at the same model units per pixel: the median of the images.

    frames : those whose pixels are available.

    Raises what `ColmapSource.ground` raises.
    """
    files = {frame.name: frame for frame in frames}
    extents, sampling = [], []
    for name in source.picture_names:
        size = source.image_size(name)
        views, world, ok = source.views(name, even_pixels(size, SAMPLES), NEAR_NADIR)
        if not ok.any():
            continue
        axes = _axes(source, name)
        extents.append((name, size, axes, source.ground.plane(world[ok]) @ axes.T))
        sampling.append(np.median(views.unit_per_pixel[ok]))
    pitch = float(np.median(sampling)) if sampling else 1.0
    pictures = []
    for name, size, axes, places in extents:
        low = places.min(0)
        width, height = np.ceil((places.max(0) - low) / pitch).astype(int).tolist()
        if min(width, height) >= MIN_SIDE:
            picture = GroundPicture(
                GROUND_FOLDER + name, name, size, width, height, pitch, low @ axes, axes, files.get(name), source
            )
            pictures.append(picture)
    return pictures


def _axes(source: PosedSet, name: str) -> np.ndarray:
    """(2, 2) plane vectors to the right and down in the frame `name`, as it looks down on the ground."""
    to_right = source.rotation(name)[0]
    centre = source.centre(name)
    right = np.subtract(*source.ground.plane(np.stack([centre + to_right, centre])))
    right /= max(float(np.linalg.norm(right)), 1e-12)
    return np.array([right, [right[1], -right[0]]])


def _warped(picture: GroundPicture, x: int, y: int, width: int, height: int, shrink: int = 1) -> tuple[np.ndarray, int]:
    """The window of the picture, RGB uint8, and the factor by which it is reduced, as in `PictureFile.pixels`."""
    assert picture.frame is not None, "asked before"
    with picture.frame.pixels(shrink) as (frame, factor):
        left, top, right, low = covering(x, y, width, height, factor)
        warped = np.empty((low - top, right - left, 3), np.uint8)
        for first in range(top, low, ROWS_AT_ONCE):
            end = min(first + ROWS_AT_ONCE, low)
            warped[first - top : end - top] = _band(picture, frame, factor, left, right, first, end)
    return warped, factor


def _band(
    picture: GroundPicture, frame: np.ndarray, factor: int, left: int, right: int, top: int, low: int
) -> np.ndarray:
    """Columns `left` to `right` and rows `top` to `low` of the picture, which is reduced by `factor`, as is `frame`."""
    across = np.arange(left // CELL - 1, -(-right // CELL) + 1)
    down = np.arange(top // CELL - 1, -(-low // CELL) + 1)
    nodes = (np.stack(np.meshgrid(across, down), -1).reshape(-1, 2) + 0.5) * CELL * factor
    pixels, offset = picture.seen(nodes)
    pixels[~np.isfinite(pixels).all(1)] = -1e4
    full = (len(across) * CELL, len(down) * CELL)

    def smooth(values: np.ndarray) -> np.ndarray:
        values = cv2.resize(values.reshape(len(down), len(across)).astype(np.float32), full)
        first, above = left - across[0] * CELL, top - down[0] * CELL
        return values[above : above + low - top, first : first + right - left]

    maps = [smooth(values) for values in (pixels / factor - 0.5).T]  # pixel centres are integers in OpenCV, ours at .5
    flat = smooth(np.linalg.norm(offset, axis=1)) > 1 / np.tan(np.radians(NEAR_NADIR - SHOWN_BELOW))
    warped = cv2.remap(frame, maps[0], maps[1], cv2.INTER_CUBIC, borderValue=(NO_DATA_GREY,) * 3)
    warped[flat] = NO_DATA_GREY
    return cv2.cvtColor(warped, cv2.COLOR_BGR2RGB)
