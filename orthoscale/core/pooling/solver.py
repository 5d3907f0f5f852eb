"""Fits hypotheses: at each scale, the mix of vehicles that would have to be there.

The shares of the classes are fitted by variational Bayes (Bishop, Pattern Recognition and Machine Learning, 10.2, with
the components known), and the other unknowns by Newton's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from itertools import chain

import numpy as np
from scipy.special import digamma, gammaln

from .problem import (
    CALLED,
    COUNTED,
    I_LL,
    I_LW,
    I_WW,
    OF_SHRINKAGE,
    PULL_L,
    PULL_W,
    UNKNOWNS,
    Hypotheses,
    Problem,
    coefficients,
    levels,
    members,
)

# The shapes of the tables (spreads, tails, shares of classes) are good to about 14 %, to which 25 vehicles determine a
# spread. More vehicles do not make one fleet or mix more likely than another: they would distinguish what is finer than
# the tables. On the 52 places of `beside_fleet` the densities of the true scales are e^4 times higher with 25 than with
# 50; with 12 they are lower again.
SHAPE_VEHICLES = 25
STILL = 3e-4  # a hypothesis is fitted until nothing moves by more
# By number of steps: how far below the best log probability a scale is given up. Of those that turned out possible on
# six real places with 84 fleets, none was further below than 100 after two steps, 36 after four, 13 after eight.
GIVEN_UP = {2: 130.0, 4: 60.0, 8: 25.0}


def solve(problems: Sequence[Problem], starts: Sequence[Hypotheses], steps: int) -> list[Hypotheses]:
    """Each hypothesis of each of `starts`, fitted from there by at most `steps` steps.

    `problems` have the same votes and equally many classes. They are solved together, and each hypothesis only until it
    is still, or so unlikely that it will not become possible.
    """
    fitting = _Fitting(problems, starts)
    going = np.arange(len(fitting.owner))
    for step in range(1, steps + 1):
        moving = fitting.moved(going)
        if step in GIVEN_UP:
            moving &= fitting.promising(going, GIVEN_UP[step])
        going = going[moving]
        if not len(going):
            break
    return fitting.finished()


def believed_share(votes: int) -> float:
    """Share of the evidence of so many `votes` on shapes that is believed (SHAPE_VEHICLES)."""
    return min(1.0, SHAPE_VEHICLES / votes)


class _Fitting:
    """The hypotheses of all problems while they are fitted, in joint arrays (V); `owner` is the index of each one's
    problem.

    The arguments of the methods are indices of hypotheses (G,).
    """

    def __init__(self, problems: Sequence[Problem], starts: Sequence[Hypotheses]) -> None:
        self.problems = problems
        self.owner = np.repeat(np.arange(len(problems)), [len(start.counts) for start in starts])
        columns = (np.concatenate([getattr(s, field.name) for s in starts]) for field in fields(Hypotheses))
        self.start = Hypotheses(*columns)
        self.unknown, self.counts = self.start.unknown.copy(), self.start.counts.copy()
        self.turns, self.priors, self.bases = (
            np.array([getattr(p, name) for p in problems]) for name in ("turn", "prior", "basis")
        )
        self.free_priors = self.bases.transpose(0, 2, 1) @ self.priors @ self.bases
        bends = np.einsum("ckiu,ckjw->ckijuw", self.turns, self.turns)
        self.bends = bends.reshape(len(problems), -1, UNKNOWNS**2)
        self.classes, self.votes = len(problems[0].shares), problems[0].gap.shape[1]
        self.believed_share = believed_share(self.votes)
        self.log_density = np.empty(len(self.owner))
        self.information = np.empty((len(self.owner), UNKNOWNS - 1, UNKNOWNS - 1))
        self.log_probability = np.empty(len(self.owner))
        self.hopeful = np.ones(len(self.owner), bool)

    def moved(self, going: np.ndarray) -> np.ndarray:
        """Make one step with these hypotheses; (G,) bool: which of them moved."""
        turn, here = self.turns[self.owner[going]], self.unknown[going]
        along, none = coefficients(turn, here, self.counts[going])
        sums, curvature = self._expected(going, along, none)
        step = self._newton(going, turn, along, sums, curvature)
        after = self._counted(going, sums)
        recounted = np.abs(after - self.counts[going]).max(1) / self.votes
        change = np.maximum(np.abs(step[:, :OF_SHRINKAGE]).max(1), recounted)
        self.counts[going], self.unknown[going] = after, here + step
        return change > STILL

    def promising(self, going: np.ndarray, limit: float) -> np.ndarray:
        """(G,) bool: which are within `limit` of the best of their problem; the others are given up."""
        self._judge(going)
        mine = self.owner[going]
        best = np.full(len(self.problems), -np.inf)
        np.maximum.at(best, mine, self.log_probability[going])
        self.hopeful[going] = self.log_probability[going] > best[mine] - limit
        return self.hopeful[going]

    def finished(self) -> list[Hypotheses]:
        """The fitted hypotheses of each problem."""
        self._judge(np.flatnonzero(self.hopeful))
        every = Hypotheses(self.start.prior, self.start.log_prior, self.counts, self.unknown, self.log_probability)
        return [every.where(self.owner == c) for c in range(len(self.problems))]

    def _expected(self, going: np.ndarray, along: np.ndarray, none: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(K + 3, G, CALLED + J) sums over the votes of the columns of `Problem.table` but the last, weighted by the
        probability of each class; and (G, UNKNOWNS**2) the curvature that follows."""
        sums = np.empty((len(self.turns[0]), len(going), CALLED + self.problems[0].called.shape[1]))
        curvature = np.empty((len(going), UNKNOWNS**2))
        mine = self.owner[going]
        for c in np.unique(mine):
            rows = slice(*np.searchsorted(mine, (c, c + 1)))
            p, density = members(self.problems[c].table, along[:, rows], none[rows])
            sums[:, rows] = p @ self.problems[c].table[..., :-1]
            self.log_density[going[rows]] = np.log(density).sum(1)
            curved = sums[:, rows, [I_LL, I_LW, I_LW, I_WW]].transpose(1, 0, 2).reshape(len(p[0]), -1)
            curvature[rows] = curved @ self.bends[c]
        return sums, curvature

    def _newton(
        self, going: np.ndarray, turn: np.ndarray, along: np.ndarray, sums: np.ndarray, curvature: np.ndarray
    ) -> np.ndarray:
        """(G, UNKNOWNS) a Newton step of the unknowns, along which the scale stays."""
        mine = self.owner[going]
        prior, basis = self.priors[mine], self.bases[mine]
        a00, a01, a11 = sums[..., I_LL], sums[..., I_LW], sums[..., I_WW]  # (K + 3, G) each
        b0, b1 = sums[..., PULL_L], sums[..., PULL_W]
        m0, m1 = along[..., PULL_L], along[..., PULL_W]
        pulled = np.stack([b0 - a00 * m0 - a01 * m1, b1 - a01 * m0 - a11 * m1])  # (2, K + 3, G) gradients
        right = np.einsum("vkiu,ikv->vu", turn, pulled) - np.einsum("vu,vuw->vw", self.unknown[going], prior)
        whole = curvature.reshape(-1, UNKNOWNS, UNKNOWNS) + prior
        self.information[going] = basis.transpose(0, 2, 1) @ whole @ basis
        free = np.linalg.solve(self.information[going], np.einsum("vu,vuw->vw", right, basis)[..., None])
        step: np.ndarray = (basis @ free)[..., 0]
        return step

    def _counted(self, going: np.ndarray, sums: np.ndarray) -> np.ndarray:
        """(G, C) parameters of the Dirichlet distributions, with the votes added."""
        found, called = sums[..., COUNTED], sums[..., CALLED:].transpose(1, 0, 2).reshape(len(going), -1)
        within = found.cumsum(0)[self.classes - 1 :]  # of a level with all levels inside it, (BESIDE_FLEET + 1, G)
        beside = [*found[self.classes :], self.votes - within[-1]]
        columns = [*found[: self.classes], *chain(*zip(within, beside, strict=True)), called]
        after: np.ndarray = self.believed_share * np.column_stack(columns) + self.start.prior[going]
        return after

    def _judge(self, which: np.ndarray) -> None:
        """Update `log_probability` of the hypotheses `which`."""
        mine, unknown = self.owner[which], self.unknown[which]
        found = self.log_density[which] - 0.5 * np.einsum("vi,vij,vj->v", unknown, self.priors[mine], unknown)
        found = self.believed_share * found + self.start.log_prior[which]
        after, before = levels(self.counts[which], self.classes), levels(self.start.prior[which], self.classes)
        for one, other in zip(after, before, strict=True):
            found -= divergence(one, other)
        # Laplace's approximation of the integral over the other unknowns.
        free = self.free_priors
        information = self.believed_share * (self.information[which] - free[mine]) + free[mine]
        self.log_probability[which] = found + 0.5 * (
            np.linalg.slogdet(free)[1][mine] - np.linalg.slogdet(information)[1]
        )


def divergence(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """(V,) Kullback-Leibler divergence between Dirichlet distributions `after` and `before` (V, K) [nats]."""
    total = after.sum(1)
    return (
        gammaln(total)
        - gammaln(after).sum(1)
        - gammaln(before.sum(1))
        + gammaln(before).sum(1)
        + ((after - before) * (digamma(after) - digamma(total)[:, None])).sum(1)
    )
