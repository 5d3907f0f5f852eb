"""Directions in the plane: vectors, and axes such as a vehicle's long side, where half a turn makes no difference."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

Angles = TypeVar("Angles", float, np.ndarray)


def axis_angle(angle: Angles) -> Angles:
    """`angle` [rad], one number or an array of any shape, brought into [-pi/2, pi/2) by half turns. Of the difference
    of two directions it is the least turn from one axis to the other."""
    return (angle + np.pi / 2) % np.pi - np.pi / 2


def unit_vector(angle: float | np.ndarray) -> np.ndarray:
    """(..., 2) unit vectors at `angle` (...) [rad] from +x towards +y."""
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def quarter_turn(vector: np.ndarray) -> np.ndarray:
    """(..., 2) the vectors (..., 2) after a quarter turn from +x towards +y: clockwise on screen."""
    return np.stack([-vector[..., 1], vector[..., 0]], -1)
