"""A trend of the scale over a plan: a plane or a bowl fitted to the vehicles' scales, and its significance.

Vehicles that stand together resemble each other (a taxi rank, a works car park), so many of them say less than their
number suggests, and a few lots that differ look like a trend. So the vehicles' mean size is modelled as varying
randomly over the ground, and the fits are generalised least squares. As on a ground that is cut into lots at random,
the probability that two places are of one lot, and with it their correlation, falls exponentially with the distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import fdtrc

# Scatter of the mean sizes of lots, relative, one sigma. Places of one country scatter by 1.6 % (0 to 6) at 12 places
# read by eye, and by 3.1 to 3.3 % in the fleets' prior (docs/ruler.md); lots of one scene are more alike. False alarms
# are rare among lots that scatter by 1.5 %; of scenes whose lots scatter by 3 %, 2 to 7 % have one.
LOTS_SD = 0.02
LOT_SIZE = 100.0  # [m] correlation length of lots: a car park, a street's block; a judgement
PER_CELL = 6.0  # vehicles wanted in a cell of the map
WANTED_CELLS = 24  # number of cells below which cells get fewer vehicles instead
MOST_CELLS = 8  # along the longer side
SCATTER = 0.01  # least relative scatter of vehicles' sizes, about that of one model, seen sharply


@dataclass(frozen=True)
class Cells:
    """The C cells of a plan that have vehicles in them.

    centre : (C, 2) of each cell. place : (C, 2) mean position of its vehicles; both [units]. count : (C,) number of
    these. mean : (C,) of their values. sd : (C,) one sigma of `mean` if they were independent. size : (2,) of a cell
    [units].
    """

    centre: np.ndarray
    place: np.ndarray
    count: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    size: tuple[float, float]

    @classmethod
    def of(cls, place: np.ndarray, values: np.ndarray, low: np.ndarray, extent: np.ndarray) -> Cells:
        """Cells of N vehicles. place : (N, 2) of each. values : (N,) of each. low : (2,) lowest corner of the plan.
        extent : (2,) its size. Lengths in [units]."""
        wanted = float(np.clip(len(place) / WANTED_CELLS, 1, PER_CELL))
        side = max(np.sqrt(extent.prod() * wanted / len(place)), extent.max() / MOST_CELLS)
        number = np.maximum(np.round(extent / side), 1).astype(int)
        size = extent / number
        at = np.clip(((place - low) / size).astype(int), 0, number - 1)
        which, cell, count = np.unique(at[:, 1] * number[0] + at[:, 0], return_inverse=True, return_counts=True)

        def mean(of: np.ndarray) -> np.ndarray:
            return np.bincount(cell, of) / count

        # The scatter about the most general trend. Of boxes that are all the same it would be 0, with infinite weight.
        terms = bowl(place - low - extent / 2, extent)  # from the plan's middle; far from it, terms become collinear
        left = values - terms @ np.linalg.lstsq(terms, values, rcond=None)[0]
        scatter = max(float(np.sqrt((left**2).sum() / max(len(left) - terms.shape[1], 1))), SCATTER)
        centre = low + (np.column_stack([which % number[0], which // number[0]]) + 0.5) * size
        where = np.column_stack([mean(place[:, 0]), mean(place[:, 1])])
        return cls(centre, where, count, mean(values), scatter / np.sqrt(count), (float(size[0]), float(size[1])))

    def covariance(self, lot: float, lots_sd: float = LOTS_SD) -> np.ndarray:
        """(C, C) covariance of the cells' means without any trend. lot : size of a lot [units]. lots_sd : one sigma of
        the lots' mean sizes, relative."""
        apart = np.linalg.norm(self.place[:, None] - self.place, axis=2)
        alike: np.ndarray = lots_sd**2 * np.exp(-apart / lot) + np.diag(self.sd**2)
        return alike


def plane(place: np.ndarray, extent: np.ndarray) -> np.ndarray:
    """(N, 3) terms of a plane at `place` (N, 2): 1, x and y, as shares of the longer side of `extent` (2,)."""
    return np.column_stack([np.ones(len(place)), place / extent.max()])


def bowl(place: np.ndarray, extent: np.ndarray) -> np.ndarray:
    """(N, 6) terms of a full quadric, in the same units."""
    x, y = place.T / extent.max()
    return np.column_stack([plane(place, extent), x * x, x * y, y * y])


@dataclass(frozen=True)
class SurfaceFit:
    """The fit of P terms to C cells. coefficients : (P,). covariance : (P, P) of these. chi2 : of the residuals.
    freedom : their degrees of freedom. noise : chi2 per degree of freedom, at least 1."""

    coefficients: np.ndarray
    covariance: np.ndarray
    chi2: float
    freedom: int
    noise: float

    @classmethod
    def of(cls, terms: np.ndarray, values: np.ndarray, covariance: np.ndarray) -> SurfaceFit:
        """`terms` (C, P) fitted to `values` (C,) whose `covariance` (C, C) is known."""
        root = np.linalg.cholesky(covariance)
        a, b = (solve_triangular(root, each, lower=True) for each in (terms, values))
        coefficients = np.linalg.lstsq(a, b, rcond=None)[0]
        chi2 = float(((b - a @ coefficients) ** 2).sum())
        freedom = len(b) - int(np.linalg.matrix_rank(a))
        # Where cells scatter more than vehicles and lots explain, the fit is less certain. Where they scatter less,
        # lots may still differ: cells of one lot do not show that.
        noise = max(chi2 / freedom, 1.0) if freedom > 0 else 1.0
        return cls(coefficients, np.linalg.pinv(a.T @ a) * noise, chi2, freedom, noise)

    def p_against(self, simpler: SurfaceFit) -> float:
        """Probability that a fit is so much better than `simpler` by chance (F-test); 1 for too few cells."""
        more = simpler.freedom - self.freedom
        if self.freedom < 3 or more < 1:
            return 1.0
        return float(fdtrc(more, self.freedom, (simpler.chi2 - self.chi2) / more / self.noise))
