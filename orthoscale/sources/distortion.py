"""The lens: from pixels to rays and back, for every camera model of COLMAP."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pycolmap

REACH_GRID = np.linspace(0, 1, 17)  # shares of a picture's sides


def project(camera: pycolmap.Camera, points: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of `points` (N, 3) in camera coordinates; NaN for what lies behind the camera, and for what its
    lens would map into the picture although it lies farther from the axis than all that the picture shows.

    For the polynomial of a lens turns back somewhere: with k1 = -0.25 (SIMPLE_RADIAL) what lies 56 to 67 degrees off
    the axis is mapped into the picture, once more.
    """
    pixels = np.full((len(points), 2), np.nan)
    ahead = points[:, 2] > 0
    if ahead.any():
        pixels[ahead] = np.array(camera.img_from_cam(points[ahead]), float).reshape(-1, 2)
    size = camera.width, camera.height
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        inside = ((pixels >= 0) & (pixels <= size)).all(1)
        far = np.linalg.norm(points[:, :2] / points[:, 2:], axis=1) > _reach(camera.model.name, *size, *camera.params)
    pixels[inside & far] = np.nan
    return pixels


@lru_cache(maxsize=256)
def _reach(model: str, width: int, height: int, *params: float) -> float:
    """The largest distance from the axis, in the plane z = 1, of what the picture of a camera shows."""
    from .colmap_library import pycolmap

    share = np.stack(np.meshgrid(REACH_GRID, REACH_GRID), -1).reshape(-1, 2)
    camera = pycolmap.Camera(model=model, width=width, height=height, params=params)
    plane, _, usable = undistort(camera, share * (width, height))
    return 1.001 * float(np.linalg.norm(plane[usable], axis=1).max(initial=0.0))


def undistort(camera: pycolmap.Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (N, 2) to points (N, 2) of the plane z = 1, the lens there (N, 2, 2), and (N,) bool whether that worked.

    The lens is the Jacobian of the inverse mapping, from the plane to pixels, by central differences.
    """
    usable = np.isfinite(points).all(1)
    plane = np.array(camera.cam_from_img(np.where(usable[:, None], points, 0.0)), float).reshape(-1, 2)
    usable &= np.isfinite(plane).all(1)
    plane[~usable] = 0

    def pixels(xy: np.ndarray) -> np.ndarray:
        return np.array(camera.img_from_cam(np.column_stack([xy, np.ones(len(xy))])), float).reshape(-1, 2)

    step = 1e-5
    lens = np.stack([pixels(plane + d) - pixels(plane - d) for d in step * np.eye(2)], 2) / (2 * step)
    # Undistortion iterates, and with strong distortion may converge elsewhere: projected again, it must give the pixel.
    with np.errstate(invalid="ignore"):
        usable &= np.linalg.norm(pixels(plane) - points, axis=1) < 0.01
    usable &= np.isfinite(lens).all((1, 2)) & (np.linalg.det(np.where(np.isfinite(lens), lens, 0)) > 0)
    lens[~usable] = np.eye(2) * camera.mean_focal_length()
    return plane, lens, usable
