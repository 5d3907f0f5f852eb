"""The height of a reconstruction's ground, as found under its vehicles, for whatever else is measured on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

# Uncertainty of the height of a reconstruction's ground by its sparse points alone (with vehicles, see `parallax`): one
# sigma as a share of the camera's height. On bare ground the points of the two real scenes scatter by about this much.
# It is a relative error of everything that is measured on the ground.
GROUND_SD = 0.01


@dataclass(frozen=True)
class Footing:
    """The ground under M boxes of vehicles, from `parallax.Standing`; without boxes, the surface below the sparse
    points.

    place : (M, 3) of the boxes on the ground [units, world]. lower : (M,) how far the ground lies below that surface
    there, as a share of the cameras' height. each : (M,) one sigma of `lower`, without `shared`. shared : one sigma of
    it common to all places. uneven : one sigma by which `lower` varies from place to place. reach : its correlation
    length [units].
    """

    place: np.ndarray
    lower: np.ndarray
    each: np.ndarray
    shared: float = GROUND_SD
    uneven: float = 0.0
    reach: float = 1.0

    @property
    def alike(self) -> dict[str, np.ndarray]:
        """The error of all lengths and widths that follows from `shared`, as in `Systematic.shared`."""
        return {"ground": np.full(2, self.shared)}

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.place)

    def at(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N,) `lower` at `place` (N, 3), taken from the nearest vehicle; and (N,) its one sigma, without `shared`."""
        if not len(self.place):
            return np.zeros(len(place)), np.zeros(len(place))
        away, nearest = self._tree.query(place)
        apart = self.uneven * np.sqrt(-2 * np.expm1(-0.5 * (away / self.reach) ** 2))
        return self.lower[nearest], np.hypot(self.each[nearest], apart)

    def covariance(self, place: np.ndarray) -> np.ndarray:
        """(N, N) covariance of the errors of `at` at `place` (N, 3), without `shared`: places that are near each other
        err alike."""
        each = self.at(place)[1]
        alike: np.ndarray = np.exp(-0.5 * (cdist(place, place) / self.reach) ** 2)
        return np.outer(each, each) * alike


BY_POINTS = Footing(np.empty((0, 3)), np.empty(0), np.empty(0))  # the surface below the sparse points, uncorrected
