"""Verifies a place on the map: counts local matches that agree on one similarity transform."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .correlate import Peak, Template
from .maps import MapFeatures

RANSAC_DRAWS = 2000  # pairs of matches that are tried; if a tenth of the matches is right, 20 pairs have two right ones
MATCH_TOLERANCE = 1.5  # [cells] within which a match agrees
MOST_TURNED = np.radians(20.0)  # a candidate's heading is at most this far off, its scale at most by this factor
MOST_STRETCHED = 1.35
SHORTEST_PAIR = 4.0  # [cells] least distance of two matches that define a similarity
REFITS = 5  # most rounds of fitting and choosing inliers again
SQUARE = 4  # [cells] side of the squares that `Verified.squares` counts, about a block
WINDOW_MARGIN = 0.125  # of the picture, by which the map's window is larger on each side
FALSE_RATE = 1e-4  # probability that any of the verified places has as many matches as needed by chance
# Median and interquartile range of the standard Gumbel distribution.
GUMBEL_MEDIAN, GUMBEL_QUARTILES = -np.log(np.log(2)), np.log(np.log(4) / np.log(4 / 3))


@dataclass(frozen=True)
class PlaneSimilarity:
    """A similarity transform of the plane: ``w = factor z + shift`` in complex numbers, x + i y with y down; the angle
    of `factor` is a turn clockwise on screen."""

    factor: complex
    shift: complex

    @property
    def scale(self) -> float:
        """The factor by which lengths grow."""
        return abs(self.factor)

    @property
    def turn(self) -> float:
        """The rotation, clockwise on screen [rad]."""
        return float(np.angle(self.factor))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """(N, 2) images of points (N, 2)."""
        image = self.factor * _complex(points) + self.shift
        return np.stack([image.real, image.imag], -1)

    def after(self, other: PlaneSimilarity) -> PlaneSimilarity:
        """The composition: first `other`, then this one."""
        return PlaneSimilarity(self.factor * other.factor, self.factor * other.shift + self.shift)

    def inverse(self, points: np.ndarray) -> np.ndarray:
        """(N, 2) points whose images are `points` (N, 2)."""
        original = (_complex(points) - self.shift) / self.factor
        return np.stack([original.real, original.imag], -1)

    @classmethod
    def of_affine(cls, matrix: np.ndarray) -> PlaneSimilarity:
        """From a (2, 3) affine matrix that is a similarity."""
        return cls(complex(matrix[0, 0], matrix[1, 0]), complex(matrix[0, 2], matrix[1, 2]))


@dataclass(frozen=True)
class SimilarityFit:
    """A similarity and the matches that agree on it.

    inliers : (N,) bool, whether a match agrees. scale_sd : relative one sigma of the scale, from their scatter.
    """

    similarity: PlaneSimilarity
    inliers: np.ndarray
    scale_sd: float

    @property
    def count(self) -> int:
        """How many matches agree."""
        return int(self.inliers.sum())


@dataclass(frozen=True)
class Verified:
    """A look at one place. matches : (N, 4) x, y of the template and x, y of the map [cells]. fit : the similarity on
    which most of them agree, from the template's cells to the map's; None if there are too few. covered : share of the
    window in which the map has data."""

    matches: np.ndarray
    fit: SimilarityFit | None
    covered: float

    @property
    def count(self) -> int:
        """How many matches agree."""
        return self.fit.count if self.fit else 0

    @property
    def squares(self) -> int:
        """Number of squares of the picture, or of the map if fewer, in which the agreeing matches lie. Blocks overlap,
        so one roof that is similar by chance makes many matches side by side."""
        if self.fit is None:
            return 0
        places = self.matches[self.fit.inliers] // SQUARE
        return min(len(np.unique(places[:, k : k + 2], axis=0)) for k in (0, 2))


def verified(template: Template, peak: Peak, mapped: MapFeatures, every: int = 1) -> Verified:
    """Match `template` with the map around `peak`. every : step across and down between the cells that are matched."""
    block = mapped.features.block
    extent = np.array(template.features.shape[1:])
    more = np.ceil(WINDOW_MARGIN * extent).astype(int) + block
    corner = np.rint([peak.row, peak.column] - template.middle).astype(int) - more
    height, width = (int(v) for v in extent + 2 * more)
    ground = mapped.window(int(corner[0]), int(corner[1]), height, width)
    matches = mutual_matches(template.features, ground, block, every)
    matches[:, 2:] += corner[::-1]
    return Verified(matches, agreeing(matches), float(ground.any(0).mean()))


def needed(wrong: Sequence[int], looks: int) -> int:
    """How many matches must agree so that none of `looks` wrong places has as many, except with probability FALSE_RATE.

    wrong : counts of matches at wrong places. The extreme value distribution (Gumbel, 1958) is fitted to their median
    and quartiles, which a few right places among them hardly change. 0 without wrong places: on a map that shows
    nothing, nothing resembles the picture."""
    if not len(wrong):
        return 0
    low, middle, high = np.percentile(wrong, [25, 50, 75])
    spread = max(high - low, 1.0) / GUMBEL_QUARTILES
    mode = middle - GUMBEL_MEDIAN * spread
    return int(np.ceil(mode + spread * np.log(max(looks, 1) / FALSE_RATE)))


def mutual_matches(picture: np.ndarray, ground: np.ndarray, block: int, every: int = 1) -> np.ndarray:
    """(N, 4) pairs of places (x, y in `picture`, x, y in `ground`) [cells] that are each other's best.

    picture, ground : (K, h, w) and (K, H, W) unit vectors, compared in blocks of `block` x `block` cells, all of which
    must have a picture; a place is the middle of a block. every : step across and down between the picture's blocks."""
    mine, here = _blocks(picture, block, every)
    theirs, there = _blocks(ground, block)
    if not len(mine) or not len(theirs):
        return np.empty((0, 4))
    alike = mine @ theirs.T
    forth = alike.argmax(1)
    back = alike.argmax(0)
    mutual = back[forth] == np.arange(len(mine))
    return np.column_stack([here[mutual], there[forth[mutual]]])


