"""The ground of a reconstruction: a smooth surface fitted below its sparse points, under trees, roofs and vehicles.

A vehicle's size in model units is its size in pixels times its distance, and the distance is where its ray meets the
ground: an error of one percent of the camera height is an error of one percent of the scale. So the surface has an
uncertainty of its height everywhere, which grows between points and beyond them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import TooLittleEvidence
from .ground_plane import MIN_POINTS, no_ground, plane_below
from .ground_sheet import Sheet

MAX_POINTS = 200_000  # more do not make the ground more accurate, only slower


@dataclass(frozen=True)
class Ground:
    """The ground surface of one reconstruction; lengths in model units, world coordinates.

    up : (3,) unit vector away from the ground, towards the cameras. camera_height : median height of the cameras over
    the ground below them. noise : standard deviation of the ground's own points about the surface. alike : one sigma of
    a further error that all places share (`unsure`).
    """

    up: np.ndarray
    camera_height: float
    noise: float
    _sheet: Sheet
    alike: float = 0.0

    @classmethod
    def fit(cls, points: np.ndarray, camera_centres: np.ndarray) -> Ground:
        """Find the ground under `points` (M, 3) seen from `camera_centres` (C, 3).

        Points on trees, roofs, walls and vehicles, and outliers on either side, are separated from the ground by the
        surface's stiffness and by the side on which the cameras are. The result is reproducible, whatever the order
        of points and cameras, and is the same surface if the world is rotated, shifted or scaled. Raises
        TooLittleEvidence for too few points, InputError if no surface lies below the cameras.
        """
        points, centres = _finite(points), _finite(camera_centres)
        if len(points) < MIN_POINTS or not len(centres):
            raise TooLittleEvidence(
                f"{len(points)} points and {len(centres)} cameras are too few to find the ground",
                f"At least {MIN_POINTS} points are needed: reconstruct with more images or more overlap.",
            )
        middle = centres.mean(0)
        points, centres = points[_order(points, middle)], centres[_order(centres, middle)]
        random = np.random.default_rng(0)
        if len(points) > MAX_POINTS:
            points = points[random.choice(len(points), MAX_POINTS, replace=False)]
        plane = plane_below(points, centres, random)
        sheet, noise = Sheet.fit(points @ plane.T, centres @ plane.T, plane)
        height = float(np.median(sheet.height_above(centres)))
        if not height > 0:
            raise no_ground()
        return cls(plane[2], height, noise, sheet)

    def height_above(self, points: np.ndarray) -> np.ndarray:
        """(N,) heights of `points` (N, 3) over the ground straight below them, along `up`."""
        return self._sheet.height_above(np.asarray(points, float).reshape(-1, 3))

    def sd(self, points: np.ndarray) -> np.ndarray:
        """(N,) one sigma of the ground's height vertically below `points` (N, 3): it grows with the distance from the
        points on the ground. Beyond the surface it is that at its nearest edge."""
        local = np.asarray(points, float).reshape(-1, 3) @ self._sheet.plane_from_world.T
        return np.hypot(self._sheet.sd(local), self.alike)

    def unsure(self, alike: float) -> Ground:
        """The same ground with an error of one sigma `alike` that all its points share, so that it does not average
        out."""
        return replace(self, alike=alike)

    def plane(self, points: np.ndarray) -> np.ndarray:
        """(N, 2) plane coordinates of `points` (N, 3), as on a plan: x right, y up."""
        return (np.asarray(points, float).reshape(-1, 3) @ self._sheet.plane_from_world.T)[:, :2]

    def lift(self, plane: np.ndarray) -> np.ndarray:
        """(N, 3) points on the ground at the plane coordinates (N, 2)."""
        x, y = np.asarray(plane, float).reshape(-1, 2).T
        return np.column_stack([x, y, self._sheet.surface.ev(x, y)]) @ self._sheet.plane_from_world

    def intersect(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where rays from `origins` (N, 3) along `directions` (N, 3), of any length, meet the ground.

        Returns the points (N, 3), the ground's unit normals there (N, 3), pointing up, and (N,) bool whether the
        result is valid: the ray goes down to ground whose height is known well enough (`sd`) and that is not too steep
        for vehicles. Where it is not, points and normals are finite but meaningless.
        """
        origins = np.asarray(origins, float).reshape(-1, 3)
        directions = np.asarray(directions, float).reshape(-1, 3)
        return self._sheet.intersect(origins, directions, self.camera_height)


def _order(xyz: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """(M,) an order of points or cameras for random draws, by their distance from the `middle` of the cameras. Unlike
    the order in the files it does not depend on the program, and unlike that of coordinates not on the world's
    rotation."""
    return np.lexsort((*xyz.T, np.linalg.norm(xyz - middle, axis=1)))


def _finite(xyz: np.ndarray) -> np.ndarray:
    xyz = np.asarray(xyz, float).reshape(-1, 3)
    return xyz[np.isfinite(xyz).all(1)]
