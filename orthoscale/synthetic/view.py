"""Views: an orthophoto's grid or a pinhole camera. Both map metres to pixels and back.

Pixel coordinates have x right, y down and (0, 0) at the outer corner of the first pixel, as in COLMAP and GDAL.
`nearness` is any number that grows towards the viewer and is linear in the pixel coordinates over a flat face: height
for an orthophoto, one over the depth for a camera. It is what the depth buffer compares.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

SEA_M = 64.0
"""Added to heights so that an orthophoto's nearness is positive."""


@dataclass(frozen=True)
class Ortho:
    """A true orthophoto: every point is seen from straight above.

    x0, y0 : the outer corner of the top left pixel [m]. gsd_m : metres per pixel. width, height : [px].
    """

    x0: float
    y0: float
    gsd_m: float
    width: int
    height: int

    def enlarged(self, factor: int) -> Ortho:
        """The same view in `factor` times as many pixels each way."""
        return replace(self, gsd_m=self.gsd_m / factor, width=self.width * factor, height=self.height * factor)

    def ideal(self) -> Ortho:
        """A view without distortion: itself."""
        return self

    def project(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) [m] to (..., 2) [px]."""
        return np.stack([points[..., 0] - self.x0, self.y0 - points[..., 1]], -1) / self.gsd_m

    def faces_viewer(self, normal: np.ndarray, point: np.ndarray) -> np.ndarray:
        """(F,) bool: whether planes through `point` with this outward normal, (F, 3) each, show their front."""
        return normal[:, 2] > 1e-6

    def in_front(self, points: np.ndarray) -> np.ndarray:
        """(...,) bool: whether points (..., 3) can be projected."""
        return np.ones(points.shape[:-1], bool)

    def nearness(self, normal: np.ndarray, point: np.ndarray) -> np.ndarray:
        """(F, 3) a, b, c so that a x + b y + c is the nearness of the plane at pixel x, y."""
        slope = normal[:, :2] / normal[:, 2:]
        constant = point[:, 2] - slope[:, 0] * (self.x0 - point[:, 0]) - slope[:, 1] * (self.y0 - point[:, 1])
        return np.stack([-slope[:, 0] * self.gsd_m, slope[:, 1] * self.gsd_m, constant + SEA_M], 1)

    def position(self, x: np.ndarray, y: np.ndarray, nearness: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """World x, y, z [m] of pixels with the given nearness."""
        return self.x0 + self.gsd_m * x + 0 * nearness, self.y0 - self.gsd_m * y + 0 * nearness, nearness - SEA_M

    def towards(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) unit vectors from points (N, 3) to the viewer."""
        return np.broadcast_to([0.0, 0.0, 1.0], points.shape)

    def sample_m(self) -> float:
        """Metres across a typical pixel."""
        return self.gsd_m


@dataclass(frozen=True)
class Camera:
    """A pinhole with its principal point in the middle; `k1` as in COLMAP's SIMPLE_RADIAL."""

    focal_px: float
    width: int
    height: int
    k1: float = 0.0


@dataclass(frozen=True)
class Pose:
    """A camera's pose. `rotation` (3, 3) from world to camera axes (x right, y down, z forward); `centre` (3,) [m]."""

    rotation: np.ndarray
    centre: np.ndarray

    @classmethod
    def looking(cls, centre: np.ndarray, yaw: float, pitch: float, roll: float = 0.0) -> Pose:
        """Looking towards `yaw` (counter-clockwise from +x), `pitch` below the horizon (pi/2: straight down) [rad]."""
        forward = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)])
        right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        down = np.cross(forward, right)
        cos, sin = np.cos(roll), np.sin(roll)
        return cls(np.stack([cos * right + sin * down, cos * down - sin * right, forward]), np.asarray(centre, float))


