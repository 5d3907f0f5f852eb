"""Angles of axes, such as a vehicle's long side: half a turn makes no difference to them."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

Angles = TypeVar("Angles", float, np.ndarray)


def axis_angle(angle: Angles) -> Angles:
    """`angle` [rad], one number or an array of any shape, brought into [-pi/2, pi/2) by half turns. Of the difference
    of two directions it is the least turn from one axis to the other."""
    return (angle + np.pi / 2) % np.pi - np.pi / 2
