"""Whether a dense cloud is of a reconstruction: a cropped or cleaned one is, one of another run is not.

The sparse points are surface points, on which their own cloud lies. Where a cloud of another run comes near a sparse
point it does so by chance, since its surface passes through the other's: then the numbers of points that have it within
two distances are as these distances, whichever part of the cloud is left.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

# Sides of the cells in which a cloud is looked for, in distances of the sparse points from the cameras: each point's
# own cell and those around it. Sparse points that three images see are off their surface by a few tenths of a percent.
ON_CELL, NEAR_CELL = 0.005, 0.03
# Points within `ON_CELL` of a cloud by chance are a sixth of those within `NEAR_CELL`; of the model's own cloud nearly
# all, fewer along the border of a cut. The number is between.
OWN_SHARE = 0.3
FEWEST_IN_CLOUD = 1000  # points of anything that is called a dense cloud
FEWEST_NEAR = 30  # points near the cloud, for a share to tell anything
MOST_CHECKED = 20_000  # sparse points
FARTHEST_CHECKED = 3  # median distances from the cameras; farther points are too uncertain
# Points of a cloud in the cells around a sparse point, so that some lie in the small cells around it: a surface fills
# these in proportion to their area.
DENSE_ENOUGH = 4 * (NEAR_CELL / ON_CELL) ** 2
CELLS_AROUND = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3), -1).reshape(-1, 3)
CELL_BITS = 20  # of a cell's number along one axis, without its sign


@dataclass(frozen=True)
class CloudFit:
    """How a cloud lies to the sparse points of a model.

    points : number of those compared. near, on : of those that have the cloud in the large and in the small cells
    around them. cloud : number of its points that were looked at. dense : whether these are enough around the sparse
    points that it comes near.
    """

    points: int
    near: int
    on: int
    cloud: int
    dense: bool

    @property
    def another(self) -> bool:
        """Whether it is surely not the model's cloud."""
        if self.points < FEWEST_NEAR or self.cloud < FEWEST_IN_CLOUD:
            return False
        return not self.near or (self.dense and self.near >= FEWEST_NEAR and self.on < OWN_SHARE * self.near)

    @property
    def own(self) -> bool:
        """Whether it surely is: so many lie on no other, however few points it has."""
        return self.near >= FEWEST_NEAR and self.on >= OWN_SHARE * self.near

    @property
    def said(self) -> str:
        """What was found, for an error or a caution."""
        if not self.near:
            return f"it comes near none of {self.points} sparse points"
        found = f"of {self.near} sparse points that it comes near, {self.on} lie on it"
        return found if self.another or self.own else f"{found}, too few points to tell"


def cloud_fit(points: np.ndarray, centres: np.ndarray, blocks: Iterable[np.ndarray]) -> CloudFit:
    """How the cloud of `blocks` (N, 3) lies to the sparse `points` (M, 3) that were seen from `centres` (C, 3), all in
    model units. Raises what `blocks` raises."""
    if not len(points) or not len(centres):
        return CloudFit(0, 0, 0, 0, dense=False)
    distance = cKDTree(centres).query(points)[0]
    typical = float(np.median(distance))
    points = points[distance <= FARTHEST_CHECKED * typical]
    points = points[:: -(-len(points) // MOST_CHECKED)]
    near, on, cloud = _Cells(points, NEAR_CELL * typical), _Cells(points, ON_CELL * typical), 0
    for block in blocks:
        cloud += len(block)
        on.add(block[near.add(block)])
    around = near.counts()
    reached = around > 0
    dense = bool(reached.any() and np.median(around[reached]) >= DENSE_ENOUGH)
    return CloudFit(len(points), int(reached.sum()), int((on.counts() > 0).sum()), cloud, dense)


class _Cells:
    """The cells of one size around points, and how many points of a cloud are in each."""

    def __init__(self, points: np.ndarray, side: float) -> None:
        self.side, self.origin = side or 1.0, points.mean(0)
        around = self._cell(points)[:, None] + CELLS_AROUND
        self.known, where = np.unique(_packed(around).ravel(), return_inverse=True)
        self.of_point = where.reshape(len(points), len(CELLS_AROUND))
        self.count = np.zeros(len(self.known), np.int64)

    def _cell(self, points: np.ndarray) -> np.ndarray:
        farthest = 2.0**CELL_BITS - 2
        with np.errstate(over="ignore"):  # of points that are farther than the world is wide
            return np.clip(np.floor((points - self.origin) / self.side), -farthest, farthest).astype(np.int64)

    def add(self, cloud: np.ndarray) -> np.ndarray:
        """Count the points (N, 3); returns (N,) bool, which of them are in one of the cells."""
        cell = _packed(self._cell(cloud))
        place = np.minimum(np.searchsorted(self.known, cell), len(self.known) - 1)
        inside = self.known[place] == cell
        self.count += np.bincount(place[inside], minlength=len(self.known))
        return inside

    def counts(self) -> np.ndarray:
        """(points,) how many are around each point."""
        return self.count[self.of_point].sum(1)


def _packed(cell: np.ndarray) -> np.ndarray:
    """(...,) one number for each of the cells (..., 3)."""
    x, y, z = np.moveaxis(cell + 2**CELL_BITS, -1, 0)
    return (x << (2 * CELL_BITS + 2)) | (y << (CELL_BITS + 1)) | z
