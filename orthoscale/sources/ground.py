"""The ground of a reconstruction: a smooth surface fitted below its sparse points, under trees, roofs and vehicles.

A vehicle's size in model units is its size in pixels times its distance, and the distance is where its ray meets the
ground: an error of one percent of the camera height is an error of one percent of the scale. So the surface has an
uncertainty of its height everywhere, which grows between points and beyond them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.interpolate import RectBivariateSpline, RegularGridInterpolator
from scipy.sparse.linalg import splu

from ..errors import InputError, TooLittleEvidence

# Where these numbers come from. SETTLES and SPREAD follow from ABOVE and BELOW (tests/test_constants.py computes them).
# The rest was chosen by eye when the sheet was written, on synthetic flights (tests/test_ground.py) and two real models
# (sheffield, brighton); no script has tuned them.
MIN_POINTS = 50  # below which no ground is looked for
MIN_SHARE = 0.08  # of the points on the ground; clouds without any ground still have 2 to 5 % near some surface
MAX_POINTS = 200_000  # more do not make the ground any better known, only slower
MAX_NODES = 40_000  # of the sheet's grid, a second's work
# Stiffness of the sheet (the length that it smooths away) and widest band of points it listens to, both in camera
# heights: from a stiff sheet that finds the ground to a supple one that follows it.
SCHEDULE = ((1, 0.06), (0.6, 0.05), (0.35, 0.04), (0.25, 0.03), (0.17, 0.03), *[(0.12, 0.03)] * 3)
# The sheet listens less far up, where vehicles and shrubs are, than down: in standard deviations of ground points.
ABOVE, BELOW = 2.0, 3.0
# So it settles lower than the middle of normally distributed points: by SETTLES of their standard deviation, which is
# SPREAD times the median distance of the points below the sheet.
SETTLES, SPREAD = 0.24, 1.69
STEEPEST = np.radians(25)  # vehicles neither park nor drive on steeper ground
# How much the ground's slope changes from place to place: a thin plate's stiffness as a Gaussian process has it (Wahba,
# Spline Models for Observational Data, 1990, 2.4), where slopes at distances a factor of e apart differ by about
# WANDER / sqrt(4 pi). Lots are built with slopes of 1 to 5 %, streets with up to 8 % and a crown of 2 %: 2 % from one
# to the next makes 0.07.
WANDER = 0.07
MOST_DOUBTED = 1500  # nodes of the coarse grid on which that is worked out
GROUND_WITHIN = 10  # camera heights from the cameras: vehicles are measured nearer than 3 (view.LOWEST_ELEVATION)
REACHES_BEYOND = 0.4  # camera heights that the sheet reaches beyond the points
# Relative to the camera's height: from there a vehicle's size says less than what is known of it beforehand, for
# vehicles differ by a tenth (the fleets' lengths).
NOT_KNOWN = 0.1


@dataclass(frozen=True)
class Ground:
    """The ground surface of one reconstruction; lengths in model units, world coordinates.

    up : (3,) unit vector away from the ground, towards the cameras. camera_height : median height of the cameras over
    the ground below them. noise : standard deviation of the ground's own points about the surface. alike : one sigma of
    a further error common to all places (`unsure`).
    """

    up: np.ndarray
    camera_height: float
    noise: float
    _sheet: _Sheet
    alike: float = 0.0

    @classmethod
    def fit(cls, points: np.ndarray, camera_centres: np.ndarray) -> Ground:
        """Find the ground under `points` (M, 3) seen from `camera_centres` (C, 3).

        Points on trees, roofs, walls and vehicles, and outliers on either side, are separated from the ground by the
        surface's stiffness and by the side on which the cameras are. The result is reproducible. Raises
        TooLittleEvidence for too few points, InputError if no surface lies below the cameras.
        """
        points, centres = _finite(points), _finite(camera_centres)
        if len(points) < MIN_POINTS or not len(centres):
            raise TooLittleEvidence(
                f"{len(points)} points and {len(centres)} cameras are too few to find the ground",
                f"At least {MIN_POINTS} points are needed: reconstruct with more images or more overlap.",
            )
        random = np.random.default_rng(0)
        if len(points) > MAX_POINTS:
            points = points[random.choice(len(points), MAX_POINTS, replace=False)]
        plane = _plane_below(points, centres, random)
        sheet, noise = _Sheet.fit(points @ plane.T, centres @ plane.T, plane)
        height = float(np.median(sheet.height_above(centres)))
        if not height > 0:
            raise _no_ground()
        return cls(plane[2], height, noise, sheet)

    def height_above(self, points: np.ndarray) -> np.ndarray:
        """(N,) heights of `points` (N, 3) over the ground straight below them, along `up`."""
        return self._sheet.height_above(np.asarray(points, float).reshape(-1, 3))

    def sd(self, points: np.ndarray) -> np.ndarray:
        """(N,) one sigma of the ground's height vertically below `points` (N, 3): it grows with the distance from the
        ground's points. Beyond the surface it is that of its nearest edge."""
        local = np.asarray(points, float).reshape(-1, 3) @ self._sheet.plane_from_world.T
        return np.hypot(self._sheet.sd(local), self.alike)

    def unsure(self, alike: float) -> Ground:
        """The same ground with an error of one sigma `alike` common to all its points, which does not average out."""
        return replace(self, alike=alike)

    def plane(self, points: np.ndarray) -> np.ndarray:
        """(N, 2) plane coordinates of `points` (N, 3), as on a plan: x right, y up."""
        return (np.asarray(points, float).reshape(-1, 3) @ self._sheet.plane_from_world.T)[:, :2]

    def lift(self, plane: np.ndarray) -> np.ndarray:
        """(N, 3) points on the ground at the plane coordinates (N, 2)."""
        x, y = np.asarray(plane, float).reshape(-1, 2).T
        return np.column_stack([x, y, self._sheet.surface.ev(x, y)]) @ self._sheet.plane_from_world

    def intersect(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where rays from `origins` (N, 3) along `directions` (N, 3), of any length, meet the ground.

        Returns the points (N, 3), the ground's unit normals there (N, 3), pointing up, and (N,) bool whether the
        answer holds: the ray goes down to ground whose height is known at all (`sd`), and that is not too steep for
        vehicles. Where it does not hold, points and normals are finite but meaningless.
        """
        origins = np.asarray(origins, float).reshape(-1, 3)
        directions = np.asarray(directions, float).reshape(-1, 3)
        return self._sheet.intersect(origins, directions, self.camera_height)


def _finite(xyz: np.ndarray) -> np.ndarray:
    xyz = np.asarray(xyz, float).reshape(-1, 3)
    return xyz[np.isfinite(xyz).all(1)]


def _no_ground() -> InputError:
    return InputError(
        "no ground surface lies below the cameras of this reconstruction",
        "Views from above over mostly open ground are needed; models of facades or objects have no ground to stand on.",
    )


def _plane_below(points: np.ndarray, centres: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Rotation (3, 3) `plane_from_world` whose third row is up: the normal of the plane that most points lie on.

    Random triples of points propose planes (RANSAC). A plane counts only if nearly all cameras are on one side of it;
    points in it count for it and points behind it against it, so that the ground wins over a roof or a canopy.
    """
    some = points[random.choice(len(points), min(len(points), 2000), replace=False)]
    few = centres[random.choice(len(centres), min(len(centres), 200), replace=False)]
    distance = np.median(np.linalg.norm(some[:, None] - few[None], axis=2).min(1))
    band = 0.03 * distance
    if not band > 0:
        raise _no_ground()

    a, b, c = points[random.integers(0, len(points), (3, 1500))]
    normals = np.cross(b - a, c - a)
    size = np.linalg.norm(normals, axis=1)
    usable = size > 1e-3 * distance**2
    normals, a = normals[usable] / size[usable, None], a[usable]
    offset = (normals * a).sum(1)
    above = normals @ few.T - offset[:, None]
    normals *= np.where(np.median(above, axis=1) < 0, -1, 1)[:, None]
    offset = (normals * a).sum(1)

    overlooked = (normals @ few.T - offset[:, None] > band).mean(1) >= 0.9
    if not overlooked.any():
        raise _no_ground()
    normals, offset = normals[overlooked], offset[overlooked]
    residual = normals @ some.T - offset[:, None]
    support = np.clip(1 - (residual / band) ** 2, 0, None).sum(1)
    best = np.argmax(support - 0.5 * (residual < -2 * band).sum(1))
    normal, middle = normals[best], normals[best] * offset[best]

    for width in (2.0, 1.5, 1.0):
        near = points[np.abs((points - middle) @ normal) < width * band]
        if len(near) < 10:
            break
        middle = near.mean(0)
        refined = np.linalg.svd(near - middle, full_matrices=False)[2][2]
        normal = refined if refined @ normal > 0 else -refined
    if np.median((centres - middle) @ normal) <= band:
        raise _no_ground()
    aside = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(normal, aside), normal])


