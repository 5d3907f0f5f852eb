"""A smooth height field below a sparse cloud, under trees, roofs and vehicles, and its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.interpolate import RectBivariateSpline, RegularGridInterpolator

from .ground_grid import Grid, variances
from .ground_plane import MIN_POINTS, no_ground

# Where these numbers come from. SETTLES and SPREAD follow from ABOVE and BELOW (tests/test_constants.py computes them).
# The rest was chosen by eye when the sheet was written, on synthetic flights (tests/test_ground.py) and two real models
# (sheffield, brighton); no script has tuned them.
MIN_SHARE = 0.08  # of the points that lie on the ground, at least; without any ground 2 to 5 % are near some surface
MAX_NODES = 40_000  # of the sheet's grid, a second's work
# Stiffness of the sheet (the length that it smooths away), and the widest band of points that it is fitted to, both in
# camera heights: from a stiff sheet that finds the ground to a flexible one that follows it.
SCHEDULE = ((1, 0.06), (0.6, 0.05), (0.35, 0.04), (0.25, 0.03), (0.17, 0.03), *[(0.12, 0.03)] * 3)
# Width of this band upwards, where vehicles and shrubs are, and downwards, in standard deviations of ground points.
ABOVE, BELOW = 2.0, 3.0
# Since the band is asymmetric, the sheet settles below the middle of normally distributed points: by SETTLES of their
# standard deviation, which is SPREAD times the median distance of the points below the sheet.
SETTLES, SPREAD = 0.24, 1.69
# Directions [rad] of the cells of the first sheet, all used together: whether a cell shows ground between its trees
# depends on where its sides fall. With the axes in 72 different directions, sheets of `weedon` differ from their median
# by up to 6.8 % of the cameras' height if cells lie in one direction, 1.4 % with four and 0.9 % with eight
# (2026-11-26).
CELLS_LIE = tuple((np.arange(8) * np.pi / 16).tolist())
STEEPEST = np.radians(25)  # vehicles neither park nor drive on steeper ground
# How much the ground's slope changes from place to place: the stiffness of a thin plate in terms of a Gaussian process
# (Wahba, Spline Models for Observational Data, 1990, 2.4), where slopes at distances that differ by a factor of e
# differ by about WANDER / sqrt(4 pi). Car parks are built with slopes of 1 to 5 %, streets with up to 8 % and a crown
# of 2 %: a change of 2 % from one to the next makes 0.07.
WANDER = 0.07
MOST_DOUBTED = 1500  # nodes of the coarse grid on which the sheet's uncertainty is computed
GROUND_WITHIN = 10  # camera heights from the cameras: vehicles are measured nearer than 3 (view.LOWEST_ELEVATION)
REACHES_BEYOND = 0.4  # camera heights that the sheet extends beyond the points
# One sigma of the ground, in camera heights, from which a vehicle's size on it tells less than what is known of
# vehicles anyway: their lengths differ by a tenth (the fleets').
NOT_KNOWN = 0.1


@dataclass(frozen=True)
class Sheet:
    """A smooth height field over the plane of `plane_from_world` (3, 3), and its one sigma on a coarser grid."""

    plane_from_world: np.ndarray
    corner: np.ndarray  # (2,) plane coordinates of the first node
    spacing: float
    shape: tuple[int, int]  # nodes along x and y
    surface: RectBivariateSpline
    doubt: RegularGridInterpolator

    @classmethod
    def fit(cls, points: np.ndarray, centres: np.ndarray, plane_from_world: np.ndarray) -> tuple[Sheet, float]:
        """Fit the sheet to `points` in plane coordinates; returns it and the noise of the ground's points."""
        everything = len(points)
        # Points near the horizon, from oblique frames, and stray points would stretch the grid and lower the ground.
        reach = GROUND_WITHIN * (np.median(centres[:, 2]) - np.median(points[:, 2]))
        first, last = np.percentile(centres[:, :2], [1, 99], axis=0)
        points = points[((points[:, :2] > first - reach) & (points[:, :2] < last + reach)).all(1)]
        if len(points) < MIN_POINTS:
            raise no_ground()
        low, high = np.percentile(points[:, 2], [5, 60])
        height = np.median(centres[:, 2]) - low
        points = points - (0, 0, low)  # heights in map coordinates are large, and would cost digits
        # Stray points far outside would stretch the grid for nothing.
        left, right = np.percentile(points[:, :2], [1, 99], axis=0)
        margin = 0.1 * (right - left) + 0.1 * height
        left, right = left - margin, right + margin
        inside = ((points[:, :2] > left) & (points[:, :2] < right)).all(1)
        points = points[inside & (np.abs(points[:, 2]) < 2 * height + (high - low))]
        if len(points) < MIN_POINTS:
            raise no_ground()

        area = np.prod(right - left)
        spacing = max(0.1 * height, np.sqrt(area / MAX_NODES), np.sqrt(2 * area / len(points)))
        left, right = left - REACHES_BEYOND * height, right + REACHES_BEYOND * height
        grid = Grid.covering(left, right, spacing)

        heights = _lowest(grid, points, height)
        at = grid.interpolation(points[:, :2])
        crowd = grid.crowding(points[:, :2])
        noise = 0.02 * height
        # From a stiff sheet and a wide band to a flexible sheet and the noise of the points themselves.
        for stiffness, band in SCHEDULE:
            residual = points[:, 2] - at @ heights
            noise = _noise_below(residual, band * height)
            width = np.clip(np.where(residual > 0, ABOVE, BELOW) * noise, 0.003 * height, band * height)
            weight = np.clip(1 - (residual / width) ** 2, 0, None) ** 2
            heights = grid.fit(at, points[:, 2], weight / crowd, stiffness * height, heights)
        heights += SETTLES * noise
        ground = np.abs(points[:, 2] - at @ heights) < BELOW * noise
        if ground.sum() < max(MIN_SHARE * everything, MIN_POINTS // 2):
            raise no_ground()

        surface = RectBivariateSpline(*grid.nodes, heights.reshape(grid.shape) + low)
        doubt = _doubt(points[ground, :2], float(noise), left, right)
        return cls(plane_from_world, grid.corner, grid.spacing, grid.shape, surface, doubt), float(noise)

    def sd(self, local: np.ndarray) -> np.ndarray:
        """(N,) one sigma of the height at places (N, 2 or 3) in plane coordinates."""
        ends = [(axis[0], axis[-1]) for axis in self.doubt.grid]
        return self.doubt(np.column_stack([np.clip(local[:, k], *ends[k]) for k in (0, 1)]))

    def height_above(self, points: np.ndarray) -> np.ndarray:
        """(N,) heights of `points` (N, 3), in world coordinates, over the sheet."""
        local = points @ self.plane_from_world.T
        return local[:, 2] - self.surface.ev(local[:, 0], local[:, 1])

    def intersect(
        self, origins: np.ndarray, directions: np.ndarray, camera_height: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Ground.intersect`."""
        with np.errstate(invalid="ignore", divide="ignore"):
            directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        usable = np.isfinite(origins).all(1) & np.isfinite(directions).all(1)
        start = np.where(usable[:, None], origins, 0) @ self.plane_from_world.T
        ray = np.where(usable[:, None], directions, 0) @ self.plane_from_world.T
        usable &= ray[:, 2] < -1e-3
        ray[~usable] = (0, 0, -1)

        # Newton's method on the tangent plane below the ray's current end; it starts at the sheet's median height.
        middle = float(np.median(self.surface.get_coeffs()))
        along = (middle - start[:, 2]) / ray[:, 2]
        for _ in range(20):
            end = start + along[:, None] * ray
            normal = self._upward(end)
            miss = (end[:, 2] - self.surface.ev(end[:, 0], end[:, 1])) * normal[:, 2]
            closing = np.minimum((ray * normal).sum(1), -0.05)
            step = np.clip(-miss / closing, -2 * camera_height, 2 * camera_height)
            along = along + step
            if (np.abs(step[usable]) < 1e-9 * camera_height).all():
                break
        end = start + along[:, None] * ray
        normal = self._upward(end)
        miss = end[:, 2] - self.surface.ev(end[:, 0], end[:, 1])
        node = (end[:, :2] - self.corner) / self.spacing
        inside = ((node >= 0) & (node <= np.subtract(self.shape, 1))).all(1)
        ok = usable & inside & (along > 0) & (np.abs(miss) < 1e-6 * camera_height)
        ok &= (self.sd(end) <= NOT_KNOWN * camera_height) & (normal[:, 2] > np.cos(STEEPEST))
        return end @ self.plane_from_world, normal @ self.plane_from_world, ok

    def _upward(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) unit normals of the sheet over `points`, all in plane coordinates."""
        slope_x = self.surface.ev(points[:, 0], points[:, 1], dx=1)
        slope_y = self.surface.ev(points[:, 0], points[:, 1], dy=1)
        normal = np.stack([-slope_x, -slope_y, np.ones(len(points))], 1)
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _lowest(grid: Grid, points: np.ndarray, camera_height: float) -> np.ndarray:
    """(nodes,) heights of a stiff first sheet under everything that stands on the ground.

    Each wide cell gives the lowest level at which a tenth of its points agree. The sheet through these levels gradually
    ignores levels above it, which are roofs and canopies that filled their cell.
    """
    band = 0.03 * camera_height
    width = max(0.4 * camera_height, 2 * grid.spacing)
    levels = [level for turn in CELLS_LIE for level in _levels(points, turn, width, band)]
    if len(levels) < 3 * len(CELLS_LIE):
        raise no_ground()
    xyz, trust = np.array(levels)[:, :3], np.minimum(np.array(levels)[:, 3], 5) / len(CELLS_LIE)
    at = grid.interpolation(xyz[:, :2])
    weight, heights = trust, np.full(grid.shape[0] * grid.shape[1], np.percentile(xyz[:, 2], 30))
    for _ in range(8):
        heights = grid.fit(at, xyz[:, 2], weight, 1.0 * camera_height, heights)
        residual = xyz[:, 2] - at @ heights
        above, below = residual > band, residual < -3 * band
        weight = trust * np.where(above, (band / np.maximum(residual, band)) ** 2, 1) * np.where(below, 0.3, 1)
    return heights


def _levels(points: np.ndarray, turn: float, width: float, band: float) -> list[np.ndarray]:
    """For each cell that has a lowest level, (4,): the middle of the level, and the square root of its number of
    points. The cells are rotated by `turn` [rad]."""
    c, s = np.cos(turn), np.sin(turn)
    places = points[:, :2] @ np.array([[c, -s], [s, c]])
    cell = ((places - places.min(0)) / width).astype(int)
    order = np.lexsort((points[:, 2], cell[:, 1], cell[:, 0]))
    starts = np.flatnonzero(np.r_[True, (np.diff(cell[order], axis=0) != 0).any(1)])
    levels = []
    for members in np.split(order, starts[1:]):
        h = points[members, 2]
        quorum = max(3, len(h) // 10)
        if len(h) < quorum:
            continue
        agreed = np.flatnonzero(h[quorum - 1 :] - h[: len(h) - quorum + 1] <= band)
        if len(agreed):
            chosen = members[(h >= h[agreed[0]]) & (h <= h[agreed[0]] + band)]
            levels.append(np.r_[np.median(points[chosen], axis=0), np.sqrt(len(chosen))])
    return levels


def _noise_below(residual: np.ndarray, band: float) -> float:
    """Standard deviation of the ground's points, from those below the sheet, where only ground and stray points are."""
    below = -residual[(residual < 0) & (residual > -band)]
    return SPREAD * float(np.median(below)) if len(below) >= 10 else band / 3


def _doubt(ground: np.ndarray, noise: float, left: np.ndarray, right: np.ndarray) -> RegularGridInterpolator:
    """One sigma of the sheet's height between `left` and `right` (2,), from the places (M, 2) of its `ground` points.

    The sheet is a Gaussian process whose prior is the bending energy of a thin plate: its log density is minus half of
    the energy over WANDER squared. Points have errors of `noise`, correlated for points of one node, as in `Sheet.fit`.
    """
    spacing = float(np.sqrt(np.prod(right - left) / MOST_DOUBTED))
    grid = Grid.covering(left, right, spacing)
    at = grid.interpolation(ground)
    held = at.T.multiply(1 / (noise**2 * grid.crowding(ground))) @ at
    stiff = grid.bending / (WANDER * spacing) ** 2
    precision = held + stiff + 1e-9 * stiff.diagonal().max() * sparse.identity(at.shape[1])
    variance = variances(precision.tocsr(), reach=2 * grid.shape[1])  # second differences link columns two apart
    return RegularGridInterpolator(grid.nodes, np.sqrt(np.maximum(variance, 0.0)).reshape(grid.shape))
