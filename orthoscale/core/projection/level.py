"""Level ground under a camera of known attitude: the ground model of single photos."""

from __future__ import annotations

import numpy as np

from .view import Views


def up_from_gimbal(pitch: float, roll: float = 0.0) -> np.ndarray:
    """(3,) the vertical in camera coordinates (x right, y down, z forward), from gimbal angles [rad].

    pitch : of the optical axis, -pi/2 straight down, 0 at the horizon. roll : about that axis, right side down.
    """
    return np.array([-np.cos(pitch) * np.sin(roll), -np.cos(pitch) * np.cos(roll), np.sin(pitch)])


def up_from_survey(pitch: float, roll: float) -> np.ndarray:
    """(3,) the vertical in camera coordinates, from the angles of photogrammetry programs (Metashape, Pix4D) [rad].

    The camera looks straight down at 0, 0 with the picture's top forward; `pitch` lifts the nose, `roll` then drops
    the right wing: rotation ``Rx(pitch) Ry(roll)`` of axes right, forward, up.
    """
    return np.array([-np.cos(pitch) * np.sin(roll), -np.sin(pitch), -np.cos(pitch) * np.cos(roll)])


def level_views(
    plane: np.ndarray, lens: np.ndarray, up: np.ndarray, altitude: float, lowest_elevation: float
) -> tuple[Views, np.ndarray]:
    """How level ground at `altitude` [any unit] under the camera is seen at N pixels.

    plane : (N, 2) the pixels on the undistorted plane z = 1. lens : (N, 2, 2), as in `Views`.
    up : (3,) from `up_from_gimbal` or `up_from_survey`.

    Returns the views, and (N,) bool whether the ray meets the ground at `lowest_elevation` [rad] or steeper; where it
    does not, the views are placeholders straight below.
    """
    rays = np.column_stack([plane, np.ones(len(plane))])
    sinking = -rays @ up
    ok = sinking >= np.sin(lowest_elevation) * np.linalg.norm(rays, axis=1)
    ground = np.where(ok[:, None], rays * (altitude / np.where(ok, sinking, 1.0))[:, None], -altitude * up)
    return Views(ground, np.broadcast_to(up, ground.shape), lens), ok


def level_axes(up: np.ndarray) -> np.ndarray:
    """(2, 3) unit vectors on the ground, in camera coordinates: right, and forward (where the picture's top points)."""
    ahead = np.array([0.0, -1.0, 1.0])  # the optical axis and the picture's top: one of them is not vertical
    ahead = ahead - (ahead @ up) * up
    ahead /= np.linalg.norm(ahead)
    return np.stack([np.cross(ahead, up), ahead])
