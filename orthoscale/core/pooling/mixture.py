"""Assigns votes to classes of vehicles when neither the scale nor the share of each class is known.

A place is a sample of its country: it has its own mix of vehicles, and the mix is confused with the scale. Minis at one
scale look much like compact cars at a smaller one, and many vans like cars at a larger one. So the scale is not sought
but tried: for each scale of a grid, the mix that would have to be there is fitted, and the scale is weighted by its
likelihood and the prior of the mix (a Dirichlet distribution about the country's). The result is not one scale but
several with weights: the interval is as wide, and has as many modes, as the confusion demands. What distinguishes mixes
needs no scale: length against width, the spread of sizes, and groups of sizes with gaps between them.

A few vehicles more or less may tip such a posterior from one mode to another. So it is averaged over bootstrap samples
of the votes (a bagged posterior, Huggins and Miller, Bayesian Analysis 18 (2023) 79): the value then hardly moves with
single vehicles, and the interval covers errors in the tables of the classes.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from .observed import Seen
from .problem import OF_SHRINKAGE, SCALES, UNKNOWNS, Hypotheses, Mix, Problem, levels, members
from .solver import believed_share, solve

SOUGHT, COARSE, FINE = 1.0, 0.04, 0.015  # half width of the grid about the votes' median, its two steps [log scale]
COARSE_VOTES = 60  # number of votes to which the coarse grid is fitted
MANY = 200  # if there are more votes, this many of them first rule out impossible scales
# The greatest number of votes to which the scale is fitted. With a thousand vehicles, sampling leaves 0.4 %, with 5,000
# less than 0.2 %, where fleet and margin leave 3 to 5 %: more votes cost time and memory, and tell nothing.
MOST_VOTES = 5000
LEAST_KEPT = 0.02  # share of the information that is left however much the classes overlap
COARSE_STEPS, FINE_STEPS = 12, 40  # most steps of fitting
# Bags of as many votes as there are would count sampling noise twice, once in each posterior and once between them;
# bags of twice as many count half of it again, to allow for errors of the tables.
BAG = 2.0  # votes in a bag, per vote
BAGS = 256
BAG_AXES = 6  # principal directions in which bags move a posterior; on 16 real places they hold all but 0.4 %


@dataclass(frozen=True)
class Fits:
    """One fit for each scale that is possible (V).

    weight : (V,) posterior probability of each; they sum to one.
    log_evidence : of the fleet as a whole, comparable between fleets for the same votes; it counts no more than
        SHAPE_VEHICLES of them.
    log_scale : (V, 2) by lengths and by widths.
    covariance : (2, 2) of these at the likeliest, from the votes' number, noise and unknown classes.
    of_known : (2, 2) the same if the class of each vote were known.
    of_shrinkage : (2, 2) what the detector's unknown shrinkage adds to `covariance`.
    chance : variance of the scale between samples of as many vehicles [log scale]: more of them would reduce it.
    member : (K + 1, N) probability of each class over all scales, LARGER last; the rest, to a sum of one, is that of
        a lorry, a partly hidden vehicle or no vehicle.
    """

    weight: np.ndarray
    log_evidence: float
    log_scale: np.ndarray
    covariance: np.ndarray
    of_known: np.ndarray
    of_shrinkage: np.ndarray
    chance: float
    member: np.ndarray


def fit(seen: Seen, mixes: Sequence[Mix]) -> list[Fits | None]:
    """For each of `mixes`, its fits to the vehicles that are `seen`; None where no vote supports any class.

    Lengths and widths have a scale each, because fleet, margin and geometry may be off. `Mix.systematic` limits how far
    the two may differ, which holds the vehicles to the shape of their class. The grid is over their sum, weighted by
    `Mix.weights`; `solver` fits the mix at each of its scales.
    """
    out: list[Fits | None] = [None] * len(mixes)
    # Mixes of equally many classes are solved together: one by one, the overhead of numpy's calls would dominate.
    for number in {len(mix.classes) for mix in mixes}:
        alike = [k for k, mix in enumerate(mixes) if len(mix.classes) == number]
        problems = [Problem.of(seen, mixes[k]) for k in alike]
        for k, problem, solved in zip(alike, problems, _possible(problems), strict=True):
            with suppress(np.linalg.LinAlgError):
                out[k] = _fits(problem, solved)
    return out


def _possible(problems: Sequence[Problem]) -> list[Hypotheses]:
    """The fitted hypotheses of each problem that are possible: by a coarse grid with few votes, then by a fine one."""
    coarse = np.arange(-SOUGHT, SOUGHT, COARSE)
    few = [p.of_votes(COARSE_VOTES) for p in problems]
    solved = solve(few, [p.start(p.middle + coarse) for p in problems], COARSE_STEPS)
    some = [p.of_votes(MANY) for p in problems]
    solved = solve(some, [p.start(_finer(p, s)) for p, s in zip(problems, solved, strict=True)], FINE_STEPS)
    if problems[0].gap.shape[1] > MANY:
        most = [p.of_votes(MOST_VOTES) for p in problems]
        solved = solve(most, [s.where(s.possible) for s in solved], FINE_STEPS)
    return solved


def _finer(problem: Problem, solved: Hypotheses) -> np.ndarray:
    """A grid of step FINE about the possible scales of a coarse grid."""
    coarse = solved.unknown[solved.possible, SCALES] @ problem.weights
    fine = np.arange(coarse.min() - COARSE, coarse.max() + COARSE + FINE, FINE)
    # The outermost lie a coarse step away: rounding errors, and so the unit of sizes, must not decide on them.
    return fine[np.abs(fine[:, None] - coarse).min(1) < COARSE + FINE / 100]


def _fits(problem: Problem, solved: Hypotheses) -> Fits:
    """The posterior over the grid's scales, and the uncertainty that the votes leave at the likeliest."""
    most = problem.of_votes(MOST_VOTES)
    best = float(solved.log_probability.max())
    evidence = best + float(np.log(np.exp(solved.log_probability - best).sum() * FINE))
    each = softmax(solved.log_probability + _bags(most, solved), axis=1)
    weight = each.mean(0)
    means = each @ (solved.unknown[:, SCALES] @ problem.weights)
    likeliest = int(np.argmax(solved.log_probability))
    covariance, known, of_known = _covariances(most, solved, likeliest)
    return Fits(
        weight=weight,
        log_evidence=evidence,
        log_scale=solved.unknown[:, SCALES],
        covariance=known,
        of_known=of_known,
        of_shrinkage=covariance - known,
        chance=BAG * float(means.var()),
        member=_classes_of(problem, solved, weight),
    )