def agreeing(matches: np.ndarray) -> SimilarityFit | None:
    """The similarity on which most `matches` (N, 4) agree, among those with little turn and stretch (MOST_TURNED,
    MOST_STRETCHED): by random pairs (RANSAC; Fischler and Bolles, CACM 1981), then refitted. None if no pair gives
    one."""
    z, w = _complex(matches[:, :2]), _complex(matches[:, 2:])
    if len(z) < 2:
        return None
    draw = np.random.default_rng(0)
    first, second = draw.integers(0, len(z), (2, RANSAC_DRAWS))
    far = np.abs(z[first] - z[second]) >= SHORTEST_PAIR
    first, second = first[far], second[far]
    factor = (w[first] - w[second]) / (z[first] - z[second])
    with np.errstate(divide="ignore"):
        plausible = (np.abs(np.log(np.abs(factor))) <= np.log(MOST_STRETCHED)) & (
            np.abs(np.angle(factor)) <= MOST_TURNED
        )
    factor, first, second = factor[plausible], first[plausible], second[plausible]
    if not len(factor):
        return None
    shift = w[first] - factor * z[first]
    votes = (np.abs(factor[:, None] * z + shift[:, None] - w) <= MATCH_TOLERANCE).sum(1)
    best = int(votes.argmax())
    found = PlaneSimilarity(complex(factor[best]), complex(shift[best]))
    inliers = np.abs(found.factor * z + found.shift - w) <= MATCH_TOLERANCE
    for _ in range(REFITS):
        found = _fitted(z[inliers], w[inliers])
        chosen = np.abs(found.factor * z + found.shift - w) <= MATCH_TOLERANCE
        if chosen.sum() < 2 or (chosen == inliers).all():
            break
        inliers = chosen
    return SimilarityFit(found, inliers, _scale_sd(found, z[inliers], w[inliers]))


def _fitted(z: np.ndarray, w: np.ndarray) -> PlaneSimilarity:
    """The least-squares similarity (Umeyama, PAMI 1991, in the plane)."""
    centre, target = z.mean(), w.mean()
    spread = (np.abs(z - centre) ** 2).sum()
    factor = complex((np.conj(z - centre) * (w - target)).sum() / spread) if spread > 0 else 1.0 + 0j
    return PlaneSimilarity(factor, complex(target - factor * centre))


def _scale_sd(found: PlaneSimilarity, z: np.ndarray, w: np.ndarray) -> float:
    """Relative one sigma of the scale, from the residuals and the spread of the places."""
    if len(z) < 3:
        return float("inf")
    residual = np.abs(found.factor * z + found.shift - w)
    variance = (residual**2).sum() / (2 * len(z) - 4)  # of one coordinate; four parameters were fitted
    return float(np.sqrt(variance / (np.abs(z - z.mean()) ** 2).sum()) / found.scale)


def _blocks(features: np.ndarray, block: int, every: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """(N, K * block**2) unit vectors of the blocks that wholly have a picture, and (N, 2) their centres x, y
    [cells]."""
    channels, height, width = features.shape
    if min(height, width) < block:
        return np.empty((0, channels * block**2), np.float32), np.empty((0, 2))
    parts = np.lib.stride_tricks.sliding_window_view(features, (block, block), (1, 2))[:, ::every, ::every]
    rows = parts.transpose(1, 2, 0, 3, 4).reshape(-1, channels * block**2)
    filled = np.lib.stride_tricks.sliding_window_view(np.abs(features).sum(0) > 0, (block, block))[::every, ::every]
    known = filled.all((2, 3)).ravel()
    y, x = np.indices(filled.shape[:2]).reshape(2, -1) * every + block / 2
    rows = rows[known]
    return rows / (np.linalg.norm(rows, axis=1, keepdims=True) + 1e-6), np.column_stack([x, y])[known]


def _complex(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, float)
    return points[..., 0] + 1j * points[..., 1]
