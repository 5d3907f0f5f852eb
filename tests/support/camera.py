"""The paper's simplified camera (arXiv 2603.07535), with which tests compare the general geometry."""

from __future__ import annotations

import numpy as np

from orthoscale.core.projection.view import Views


def simple_views(
    pixels: np.ndarray,
    image_size: tuple[float, float],
    focal_px: float,
    pitch: float,
    altitude: float | np.ndarray = 1.0,
) -> Views:
    """No roll, no distortion, the principal point in the middle, flat level ground.

    pixels : (N, 2) centres of the boxes [px].
    image_size : width and height [px].
    focal_px : focal length [px].
    pitch : of the optical axis [rad], -pi/2 straight down, 0 at the horizon, as gimbals report it.
    altitude : of the camera over the ground, one or (N,), in the units of the views; if it is 1, metres per unit are
        the altitude in metres.

    Pixels on or above the horizon see no ground; there the views are NaN.
    """
    offset = (np.asarray(pixels, float).reshape(-1, 2) - np.asarray(image_size, float) / 2) / focal_px
    rays = np.column_stack([offset, np.ones(len(offset))])
    up = np.array([0.0, -np.cos(pitch), np.sin(pitch)])
    sinking = -rays @ up
    ground = rays * (altitude / np.where(sinking > 0, sinking, np.nan))[:, None]
    shape = (len(rays), 2, 2)
    return Views(ground, np.broadcast_to(up, ground.shape), np.broadcast_to(np.eye(2) * focal_px, shape))
