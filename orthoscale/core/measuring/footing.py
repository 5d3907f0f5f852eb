"""How low the ground lies on which things stand in a reconstruction, for what is measured there besides vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

# Relative uncertainty of a reconstruction's ground (one sigma), as a share of the camera's height, where its sparse
# points alone tell (else `parallax`): on bare ground these scatter by about this much on the two real scenes. Whatever
# is measured on the ground errs with it.
GROUND_SD = 0.01


@dataclass(frozen=True)
class Footing:
    """The ground by M boxes of vehicles, as in `parallax.Standing`; without any, that below the sparse points.

    place : (M, 3) of the boxes [units, world]. lower : (M,) how far the ground lies below that of the sparse points
    there, as a share of the cameras' height. each : (M,) one sigma of that for one place. shared : and for all alike.
    uneven : one sigma by which that differs from place to place, and reach : from what distance on [units].
    """

    place: np.ndarray
    lower: np.ndarray
    each: np.ndarray
    shared: float = GROUND_SD
    uneven: float = 0.0
    reach: float = 1.0

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.place)

    def at(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N,) how much lower the ground is at `place` (N, 3), and (N,) one sigma of that beside `shared`: as it is
        under the nearest vehicle."""
        if not len(self.place):
            return np.zeros(len(place)), np.zeros(len(place))
        away, nearest = self._tree.query(place)
        apart = self.uneven * np.sqrt(-2 * np.expm1(-0.5 * (away / self.reach) ** 2))
        return self.lower[nearest], np.hypot(self.each[nearest], apart)

    def covariance(self, place: np.ndarray) -> np.ndarray:
        """(N, N) of the errors of `at` at `place` (N, 3) beside `shared`: places that are near each other err alike."""
        each = self.at(place)[1]
        alike: np.ndarray = np.exp(-0.5 * (cdist(place, place) / self.reach) ** 2)
        return np.outer(each, each) * alike


BY_POINTS = Footing(np.empty((0, 3)), np.empty(0), np.empty(0))  # the ground below the sparse points, as it is