@dataclass(frozen=True)
class Perspective:
    """A frame of `camera` from `pose`."""

    camera: Camera
    pose: Pose

    @property
    def width(self) -> int:
        """Of the picture [px]."""
        return self.camera.width

    @property
    def height(self) -> int:
        """Of the picture [px]."""
        return self.camera.height

    def enlarged(self, factor: int) -> Perspective:
        """The same view in `factor` times as many pixels each way."""
        c = self.camera
        return replace(self, camera=Camera(c.focal_px * factor, c.width * factor, c.height * factor, c.k1))

    def ideal(self) -> Perspective:
        """An ideal pinhole that sees at least what this camera sees, at the same focal length."""
        c = self.camera
        if c.k1 == 0:
            return self
        corner = self.undistorted(np.array([[0.0, 0.0], [c.width / 2, 0.0], [0.0, c.height / 2]]))
        reach = np.abs(corner).max(0) * c.focal_px
        width, height = (2 * int(np.ceil(r)) + 2 for r in reach)
        return replace(self, camera=Camera(c.focal_px, width, height))

    def undistorted(self, pixels: np.ndarray) -> np.ndarray:
        """(..., 2) [px] to the plane z = 1 of the ideal pinhole, by Newton's method on the radius."""
        c = self.camera
        distorted = (pixels - np.array([c.width, c.height]) / 2) / c.focal_px
        r = np.linalg.norm(distorted, axis=-1, keepdims=True)
        u = r.copy()
        for _ in range(6):
            u -= (u + c.k1 * u**3 - r) / (1 + 3 * c.k1 * u**2)
        return distorted * u / np.maximum(r, 1e-12)

    def in_camera(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) world to camera coordinates [m]."""
        return (points - self.pose.centre) @ self.pose.rotation.T

    def project(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) [m] to (..., 2) [px]; only points in front of the camera have a meaningful result."""
        p = self.in_camera(points)
        plane = p[..., :2] / np.where(np.abs(p[..., 2:]) < 1e-9, 1e-9, p[..., 2:])
        radial = 1 + self.camera.k1 * (plane**2).sum(-1, keepdims=True)
        return plane * radial * self.camera.focal_px + np.array([self.width, self.height]) / 2

    def faces_viewer(self, normal: np.ndarray, point: np.ndarray) -> np.ndarray:
        """(F,) bool: whether planes through `point` with this outward normal, (F, 3) each, show their front."""
        return ((self.pose.centre - point) * normal).sum(1) > 1e-6

    def in_front(self, points: np.ndarray) -> np.ndarray:
        """(...,) bool: whether points (..., 3) can be projected."""
        return self.in_camera(points)[..., 2] > 0.5

    def nearness(self, normal: np.ndarray, point: np.ndarray) -> np.ndarray:
        """(F, 3) a, b, c so that a x + b y + c is the nearness of the plane at pixel x, y (no distortion)."""
        c = self.camera
        n = normal @ self.pose.rotation.T
        n = n / (self.in_camera(point) * n).sum(1, keepdims=True)
        constant = n[:, 2] - (n[:, 0] * c.width + n[:, 1] * c.height) / 2 / c.focal_px
        return np.stack([n[:, 0] / c.focal_px, n[:, 1] / c.focal_px, constant], 1)

    def position(self, x: np.ndarray, y: np.ndarray, nearness: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """World x, y, z [m] of pixels with the given nearness (no distortion)."""
        c, r, o = self.camera, self.pose.rotation.astype(np.float32), self.pose.centre.astype(np.float32)
        depth = 1 / nearness
        right, down = (x - c.width / 2) * depth / c.focal_px, (y - c.height / 2) * depth / c.focal_px
        return tuple(o[k] + right * r[0, k] + down * r[1, k] + depth * r[2, k] for k in range(3))

    def towards(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) unit vectors from points (N, 3) to the viewer."""
        v = self.pose.centre - points
        return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-9)

    def sample_m(self) -> float:
        """Metres across a typical pixel: where the optical axis meets the ground, or at 5 altitudes if it is higher."""
        down = max(-self.pose.rotation[2, 2], 0.2)
        return self.pose.centre[2] / down / self.camera.focal_px


View = Ortho | Perspective
