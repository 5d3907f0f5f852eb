"""Up to what height do a detector's boxes enclose a vehicle? The reconstruction itself can tell.

A vehicle seen from the side looks longer or wider by the height that its box takes in: on the ground by
``height * cot(elevation)``, shared between length and width by its heading. The same vehicle must have one size from
all its views, so the height follows from how its apparent sizes change with elevation: a regression with one slope for
all vehicles, and no metres needed (DESIGN: "a reconstruction calibrates its own ruler").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..boxes import Boxes
from .exact import ground_axes
from .view import Views

MIN_VIEWS = 3  # views of one vehicle from which its own mean is taken off
MIN_RESIDUALS = 20  # observations below which nothing is fitted


def lean(boxes: Boxes, views: Views) -> np.ndarray:
    """(N, 2) how much of a vehicle's height each box shows along its length and its width, as a share of the height."""
    along, _ = ground_axes(views, np.stack([np.cos(boxes.angle), np.sin(boxes.angle)], -1))
    radial = views.ground - (views.ground * views.normal).sum(1, keepdims=True) * views.normal
    radial /= np.maximum(np.linalg.norm(radial, axis=1, keepdims=True), 1e-12)
    cosine = np.clip(np.abs((along * radial).sum(1)), 0, 1)
    cotangent = 1 / np.tan(views.elevation)
    return np.stack([cosine, np.sqrt(1 - cosine**2)], -1) * cotangent[:, None]


def fit_height(
    flat_size: np.ndarray, leaning: np.ndarray, members: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Effective heights for length and width, and their one-sigma uncertainties: (2,), (2,) [units of `flat_size`].

    flat_size : (N, 2) sizes on the ground as if vehicles were flat. leaning : (N, 2), from `lean`.
    members : indices of the boxes of each vehicle. Where there are too few views the uncertainty is infinite.
    Huber's weights (Huber 1964, 1.5 sigma) keep odd boxes from steering.
    """
    height, sd = np.zeros(2), np.full(2, np.inf)
    often = [m for m in members if len(m) >= MIN_VIEWS]
    if sum(map(len, often)) < MIN_RESIDUALS:
        return height, sd
    x = np.concatenate([leaning[m] - leaning[m].mean(0) for m in often])
    y = np.concatenate([flat_size[m] - flat_size[m].mean(0) for m in often])
    weight = np.ones_like(x)
    for _ in range(20):
        information = (weight * x**2).sum(0)
        height = (weight * x * y).sum(0) / np.maximum(information, 1e-12)
        residual = np.abs(y - height * x)
        sigma = 1.4826 * np.median(residual, axis=0)
        weight = 1 / np.maximum(1, residual / np.maximum(1.5 * sigma, 1e-12))
    sd = sigma / np.sqrt(np.maximum(information, 1e-12))
    return height, sd
