"""Candidate poses of courts, and the ridges of a picture with which they are compared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .ridges import DIRECTIONS, Segments, segments, steered

SEED = 0.35  # least mean ridge of a seed


@dataclass(frozen=True)
class Poses:
    """Where courts may lie: place (N, 2) of their centres [px], angle (N,) of their length [rad], size (N,) [px/m],
    score (N,), the mean ridge."""

    place: np.ndarray
    angle: np.ndarray
    size: np.ndarray
    score: np.ndarray

    def only(self, which: np.ndarray) -> Poses:
        """Those that a mask or indices select."""
        return Poses(self.place[which], self.angle[which], self.size[which], self.score[which])


class Ridges:
    """The steered ridges of one picture, for look-ups. light : (H, W) float32 grey levels."""

    def __init__(self, light: np.ndarray) -> None:
        self.maps = steered(light)
        self.height, self.width = light.shape

    @cached_property
    def seeds(self) -> Segments:
        """Straight bright pieces, the clearest of neighbouring ones."""
        return segments(self.maps, SEED)

    def at(self, x: np.ndarray, y: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Ridge along `direction` [rad] at (x, y) [px], CLEAR_RIDGE if clear; 0 outside of the picture. Shapes
        broadcast."""
        k = np.rint(direction * (DIRECTIONS / np.pi)).astype(np.int32) % DIRECTIONS
        column, row = np.floor(x + 0.5).astype(np.int32), np.floor(y + 0.5).astype(np.int32)
        inside = (column >= 0) & (column < self.width) & (row >= 0) & (row < self.height)
        index = (k * self.height + row) * self.width + column
        return np.where(inside, self.maps.ravel()[np.where(inside, index, 0)], 0)
