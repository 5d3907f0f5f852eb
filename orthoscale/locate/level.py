"""A photo rectified to a nadir view of level ground, by its pitch and roll."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from ..core.projection.level import level_axes
from ..core.projection.view import LOWEST_ELEVATION
from ..core.source import NO_DATA_GREY
from ..errors import TooLittleEvidence
from ..photos.photo import Photo
from ..sources.distortion import project
from .ground import GroundImage

EDGE_POINTS = 24  # along each side of a grid over the photo, by which its extent on the ground is found


@dataclass(frozen=True)
class LevelledPhoto:
    """The ground below `photo`, assumed level, `altitude` claimed metres under the camera. Its reference point is the
    camera's foot; its top is where the photo's top points."""

    photo: Photo
    altitude: float

    @cached_property
    def shown(self) -> np.ndarray:
        """(N, 2) places that the photo shows [claimed m, right and down of the foot], without those seen at less than
        LOWEST_ELEVATION below the horizon. Raises TooLittleEvidence where none is left."""
        width, height = self.photo.tags.width, self.photo.tags.height
        along = np.linspace(0, 1, EDGE_POINTS)
        # A grid, not only the edge: where the edge lies above the horizon, the inside gives the extent.
        x, y = (side.ravel() for side in np.meshgrid(along * width, along * height))
        views, seen = self.photo.views(np.column_stack([x, y]), self.altitude)
        if not seen.any():
            raise TooLittleEvidence(
                f"it sees the ground at too low an angle, nowhere from {LOWEST_ELEVATION:g} degrees or more "
                f"({self.photo.attitude})",
                "Take a photo that looks further down; if this one does, give its pitch (--pitch).",
            )
        ground = views.ground @ level_axes(self.photo.up).T * (1, -1)
        return ground[seen]

    @property
    def corners(self) -> np.ndarray | None:
        """(4, 2) the photo's corners on the ground [claimed m, right and down of the foot], or None, as
        `Photo.outline`."""
        outline = self.photo.outline(self.altitude)
        return None if outline is None else outline * (1, -1)

    @property
    def size(self) -> np.ndarray:
        """(2,) width and height of the ground that it shows [claimed m]. Raises TooLittleEvidence, as `shown`."""
        return np.ptp(self.shown, axis=0)

    def at(self, gsd: float) -> GroundImage:
        """The ground at `gsd` claimed metres per pixel. Raises TooLittleEvidence, as `shown`."""
        low, high = self.shown.min(0), self.shown.max(0)
        width, height = np.maximum(np.ceil((high - low) / gsd).astype(int), 1)
        y, x = np.indices((height, width)) + 0.5
        ground = low + gsd * np.stack([x, y], -1)
        pixels, seen = self._pixels_of(ground.reshape(-1, 2))
        tags = self.photo.tags
        # Averaged to about the wanted resolution before resampling, to avoid aliasing.
        nadir = self.altitude / self.photo.lens.focal_px
        shrink = max(1.0, gsd / nadir)
        out = max(1, round(tags.width / shrink)), max(1, round(tags.height / shrink))
        photo = self.photo.picture.read(0, 0, tags.width, tags.height, *out)
        at = (pixels * (out[0] / tags.width, out[1] / tags.height) - 0.5).astype(np.float32).reshape(height, width, 2)
        picture = cv2.remap(photo, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        valid = seen.reshape(height, width)
        picture[~valid] = NO_DATA_GREY
        return GroundImage(picture, valid, gsd, low)

    def _pixels_of(self, ground: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, 2) pixels of places on the ground [claimed m, right and down of the foot], and (N,) bool whether the
        photo shows them."""
        up = self.photo.up
        points = (ground * (1, -1)) @ level_axes(up) - self.altitude * up
        rays = np.linalg.norm(points, axis=1)
        steep = self.altitude >= np.sin(np.radians(LOWEST_ELEVATION)) * rays
        camera = self.photo.lens.camera
        pixels = project(camera, points)
        with np.errstate(invalid="ignore"):
            inside = (pixels >= 0).all(1) & (pixels < (camera.width, camera.height)).all(1)
        return np.where(np.isfinite(pixels), pixels, -1.0), steep & inside