def _classes_of(problem: Problem, solved: Hypotheses, weight: np.ndarray) -> np.ndarray:
    """(K + 1, N) probability of the fleet's classes and of LARGER over all hypotheses `solved`, which have `weight`
    (V,)."""
    count, along = problem.gap.shape[1], problem.along(solved)
    parts = np.array_split(problem.table, -(-count // MOST_VOTES), axis=1)
    own = len(problem.shares) + 1
    return np.hstack([np.einsum("v,kvn->kn", weight, members(part, *along)[0][:own]) for part in parts])


def _bags(problem: Problem, solved: Hypotheses) -> np.ndarray:
    """(BAGS, V) by how much bags of votes, drawn with replacement, change the log probabilities of hypotheses.

    To first order no hypothesis needs to be fitted anew, since each is at the maximum of its probability: a vote that
    is drawn twice adds its log density once more. The sum over a bag is taken to be normal, so bags do not depend on
    the order of the votes, nor their cost on the number.
    """
    density = np.log(members(problem.table, *problem.along(solved))[1])
    apart = density - density.mean(1, keepdims=True)
    believed = believed_share(apart.shape[1])
    variance, axes = np.linalg.eigh(apart @ apart.T * believed**2 / BAG)
    variance, axes = variance[-BAG_AXES:][::-1], axes[:, -BAG_AXES:][:, ::-1]
    towards = np.where(solved.unknown[:, SCALES].sum(1) @ (axes - axes.mean(0)) < 0, -1, 1)
    drawn = np.random.default_rng(0).standard_normal((BAG_AXES, BAGS // 2))[: len(variance)].T
    moved = drawn @ (axes * towards * np.sqrt(np.maximum(variance, 0))).T
    return np.vstack([moved, -moved])


def _covariances(problem: Problem, solved: Hypotheses, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three covariances (2, 2) of the scales by length and width at the `k`-th hypothesis: with everything unknown,
    with the shrinkage known, and with the votes' classes known as well.

    The information is that of votes with known classes and of the unknowns' priors, minus what not knowing the classes
    loses: the covariance of each vote's score over its possible classes (Louis 1982). The shares are unknowns, too.
    """
    (counts,), *_ = levels(solved.counts[k : k + 1], len(problem.shares))
    along = problem.along(solved.where(np.array([k])))
    p, share = members(problem.table, *along)[0][:, 0], counts / counts.sum()
    residual = np.einsum("kiu,u->ki", problem.turn, solved.unknown[k])[:, None] - problem.gap
    pull = -np.einsum("knij,knj->kni", problem.inverse, residual)
    many = len(share)
    score = np.zeros((*p.shape, UNKNOWNS + many))
    score[..., :UNKNOWNS] = np.einsum("kiu,kni->knu", problem.turn, pull)
    # The votes count for the shares only as far as in `counts`: else more of the information would be lost than exists.
    score[:many, :, UNKNOWNS:] = np.sqrt(believed_share(p.shape[1])) * (np.eye(many) - share)[:, None]
    expected = np.einsum("kn,knd->nd", p, score)
    lost = np.tensordot(p[..., None] * score, score, ((0, 1), (0, 1))) - expected.T @ expected
    whole = np.zeros_like(lost)
    information = np.einsum("kn,knij->kij", p, problem.inverse)
    whole[:UNKNOWNS, :UNKNOWNS] = np.einsum("kiu,kij,kjw->uw", problem.turn, information, problem.turn) + problem.prior
    whole[UNKNOWNS:, UNKNOWNS:] = counts.sum() * (np.diag(share) - np.outer(share, share)) + 1e-6 * np.eye(many)
    without = np.delete(np.arange(len(whole)), OF_SHRINKAGE)
    less, less_lost = whole[np.ix_(without, without)], lost[np.ix_(without, without)]
    return _of_scales(whole, lost), _of_scales(less, less_lost), _of_scales(less, np.zeros_like(less))


def _of_scales(whole: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """(2, 2) covariance of the first two unknowns, by the information `whole` minus what is `lost`.

    Computed in coordinates in which `whole` is the identity: along each direction at least LEAST_KEPT of it is left.
    """
    root = np.linalg.cholesky(np.linalg.inv(whole))
    kept, axes = np.linalg.eigh(np.eye(len(whole)) - root.T @ lost @ root)
    half = root[SCALES] @ axes / np.sqrt(np.maximum(kept, LEAST_KEPT))
    return half @ half.T
