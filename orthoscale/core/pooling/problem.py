"""The fit of one fleet to the votes, as a problem for `solver`: residuals of each vote for each class, and unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy.special import digamma

from ..evenly import evenly
from ..market_segments import PLACE_VEHICLES, Class, PlaceKind, shares_of
from .beside_fleet import (
    BESIDE_FLEET,
    HIDDEN_SHARE,
    HIDDEN_VEHICLES,
    LARGER,
    LORRIES,
    LORRIES_SHARE,
    LORRIES_VEHICLES,
    OUTLIER_BOXES,
    OUTLIER_CALLED,
    OUTLIER_DENSITY,
    OUTLIER_SHARE,
    left_out,
    partly_hidden,
)
from .observed import Seen

IMPOSSIBLE = 9.0  # how far below the best log probability a scale is not tried again
UNKNOWNS = 5  # in this order: those of `Problem`
SCALES, OF_LARGER, OF_SHRINKAGE = slice(2), slice(2, 4), 4  # where each of them stands
# Columns of `Problem.table` and of its `coefficients`: the inverse covariance of a vote (of lengths, of both, of
# widths), the same times its gap (lengths, widths), ones, from CALLED on what it is called, and last the log density.
I_LL, I_LW, I_WW, PULL_L, PULL_W, COUNTED, CALLED = range(7)


@dataclass(frozen=True)
class Mix:
    """The input of a fit from the fleet.

    systematic : (2, 2) covariance of the errors common to all lengths and to all widths. weights : (2,) of the two
    scales. place : how closely places follow their country's mix (`market_segments.PLACE_VEHICLES`).
    """

    classes: Sequence[Class]
    systematic: np.ndarray
    weights: np.ndarray
    place: Sequence[PlaceKind] = PLACE_VEHICLES


@dataclass(frozen=True)
class Hypotheses:
    """V hypotheses on the scale and on how closely the place follows its country, with the mix fitted to each.

    prior : (V, C) the mix beforehand, counts : afterwards, as the parameters of Dirichlet distributions (`levels`).
    log_prior : (V,) log probability beforehand; log_probability : afterwards, up to a constant.
    unknown : (V, UNKNOWNS).
    """

    prior: np.ndarray
    log_prior: np.ndarray
    counts: np.ndarray
    unknown: np.ndarray
    log_probability: np.ndarray

    @property
    def possible(self) -> np.ndarray:
        """(V,) bool: which are within IMPOSSIBLE of the best."""
        return self.log_probability > self.log_probability.max() - IMPOSSIBLE

    def where(self, wanted: np.ndarray) -> Hypotheses:
        """Only the hypotheses that are `wanted`: (V,) bool, or their indices."""
        return Hypotheses(*(getattr(self, field.name)[wanted] for field in fields(self)))


@dataclass(frozen=True)
class Problem:
    """K classes, LARGER, LORRIES and partly hidden vehicles, N votes, and UNKNOWNS: the two log scales, the deviations
    of the larger vehicles' mean at this place from LARGER's (2), and that of the shrinkage [its one sigma]. They are
    solved for together: where most votes are larger vehicles, scales and deviations move as one.

    gap : (K + 3, N, 2) log scale by each vote if it is of each class. inverse : (K + 3, N, 2, 2) of its covariance.
    turn : (K + 3, 2, UNKNOWNS) derivatives of the residuals. prior : (UNKNOWNS, UNKNOWNS) inverse prior covariance.
    shares : (K,) of the classes in the country. larger : share of larger vehicles beside them. place : as in `Mix`.
    basis : (UNKNOWNS, UNKNOWNS - 1) along which the unknowns move while the sum of the scales with `weights` stays.
    called : (N, J) as in `Seen`; J is the number of kinds, or 0. class_called : (K + 3, J) what vehicles of each class
        are called in general, as the parameters of Dirichlet distributions.
    """

    gap: np.ndarray
    inverse: np.ndarray
    turn: np.ndarray
    prior: np.ndarray
    shares: np.ndarray
    larger: float
    place: Sequence[PlaceKind]
    weights: np.ndarray
    basis: np.ndarray
    called: np.ndarray
    class_called: np.ndarray

    @classmethod
    def of(cls, seen: Seen, mix: Mix) -> Problem:
        """The problem of the vehicles `seen` and one fleet; see `mixture.fit`."""
        log_size, shrinkage, confusion = seen.log_size, seen.shrinkage, seen.confusion
        classes, weights = mix.classes, mix.weights
        every = [*classes, LARGER, LORRIES, partly_hidden(classes)]
        means = np.array([shrinkage.log_mean(c) for c in every])
        # A box's relative noise is taken of the size that its vehicle should have, not of the measured size: else boxes
        # that came out large by chance would count for more. A rough scale is enough for that.
        rough = np.median(np.median(means[: len(classes)], axis=0) - log_size, axis=0)
        noise = (seen.noise / np.exp(means - rough)[:, None]) ** 2
        spread = np.array([shrinkage.covariance(c.log_covariance) for c in every])[:, None]
        spread = spread + noise[..., None] * np.eye(2)
        tie = np.linalg.inv(mix.systematic)  # ties the two scales to each other, and leaves what they share free
        tie = tie - np.outer(tie.sum(0), tie.sum(0)) / tie.sum()
        turn = np.zeros((len(every), 2, UNKNOWNS))
        turn[:, :, SCALES] = np.eye(2)
        turn[len(classes), :, OF_LARGER] = -np.eye(2)
        turn[:, :, OF_SHRINKAGE] = [-shrinkage.slope(c) for c in every]
        prior = np.zeros((UNKNOWNS, UNKNOWNS))
        prior[SCALES, SCALES], prior[OF_SHRINKAGE, OF_SHRINKAGE] = tie, 1.0
        prior[OF_LARGER, OF_LARGER] = np.linalg.inv(shrinkage.covariance(LARGER.log_covariance))
        basis = np.zeros((UNKNOWNS, UNKNOWNS - 1))
        basis[SCALES, 0] = weights[1], -weights[0]
        basis[2:, 1:] = np.eye(UNKNOWNS - 2)
        return cls(
            # Noise lowers a logarithm's mean by half its variance.
            gap=(means[:, None] - 0.5 * noise) - log_size,
            inverse=np.linalg.inv(spread),
            turn=turn,
            prior=prior,
            shares=shares_of(classes),
            larger=left_out(classes),
            place=mix.place,
            weights=weights,
            basis=basis,
            called=seen.called,
            class_called=confusion.called(every) if confusion and seen.called.size else np.empty((len(every), 0)),
        )

    @property
    def middle(self) -> float:
        """The log scale by the votes' median, if all are of the fleet's classes."""
        return float(np.median(self.gap[: len(self.shares)].mean(0) @ self.weights))

    def of_votes(self, number: int) -> Problem:
        """The same for only `number` of the votes, evenly chosen, if there are more."""
        if number >= self.gap.shape[1]:
            return self
        some = evenly(self.gap.shape[1], number)
        return replace(self, gap=self.gap[:, some], inverse=self.inverse[:, some], called=self.called[some])

    def start(self, grid: np.ndarray) -> Hypotheses:
        """Hypotheses for the log scales of `grid` (V,), each once for each of `place`, with the country's mix."""
        likely = np.repeat([kind.probability for kind in self.place], len(grid))
        unknown = np.zeros((len(likely), UNKNOWNS))
        unknown[:, SCALES] = np.tile(grid, len(self.place))[:, None]
        lorries, hidden = (LORRIES_SHARE, LORRIES_VEHICLES), (HIDDEN_SHARE, HIDDEN_VEHICLES)
        every = []
        for kind in self.place:
            own = kind.vehicles * kind.shares(self.shares)
            beside = [(self.larger, kind.left_out), lorries, hidden, (OUTLIER_SHARE, OUTLIER_BOXES)]
            levels = [[boxes * (1 - share), boxes * share] for share, boxes in beside]
            every.append([*own, *np.ravel(levels), *self.class_called.ravel()])
        prior = np.repeat(every, len(grid), axis=0)
        return Hypotheses(prior, np.log(likely), prior, unknown, np.log(likely))

    @cached_property
    def table(self) -> np.ndarray:
        """(K + 3, N, CALLED + J + 1) features of each vote: the log density of a class is linear in these, with
        `coefficients` that are quadratic in how far the unknowns move the class. The last column is the log density of
        a class that they do not move."""
        i00, i01, i11 = self.inverse[..., 0, 0], self.inverse[..., 0, 1], self.inverse[..., 1, 1]
        g0, g1 = self.gap[..., 0], self.gap[..., 1]
        b0, b1 = i00 * g0 + i01 * g1, i01 * g0 + i11 * g1
        height = 0.5 * np.log(i00 * i11 - i01**2) - np.log(2 * np.pi) - 0.5 * (g0 * b0 + g1 * b1)
        called = np.broadcast_to(self.called, (*g0.shape, self.called.shape[1]))
        return np.concatenate(
            [np.stack([i00, i01, i11, b0, b1, np.ones_like(g0)], -1), called, height[..., None]], axis=-1
        )

    def along(self, solved: Hypotheses) -> tuple[np.ndarray, np.ndarray]:
        """`coefficients` of the hypotheses `solved`, for this fleet."""
        return coefficients(self.turn[None].repeat(len(solved.unknown), 0), solved.unknown, solved.counts)


