"""The viewing geometry of boxes: camera, ray and the ground below each box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LOWEST_ELEVATION = 25.0  # [deg] flatter rays meet the ground too far off, and see vehicles from the side


def even_pixels(size: Sequence[int], counts: Sequence[int]) -> np.ndarray:
    """(N, 2) points evenly spread over a picture of `size` px, from the middle of its first pixel to that of its last;
    `counts` of them across and down."""
    x, y = (np.linspace(0.5, side - 0.5, n) for side, n in zip(size, counts, strict=True))
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)


@dataclass(frozen=True)
class Views:
    """The geometry of N boxes, each in the coordinates of the camera that sees it.

    Camera coordinates: x right, y down, z forward, as in COLMAP; lengths in model units (any unit).

    ground : (N, 3) the ground point under the box's centre.
    normal : (N, 3) unit normal of the ground there, pointing up (towards the camera's side).
    lens : (N, 2, 2) pixels per unit of the undistorted plane z = 1, at the box's centre: the Jacobian of intrinsics
        and distortion together. For an ideal camera it is ``diag(fx, fy)`` everywhere.
    """

    ground: np.ndarray
    normal: np.ndarray
    lens: np.ndarray

    def __len__(self) -> int:
        return len(self.ground)

    @classmethod
    def concatenate(cls, parts: Sequence[Views]) -> Views:
        """All views of `parts`, in their order. Raises ValueError for no parts."""
        return cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("ground", "normal", "lens")))

    def with_focal(self, ratio: float) -> Views:
        """The same ground, seen by cameras with `ratio` times the focal length that stand `ratio` times as high: at
        nadir the pictures are the same."""
        above = (self.ground * self.normal).sum(1, keepdims=True) * self.normal
        return Views(self.ground + (ratio - 1) * above, self.normal, self.lens * ratio)

    def __getitem__(self, index: np.ndarray | slice) -> Views:
        return Views(self.ground[index], self.normal[index], self.lens[index])

    @property
    def elevation(self) -> np.ndarray:
        """(N,) elevation angle of the viewing ray above the ground [rad]; pi/2 is straight down."""
        distance = np.linalg.norm(self.ground, axis=1)
        return np.arcsin(np.clip(-(self.ground * self.normal).sum(1) / distance, -1, 1))

    @property
    def focal(self) -> np.ndarray:
        """(N,) focal length [px] at each box: that of the lens there, the geometric mean of both axes."""
        return np.sqrt(np.abs(np.linalg.det(self.lens)))

    @property
    def unit_per_pixel(self) -> np.ndarray:
        """(N,) model units that one pixel covers across the viewing ray."""
        return self.ground[:, 2] / self.focal
