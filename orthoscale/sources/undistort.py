"""Undistortion: from pixels to rays, for every camera model of COLMAP."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pycolmap


def undistort(camera: pycolmap.Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (N, 2) to points (N, 2) of the plane z = 1, the lens there (N, 2, 2), and (N,) bool whether that worked.

    The lens is the Jacobian of the inverse mapping, from the plane to pixels, by central differences.
    """
    usable = np.isfinite(points).all(1)
    plane = np.array(camera.cam_from_img(np.where(usable[:, None], points, 0.0)), float).reshape(-1, 2)
    usable &= np.isfinite(plane).all(1)
    plane[~usable] = 0

    def project(xy: np.ndarray) -> np.ndarray:
        return np.array(camera.img_from_cam(np.column_stack([xy, np.ones(len(xy))])), float).reshape(-1, 2)

    step = 1e-5
    lens = np.stack([project(plane + d) - project(plane - d) for d in step * np.eye(2)], 2) / (2 * step)
    # Undistortion iterates, and with strong distortion may converge elsewhere: projected again, it must give the pixel.
    with np.errstate(invalid="ignore"):
        usable &= np.linalg.norm(project(plane) - points, axis=1) < 0.01
    usable &= np.isfinite(lens).all((1, 2)) & (np.linalg.det(np.where(np.isfinite(lens), lens, 0)) > 0)
    lens[~usable] = np.eye(2) * camera.mean_focal_length()
    return plane, lens, usable