@dataclass(frozen=True)
class _Sheet:
    """A smooth height field over the plane of `plane_from_world` (3, 3), and one sigma of it on a coarser grid."""

    plane_from_world: np.ndarray
    corner: np.ndarray  # (2,) plane coordinates of the first node
    spacing: float
    shape: tuple[int, int]  # nodes along x and y
    surface: RectBivariateSpline
    doubt: RegularGridInterpolator

    @classmethod
    def fit(cls, points: np.ndarray, centres: np.ndarray, plane_from_world: np.ndarray) -> tuple[_Sheet, float]:
        """Fit the sheet to `points` in plane coordinates; returns it and the noise of the ground's points."""
        everything = len(points)
        # What oblique frames see of the horizon, and stray points, would stretch the grid and lower the ground.
        reach = GROUND_WITHIN * (np.median(centres[:, 2]) - np.median(points[:, 2]))
        first, last = np.percentile(centres[:, :2], [1, 99], axis=0)
        points = points[((points[:, :2] > first - reach) & (points[:, :2] < last + reach)).all(1)]
        if len(points) < MIN_POINTS:
            raise _no_ground()
        low, high = np.percentile(points[:, 2], [5, 60])
        height = np.median(centres[:, 2]) - low
        # Stray points far outside would stretch the grid for nothing.
        left, right = np.percentile(points[:, :2], [1, 99], axis=0)
        margin = 0.1 * (right - left) + 0.1 * height
        left, right = left - margin, right + margin
        inside = ((points[:, :2] > left) & (points[:, :2] < right)).all(1)
        points = points[inside & (np.abs(points[:, 2] - low) < 2 * height + (high - low))]
        if len(points) < MIN_POINTS:
            raise _no_ground()

        area = np.prod(right - left)
        spacing = max(0.1 * height, np.sqrt(area / MAX_NODES), np.sqrt(2 * area / len(points)))
        left, right = left - REACHES_BEYOND * height, right + REACHES_BEYOND * height
        shape = np.maximum(np.ceil((right - left) / spacing).astype(int) + 1, 4)
        grid = _Grid(left, spacing, (int(shape[0]), int(shape[1])))

        heights = grid.fit_low(points, height)
        at = grid.interpolation(points[:, :2])
        crowd = grid.crowding(points[:, :2])
        noise = 0.02 * height
        # From a stiff sheet and a wide band to a supple sheet and the noise of the points themselves.
        for stiffness, band in SCHEDULE:
            residual = points[:, 2] - at @ heights
            noise = _noise_below(residual, band * height)
            width = np.clip(np.where(residual > 0, ABOVE, BELOW) * noise, 0.003 * height, band * height)
            weight = np.clip(1 - (residual / width) ** 2, 0, None) ** 2
            heights = grid.fit(at, points[:, 2], weight / crowd, stiffness * height, heights)
        heights += SETTLES * noise
        ground = np.abs(points[:, 2] - at @ heights) < BELOW * noise
        if ground.sum() < max(MIN_SHARE * everything, MIN_POINTS // 2):
            raise _no_ground()

        surface = RectBivariateSpline(*grid.nodes, heights.reshape(grid.shape))
        doubt = _doubt(points[ground, :2], float(noise), left, right)
        return cls(plane_from_world, grid.corner, grid.spacing, grid.shape, surface, doubt), float(noise)

    def sd(self, local: np.ndarray) -> np.ndarray:
        """(N,) one sigma of the height at places (N, 2 or 3) in plane coordinates."""
        ends = [(axis[0], axis[-1]) for axis in self.doubt.grid]
        return self.doubt(np.column_stack([np.clip(local[:, k], *ends[k]) for k in (0, 1)]))

    def height_above(self, points: np.ndarray) -> np.ndarray:
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

        # Newton's method on the tangent plane below the ray's current end; it starts at the height of the middle.
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


def _noise_below(residual: np.ndarray, band: float) -> float:
    """Standard deviation of the ground's points, from those below the sheet: nothing but ground and strays is there."""
    below = -residual[(residual < 0) & (residual > -band)]
    return SPREAD * float(np.median(below)) if len(below) >= 10 else band / 3


def _doubt(ground: np.ndarray, noise: float, left: np.ndarray, right: np.ndarray) -> RegularGridInterpolator:
    """One sigma of the sheet's height between `left` and `right` (2,), by where its `ground` points (M, 2) lie.

    The sheet is a Gaussian process whose prior is the bending energy of a thin plate: minus half of the energy over
    WANDER squared is its log density. Points err by `noise`, those of one node partly alike, as in `_Sheet.fit`.
    """
    spacing = float(np.sqrt(np.prod(right - left) / MOST_DOUBTED))
    shape = np.maximum(np.ceil((right - left) / spacing).astype(int) + 1, 4)
    grid = _Grid(left, spacing, (int(shape[0]), int(shape[1])))
    at = grid.interpolation(ground)
    held = at.T.multiply(1 / (noise**2 * grid.crowding(ground))) @ at
    stiff = grid.bending / (WANDER * spacing) ** 2
    precision = held + stiff + 1e-9 * stiff.diagonal().max() * sparse.identity(at.shape[1])
    variance = _variances(precision.tocsr(), reach=2 * grid.shape[1])  # second differences link columns two apart
    return RegularGridInterpolator(grid.nodes, np.sqrt(np.maximum(variance, 0.0)).reshape(grid.shape))


def _variances(precision: sparse.csr_matrix, reach: int) -> np.ndarray:
    """(N,) the diagonal of the inverse of a positive definite matrix (N, N) that links nothing further than `reach`.

    Blocks of so many rows make it block tridiagonal. One way, each block is inverted as it is when those before it are
    eliminated; on the way back, what the later ones know is added (Takahashi, Fagan and Chin 1973). The inverse as a
    whole, of which only the diagonal is asked for, takes thirty times as long.
    """
    blocks = [slice(start, start + reach) for start in range(0, precision.shape[0], reach)]
    links = [precision[before, here].toarray() for before, here in pairwise(blocks)]
    known = [np.linalg.inv(precision[blocks[0], blocks[0]].toarray())]
    for link, here in zip(links, blocks[1:], strict=True):
        known.append(np.linalg.inv(precision[here, here].toarray() - link.T @ known[-1] @ link))
    inverse = known[-1]
    diagonals = [inverse.diagonal()]
    for link, before in zip(links[::-1], known[-2::-1], strict=True):
        passed = before @ link
        inverse = before + passed @ inverse @ passed.T
        diagonals.append(inverse.diagonal())
    return np.concatenate(diagonals[::-1])


@dataclass(frozen=True)
class _Grid:
    """Square cells over the plane; heights live at their nodes, (nx * ny,), interpolated bilinearly."""

    corner: np.ndarray
    spacing: float
    shape: tuple[int, int]

    @property
    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """(nx,) and (ny,) coordinates of the nodes."""
        x, y = (self.corner[k] + self.spacing * np.arange(self.shape[k]) for k in (0, 1))
        return x, y

    def nearest(self, xy: np.ndarray) -> np.ndarray:
        node = np.rint((xy - self.corner) / self.spacing).astype(int)
        return np.clip(node, 0, np.array(self.shape) - 1)

    def crowding(self, xy: np.ndarray) -> np.ndarray:
        """(M,) what to divide a point's weight by, lest textured spots outvote bare asphalt beside them."""
        node = np.ravel_multi_index(tuple(self.nearest(xy).T), self.shape)
        return np.sqrt(np.bincount(node)[node])

    def interpolation(self, xy: np.ndarray) -> sparse.csr_matrix:
        """(M, nodes) matrix that takes heights at the nodes to heights at `xy`."""
        place = np.clip((xy - self.corner) / self.spacing, 0, np.array(self.shape) - 1)
        cell = np.minimum(place.astype(int), np.array(self.shape) - 2)
        u, v = (place - cell).T
        first = cell[:, 0] * self.shape[1] + cell[:, 1]
        column = np.stack([first, first + 1, first + self.shape[1], first + self.shape[1] + 1], 1)
        value = np.stack([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v], 1)
        row = np.repeat(np.arange(len(xy)), 4)
        return sparse.csr_matrix((value.ravel(), (row, column.ravel())), (len(xy), self.shape[0] * self.shape[1]))

    @cached_property
    def bending(self) -> sparse.csr_matrix:
        """(nodes, nodes) energy of a thin plate: squared second differences, twist counted twice."""

        def difference(n: int, order: int) -> sparse.spmatrix:
            stencil = ([1.0, -2.0, 1.0], [0, 1, 2]) if order == 2 else ([-1.0, 1.0], [0, 1])
            return sparse.diags(stencil[0], stencil[1], shape=(n - order, n))

        nx, ny = self.shape
        xx = sparse.kron(difference(nx, 2), sparse.identity(ny))
        yy = sparse.kron(sparse.identity(nx), difference(ny, 2))
        xy = sparse.kron(difference(nx, 1), difference(ny, 1))
        return (xx.T @ xx + yy.T @ yy + 2 * xy.T @ xy).tocsr()

    def fit(
        self, at: sparse.csr_matrix, heights: np.ndarray, weight: np.ndarray, length: float, before: np.ndarray
    ) -> np.ndarray:
        """(nodes,) heights of the sheet nearest to `heights` (M,) that smooths what is shorter than `length`.

        A touch of the sheet `before` keeps nodes in place that no point holds.
        """
        stiffness = (length / self.spacing) ** 4 / (2 * np.pi)
        weighted = at.T.multiply(weight)
        hold = 1e-6 * stiffness
        system = weighted @ at + stiffness * self.bending + hold * sparse.identity(at.shape[1])
        solver = splu(system.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0, options={"SymmetricMode": True})
        return solver.solve(weighted @ heights + hold * before)

    def fit_low(self, points: np.ndarray, camera_height: float) -> np.ndarray:
        """(nodes,) heights of a stiff first sheet under everything that stands on the ground.

        In wide cells, the lowest height at which a tenth of the cell's points agree; then a sheet through these levels
        that lets go of levels above it, which are roofs and canopies that filled their cell.
        """
        band = 0.03 * camera_height
        width = max(0.4 * camera_height, 2 * self.spacing)
        cell = ((points[:, :2] - self.corner) / width).astype(int)
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
        if len(levels) < 3:
            raise _no_ground()
        xyz, trust = np.array(levels)[:, :3], np.minimum(np.array(levels)[:, 3], 5)
        at = self.interpolation(xyz[:, :2])
        weight, heights = trust, np.full(self.shape[0] * self.shape[1], np.percentile(xyz[:, 2], 30))
        for _ in range(8):
            heights = self.fit(at, xyz[:, 2], weight, 1.0 * camera_height, heights)
            residual = xyz[:, 2] - at @ heights
            above, below = residual > band, residual < -3 * band
            weight = trust * np.where(above, (band / np.maximum(residual, band)) ** 2, 1) * np.where(below, 0.3, 1)
        return heights
