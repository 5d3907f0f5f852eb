"""The ground of a dense cloud: its lower envelope in cells, to which the surface of `ground` is then fitted.

Dense clouds contain roofs of vehicles and houses, tree crowns, smeared edges, and points below the ground. A cell about
as wide as a vehicle contains ground nearly everywhere that the cameras see ground. Where a cell's lowest level is not
ground, the surface ignores it: it is too stiff for houses, trees and holes.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..errors import InputError
from .ground import Ground

# In camera heights over the ground: the side of a cell (2 m at 70 m); and the thickness of a layer of its histogram. A
# level is LEVEL_LAYERS thick: 0.4 m at 70 m, several times the noise of a dense cloud and less than a bonnet's height.
CELL_SIDE, LAYER_HEIGHT, LEVEL_LAYERS = 0.03, 0.001, 6
# Where the ground is looked for, in camera heights from the sheet of the sparse points, which may lie on tree crowns.
LOWEST_LAYER, HIGHEST_LAYER = -0.25, 0.08
LAYERS_OF_CELL = round((HIGHEST_LAYER - LOWEST_LAYER) / LAYER_HEIGHT)
MOST_DENSE_CELLS = 40_000  # 53 MB of counts; for a larger area cells are wider
# A level needs a tenth of a cell's points, and at least three, as in the first step of the sheet; a cell with fewer
# than FEWEST_IN_CELL points has none.
LEVEL_SHARE, LEVEL_LEAST, FEWEST_IN_CELL = 0.1, 3, 5
# A cloud fits a reconstruction if most (MOST_NEAR) of the sparse points that it covers have points of it within
# NEAR_LAYERS layers, if it covers a fifth of them at least, and if its levels are at their height to within one percent
# of the cameras' height.
NEAR_LAYERS, MOST_NEAR, COVERED_SHARE, FEWEST_COVERED, LEVELS_APART = 10, 0.5, 0.2, 20, 0.01
# Smooth error of a dense cloud (one sigma), in camera heights: that of one pixel at a focal length of 1000 px.
SMOOTH_SD = 0.001
NOT_ITS_OWN = "It may be of another run, or in other coordinates or metres already: name its own with --ground-cloud."


def dense_ground(sparse: Ground, points: np.ndarray, centres: np.ndarray, blocks: Iterable[np.ndarray]) -> Ground:
    """The ground found from a dense cloud, and from the sparse points where the cloud has none.

    sparse : the ground found from the sparse `points` (M, 3), seen from `centres` (C, 3). blocks : the cloud, (N, 3)
    each; all in model units, world. Raises InputError for a cloud that does not fit the sparse points, and what
    `blocks` raises.
    """
    grid = _LayerCounts(sparse, points)
    for block in blocks:
        grid.add(block)
    level, known = grid.levels()
    cell, layer, inside = grid.find(points)
    covered = inside & known[cell]
    apart = grid.check(level, cell[covered], layer[covered], int(inside.sum()))
    ground = Ground.fit(np.concatenate([grid.lifted(level)[known], points[~covered]]), centres)
    return ground.unsure(float(np.hypot(SMOOTH_SD * ground.camera_height, apart)))


class _LayerCounts:
    """Counts of points in layers parallel to the sheet of a `Ground`, for each cell of a grid on its plane."""

    def __init__(self, ground: Ground, points: np.ndarray) -> None:
        """ground, points : from the sparse points, whose extent is the grid's."""
        self.ground, height = ground, ground.camera_height
        plane = ground.plane(points)
        self.low, high = np.percentile(plane, [1, 99], axis=0)
        extent = np.maximum(high - self.low, CELL_SIDE * height)
        self.side = max(CELL_SIDE * height, float(np.sqrt(extent.prod() / MOST_DENSE_CELLS)))
        self.shape = np.ceil(extent / self.side).astype(int)
        self.layer = LAYER_HEIGHT * height
        cells = np.stack(np.meshgrid(*map(np.arange, self.shape), indexing="ij"), -1).reshape(-1, 2)
        self.middle = ground.lift(self.low + (cells + 0.5) * self.side)  # (cells, 3) on the sheet
        self.base = self.middle @ ground.up + LOWEST_LAYER * height
        self.count = np.zeros((len(self.base), LAYERS_OF_CELL), np.int32)

    def find(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(N,) cell and layer of points (N, 3), and whether they are in the grid."""
        column = np.floor((self.ground.plane(points) - self.low) / self.side).astype(np.int64)
        inside = ((column >= 0) & (column < self.shape)).all(1)
        cell = np.where(inside, column[:, 0] * self.shape[1] + column[:, 1], 0)
        layer = np.floor((points @ self.ground.up - self.base[cell]) / self.layer).astype(np.int64)
        return cell, layer, inside & (layer >= 0) & (layer < LAYERS_OF_CELL)

    def add(self, points: np.ndarray) -> None:
        """Count points (N, 3)."""
        cell, layer, inside = self.find(points)
        np.add.at(self.count.ravel(), cell[inside] * LAYERS_OF_CELL + layer[inside], 1)

    def levels(self) -> tuple[np.ndarray, np.ndarray]:
        """(cells,) the lowest level of each cell [layers above LOWEST_LAYER], and whether it has one."""
        total = self.count.sum(1)
        summed = np.pad(np.cumsum(self.count, axis=1, dtype=np.int32), ((0, 0), (1, 0)))
        window = summed[:, LEVEL_LAYERS:] - summed[:, :-LEVEL_LAYERS]  # (cells, LAYERS_OF_CELL - LEVEL_LAYERS + 1)
        enough = window >= np.maximum(LEVEL_LEAST, LEVEL_SHARE * total)[:, None]
        first = enough.argmax(1)
        # The first window with enough points holds the lower tail of the level. The level is the fullest window that
        # lies at most its own width above.
        reach = np.minimum(first[:, None] + np.arange(LEVEL_LAYERS + 1), window.shape[1] - 1)
        start = first + np.take_along_axis(window, reach, 1).argmax(1)
        start = np.minimum(start, window.shape[1] - 1)
        within = np.take_along_axis(self.count, start[:, None] + np.arange(LEVEL_LAYERS), 1)
        level = start + (within * (np.arange(LEVEL_LAYERS) + 0.5)).sum(1) / np.maximum(within.sum(1), 1)
        return level, (total >= FEWEST_IN_CELL) & enough.any(1)

    def lifted(self, level: np.ndarray) -> np.ndarray:
        """(cells, 3) the points at each cell's `level` (cells,), over its middle."""
        over = LOWEST_LAYER * self.ground.camera_height + level * self.layer
        return self.middle + over[:, None] * self.ground.up

    def check(self, level: np.ndarray, cell: np.ndarray, layer: np.ndarray, number: int) -> float:
        """Median height difference between the levels (cells,) and the sparse points [model units].

        cell, layer : (N,) of those of the `number` sparse points whose cells have a level. Raises InputError if the
        cloud does not belong to the sparse points.
        """
        if len(cell) < max(COVERED_SHARE * number, FEWEST_COVERED):
            text = (
                f"it shows the surroundings of {len(cell)} of {number} sparse points only, like one of another run or "
                "in another unit"
            )
            raise InputError(text, NOT_ITS_OWN)
        around = np.clip(layer[:, None] + np.arange(-NEAR_LAYERS, NEAR_LAYERS + 1), 0, LAYERS_OF_CELL - 1)
        near = (self.count[cell[:, None], around] > 0).any(1)
        over = layer + 0.5 - level[cell]
        low = np.abs(over) < 3 * LEVELS_APART / LAYER_HEIGHT
        apart = float(np.median(over[low])) * LAYER_HEIGHT if low.any() else np.inf
        if near.mean() < MOST_NEAR or abs(apart) > LEVELS_APART:
            text = f"it does not lie on the sparse points: {near.mean():.0%} of them are near it"
            if np.isfinite(apart):
                text += f", its ground is {abs(apart):.1%} of the cameras' height off them"
            raise InputError(text, NOT_ITS_OWN)
        return abs(apart) * self.ground.camera_height
