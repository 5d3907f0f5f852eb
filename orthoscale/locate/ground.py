"""Pictures of the ground from above, to be searched for on a map: pixels, valid area, and metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from ..core.source import NO_DATA_GREY, Picture

NO_PICTURE = (NO_DATA_GREY,) * 3
NO_DATA_SIDE = 5  # [px] of the smallest square without data; a picture also has single pixels of just that grey


def has_data(pixels: np.ndarray) -> np.ndarray:
    """(H, W) bool: where `pixels` (H, W, 3), as `Picture.read` gives them, have data."""
    grey = (pixels == NO_DATA_GREY).all(-1).astype(np.uint8)
    return cv2.morphologyEx(grey, cv2.MORPH_OPEN, np.ones((NO_DATA_SIDE, NO_DATA_SIDE), np.uint8)) == 0


@dataclass(frozen=True)
class GroundImage:
    """A picture of level ground from straight above.

    pixels : (H, W, 3) uint8 RGB. valid : (H, W) bool, where there is a picture. gsd : claimed ground sampling distance
    [m/px]; the true one may differ. origin : (2,) upper left corner, in claimed metres right and down of the picture's
    reference point (a photo's foot, an orthophoto's upper left corner).
    """

    pixels: np.ndarray
    valid: np.ndarray
    gsd: float
    origin: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """(2,) width and height [claimed m]."""
        return self.gsd * np.array(self.valid.shape[::-1], float)

    @property
    def middle(self) -> np.ndarray:
        """(2,) centre of the valid area [claimed m right and down, as `origin`]."""
        rows, columns = np.nonzero(self.valid)
        inside = np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2
        return self.origin + self.gsd * inside

    def mirrored(self) -> GroundImage:
        """The mirror image, left for right. It has the same texture, but lies nowhere on the ground."""
        pixels, valid = (np.ascontiguousarray(each[:, ::-1]) for each in (self.pixels, self.valid))
        return GroundImage(pixels, valid, self.gsd, self.origin)

    def turned(self, angle: float, scale: float, gsd: float) -> tuple[GroundImage, np.ndarray]:
        """The picture turned clockwise by `angle` [rad] with `scale` times its claimed metres, at `gsd`; and the (2, 3)
        affine transform from claimed metres (as `origin`) to the new pixels."""
        zoom = scale * self.gsd / gsd
        turn = zoom * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        height, width = self.valid.shape
        corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], float) @ turn.T
        low = corners.min(0)
        out = np.maximum(np.ceil(np.ptp(corners, axis=0)).astype(int), 1)
        # OpenCV's coordinates are of pixel centres, ours of their corners.
        to_out = np.column_stack([turn, turn @ [0.5, 0.5] - low - 0.5])
        size = (int(out[0]), int(out[1]))
        pixels = cv2.warpAffine(self.pixels, to_out, size, flags=cv2.INTER_LINEAR, borderValue=NO_PICTURE)
        valid = cv2.warpAffine(self.valid.astype(np.uint8), to_out, size, flags=cv2.INTER_NEAREST) > 0
        from_metres = np.column_stack([turn / self.gsd, -turn @ self.origin / self.gsd - low])
        return GroundImage(pixels, valid, gsd, np.zeros(2)), from_metres


class Query(Protocol):
    """What to find on a map: a photo, or an orthophoto whose place or scale is missing or not trusted.

    size : (2,) width and height of the ground that it shows [claimed m].
    """

    @property
    def size(self) -> np.ndarray: ...

    def at(self, gsd: float) -> GroundImage:
        """The ground at `gsd` claimed metres per pixel."""
        ...


@dataclass(frozen=True)
class SeenPlan:
    """An orthophoto, or a frame warped onto the ground, of claimed `gsd` [m/px], one number or (2,) across and down, in
    any unit if the scale is to be found. mirrored : whether the picture shows the ground mirrored; `at` then gives its
    mirror image, whose columns run the other way."""

    picture: Picture
    gsd: float | np.ndarray
    mirrored: bool = False

    @property
    def size(self) -> np.ndarray:
        """(2,) width and height [claimed m]."""
        return self.gsd * np.array([self.picture.width, self.picture.height], float)

    def at(self, gsd: float) -> GroundImage:
        """The orthophoto at `gsd` claimed metres per pixel; its no-data pixels, which are grey, are not valid."""
        width, height = np.maximum(np.rint(self.size / gsd).astype(int), 1)
        whole = self.picture.width, self.picture.height
        pixels = self.picture.read(0, 0, *whole, int(width), int(height))
        image = GroundImage(pixels, has_data(pixels), gsd, np.zeros(2))
        return image.mirrored() if self.mirrored else image
