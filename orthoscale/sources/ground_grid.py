"""Heights at the nodes of a square grid, smooth as a thin plate, and the uncertainty of such heights."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu


@dataclass(frozen=True)
class Grid:
    """Square cells over the plane; heights live at their nodes, (nx * ny,), interpolated bilinearly."""

    corner: np.ndarray
    spacing: float
    shape: tuple[int, int]

    @classmethod
    def covering(cls, low: np.ndarray, high: np.ndarray, spacing: float) -> Grid:
        """The grid of this `spacing` from the corner `low` (2,) to `high` (2,) or a little beyond."""
        nx, ny = np.maximum(np.ceil((high - low) / spacing).astype(int) + 1, 4).tolist()
        return cls(low, spacing, (nx, ny))

    @property
    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """(nx,) and (ny,) coordinates of the nodes."""
        x, y = (self.corner[k] + self.spacing * np.arange(self.shape[k]) for k in (0, 1))
        return x, y

    def nearest(self, xy: np.ndarray) -> np.ndarray:
        """(M, 2) int, the node nearest to each place of `xy` (M, 2)."""
        node = np.rint((xy - self.corner) / self.spacing).astype(int)
        return np.clip(node, 0, np.array(self.shape) - 1)

    def crowding(self, xy: np.ndarray) -> np.ndarray:
        """(M,) divisors of the points' weights, so that textured spots do not outvote bare asphalt beside them."""
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
        """(nodes,) heights of the sheet that fits `heights` (M,) best and smooths structures shorter than `length`.

        A slight pull towards the sheet `before` keeps nodes in place that no point holds.
        """
        stiffness = (length / self.spacing) ** 4 / (2 * np.pi)
        weighted = at.T.multiply(weight)
        hold = 1e-6 * stiffness
        system = weighted @ at + stiffness * self.bending + hold * sparse.identity(at.shape[1])
        solver = splu(system.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0, options={"SymmetricMode": True})
        return solver.solve(weighted @ heights + hold * before)


def variances(precision: sparse.csr_matrix, reach: int) -> np.ndarray:
    """(N,) the diagonal of the inverse of a positive definite matrix (N, N) of bandwidth `reach`.

    Blocks of `reach` rows make it block tridiagonal. The forward pass inverts each block after the elimination of those
    before it; the backward pass adds the information of the later ones (Takahashi, Fagan and Chin 1973). The complete
    inverse, of which only the diagonal is needed, would take thirty times as long.
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