def coefficients(turn: np.ndarray, unknown: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K + 3, V, CALLED + J + 1) coefficients of `Problem.table` for hypotheses with `unknown` (V, UNKNOWNS), `counts`
    (V, C) and `turn` (V, K + 3, 2, UNKNOWNS), that of each one's fleet; and (V,) the density of outliers."""
    m0, m1 = np.einsum("vkiu,vu->ikv", turn, unknown)
    log_share, *rest = (
        (digamma(level) - digamma(level.sum(1, keepdims=True))).T
        for level in levels(counts, turn.shape[1] - BESIDE_FLEET)
    )
    beside, called = rest[: BESIDE_FLEET + 1], rest[BESIDE_FLEET + 1 :]
    for within, other in beside:
        log_share = np.vstack([log_share + within, other])
    log_share, none = log_share[:-1], log_share[-1]
    along = [-0.5 * m0**2, -m0 * m1, -0.5 * m1**2, m0, m1, log_share, np.ones_like(m0)]
    if called:  # relative to what outliers are called
        along[CALLED:CALLED] = np.array(called).swapaxes(0, 1) - np.log(OUTLIER_CALLED)
    return np.stack(along, -1), OUTLIER_DENSITY * np.exp(none)


def members(table: np.ndarray, along: np.ndarray, none: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K + 3, V, N) probability of each class for each hypothesis and vote of a `table`; and (V, N) density of the
    vote. `along` and `none` are from `coefficients`."""
    p = along @ table.transpose(0, 2, 1)
    np.exp(p, out=p)
    total = p.sum(0)
    total += none[:, None]
    p /= total
    return p, total


def levels(counts: np.ndarray, many: int) -> tuple[np.ndarray, ...]:
    """`counts` (V, C), split by level: (V, K) of the fleet's classes, which are so `many`; for LARGER, LORRIES, hidden
    vehicles and outliers in turn (V, 2), of all levels before it together, and of itself; and if kinds are seen (V, J)
    for each of the K + 3 classes, of what it is called. A place that is odd in one level need not be odd in another."""
    ends = np.cumsum([many, *[2] * (BESIDE_FLEET + 1)])
    *levels, called = np.split(counts, ends, axis=1)
    return *levels, *(np.split(called, many + BESIDE_FLEET, axis=1) if called.size else [])


def believed(covariance: np.ndarray) -> np.ndarray:
    """(2, 2) `covariance` of two estimates, its off-diagonal no more than either variance: else one of them would have
    a negative weight in the best combination, which trusts the correlation more than it deserves."""
    common = min(covariance[0, 1], *np.diag(covariance))
    return np.array([[covariance[0, 0], common], [common, covariance[1, 1]]])


def combine(covariance: np.ndarray) -> np.ndarray:
    """(2,) weights of the best linear combination of two estimates, whose sum is 1."""
    w = np.linalg.solve(covariance, np.ones(2))
    return w / w.sum()
