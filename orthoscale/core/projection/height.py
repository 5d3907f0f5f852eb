"""How far a vehicle's height makes its box longer or wider than its footprint.

A vehicle seen obliquely covers ``height * cot(elevation)`` more of the ground, divided between length and width by its
heading.
"""

from __future__ import annotations

import numpy as np

from ..boxes import Boxes
from .exact import ground_axes
from .view import Views


def radial_cosine(boxes: Boxes, views: Views) -> np.ndarray:
    """(N,) cosine of the angle, in 0..pi/2, between each box's long side and the radial direction, measured on the
    ground; radial is the viewing ray's azimuth. 0 straight below the camera, where there is no azimuth."""
    along, _ = ground_axes(boxes, views)
    radial = views.ground - (views.ground * views.normal).sum(1, keepdims=True) * views.normal
    radial /= np.maximum(np.linalg.norm(radial, axis=1, keepdims=True), 1e-12)
    cosine: np.ndarray = np.clip(np.abs((along * radial).sum(1)), 0, 1)
    return cosine


def lean(boxes: Boxes, views: Views) -> np.ndarray:
    """(N, 2) how much of a vehicle's height each box shows along its length and its width, as a share of the height."""
    cosine = radial_cosine(boxes, views)
    cotangent = 1 / np.tan(views.elevation)
    return np.stack([cosine, np.sqrt(1 - cosine**2)], -1) * cotangent[:, None]
