"""The order in which the tiles of a picture are processed: wherever it is cut off, its first part is a fair sample."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.detections import Tile

GOLDEN = (np.sqrt(5) - 1) / 2
CURVE_BITS = 12  # of each coordinate along the space-filling curve: 4096 places across


def visiting_order(tiles: Sequence[Tile], weight: np.ndarray, seed: int = 0) -> np.ndarray:
    """(N,) a permutation of the indices of `tiles`; `weight` (N,) > 0 says how early each should come.

    Systematic sampling with probability proportional to weight: the tiles lie along a space-filling curve, each on a
    stretch as long as its weight. Multiples of the golden ratio, which fill a circle evenly however many are taken,
    pick one stretch after another. So tiles of equal weight come equally early on average over the seeds, and the first
    tiles, however many, are spread over the picture.
    """
    if not len(tiles):
        return np.empty(0, int)
    along = np.argsort(_along_curve(np.array([[t.x + t.width / 2, t.y + t.height / 2] for t in tiles])), kind="stable")
    end = np.cumsum(weight[along]) / weight.sum()
    shortest = float(np.diff(end, prepend=0).min())
    # N multiples of the golden ratio leave no gap longer than 2.62 / N (three-gap theorem).
    steps = np.arange(int(np.ceil(2.7 / shortest)))
    points = (np.random.default_rng(seed).random() + steps * GOLDEN) % 1
    picked = np.minimum(np.searchsorted(end, points, side="right"), len(tiles) - 1)
    _, first = np.unique(picked, return_index=True)
    return along[picked[np.sort(first)]]


def _along_curve(centre: np.ndarray) -> np.ndarray:
    """(N,) position of points (N, 2) along the Z-order curve of their bounding box (Morton 1966)."""
    low = centre.min(0)
    cell = ((centre - low) / max(float(np.ptp(centre, axis=0).max()), 1.0) * (2**CURVE_BITS - 1)).astype(np.int64)
    position = np.zeros(len(centre), np.int64)
    for bit in range(CURVE_BITS):
        for axis in (0, 1):
            position |= ((cell[:, axis] >> bit) & 1) << (2 * bit + axis)
    return position
