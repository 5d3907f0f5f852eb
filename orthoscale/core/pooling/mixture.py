"""Which votes are vehicles of which class, when neither the scale nor the share of each class is known.

A place is a sample of its country: it has its own mix of vehicles, and the scale is confused with it. Minis at one
scale look much like compact cars at a smaller one, and many vans like cars at a larger one. So the scale is not sought
but tried: for each one of a grid, the mix is fitted that would have to stand there, and each counts as much as its
likelihood and the prior of the mix (a Dirichlet distribution about the country's) say. What comes out is not one scale
but several with weights: the interval is as wide, and has as many humps, as the confusion. What tells mixes apart
needs no scale: length against width, how much sizes spread, and groups of sizes with gaps between them.

A few vehicles more or less may tip such a posterior from one hump to another. So it is averaged over what other draws
of as many vehicles would have given (a bagged posterior, Huggins and Miller, Bayesian Analysis 18 (2023) 79): the value
then hardly moves with single vehicles, and the interval covers what the tables of the classes do not get right.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from .observed import FAITHFUL, Confusion, Drawing, Seen
from .problem import UNKNOWNS, Hypotheses, Mix, Problem, levels, members
from .solver import believed_share, solve

SOUGHT, COARSE, FINE = 1.0, 0.04, 0.015  # of the grid about the votes' median, and its two steps [log scale]
COARSE_VOTES = 60  # votes by which the coarse grid is judged
MANY = 200  # votes above which so many of them tell first what the scale cannot be
# Votes that the scale is fitted to, at most. Of a thousand vehicles the number leaves 0.4 % open, of 5,000 less than
# 0.2 %, where fleet and margin leave 3 to 5 %: more of them cost time and memory, and tell nothing.
MOST_VOTES = 5000
LEAST_KEPT = 0.02  # share of the information that is left however much the classes overlap
COARSE_STEPS, FINE_STEPS = 12, 40  # of fitting, at most
# A bag of as many votes as there are would count the luck of the draw twice, once in each posterior and once between
# them; one of twice as many counts half of it again, for what the tables get wrong.
BAG = 2.0  # votes in a bag, per vote
BAGS = 256
BAG_AXES = 6  # directions in which that luck moves a posterior; on 16 real places they hold all but 0.4 % of it


@dataclass(frozen=True)
class Fits:
    """One fit for each scale that is possible (V).

    weight : (V,) posterior probability of each; they sum to one.
    log_evidence : of the fleet as a whole, comparable between fleets for the same votes, SHAPE_VEHICLES at most.
    log_scale : (V, 2) by lengths and by widths.
    covariance : (2, 2) of these at the likeliest, from the votes' number, noise and unknown classes.
    of_known : (2, 2) the same, were the class of each vote known.
    drawing : (2, 2) the more of it that comes from not knowing how strongly the detector draws to the usual.
    chance : variance of the answer between draws of as many vehicles [log scale]: more of them would lessen it.
    member : (K + 1, N) probability of each class over all scales, LARGER last; what is missing from one is to be a
        lorry, partly hidden, or none.
    """

    weight: np.ndarray
    log_evidence: float
    log_scale: np.ndarray
    covariance: np.ndarray
    of_known: np.ndarray
    drawing: np.ndarray
    chance: float
    member: np.ndarray


def fit(
    seen: Seen, mixes: Sequence[Mix], drawing: Drawing = FAITHFUL, confusion: Confusion | None = None
) -> list[Fits | None]:
    """Of each of `mixes`, fits to the vehicles that are `seen`; None where no vote supports any class.

    Lengths and widths have a scale each, for fleet, margin and geometry may be off; `Mix.systematic` says how far
    the two may part: that holds the vehicles to the shape of their class. The grid is one of the sum of the two with
    `Mix.weights`; `solver` fits the mix at each of its scales.
    `drawing` is how the detector draws sizes. `confusion` is how it confuses kinds; needed where kinds are seen.
    """
    out: list[Fits | None] = [None] * len(mixes)
    # Those of as many classes are solved in step, since for one fleet alone numpy's calls would take most of the time.
    for number in {len(mix.classes) for mix in mixes}:
        alike = [k for k, mix in enumerate(mixes) if len(mix.classes) == number]
        problems = [Problem.of(seen, mixes[k], drawing, confusion) for k in alike]
        for k, problem, solved in zip(alike, problems, _possible(problems), strict=True):
            with suppress(np.linalg.LinAlgError):
                out[k] = _fits(problem, solved)
    return out


def _possible(problems: Sequence[Problem]) -> list[Hypotheses]:
    """What stands there at each scale that is possible: sought on a coarse grid with few votes, then on a fine one."""
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
    """The grid of step FINE about those scales of a coarse one that are possible."""
    coarse = solved.unknown[solved.possible, :2] @ problem.weights
    fine = np.arange(coarse.min() - COARSE, coarse.max() + COARSE + FINE, FINE)
    # The outermost lie a coarse step away: the last digits, and so the unit of sizes, must not decide on them.
    return fine[np.abs(fine[:, None] - coarse).min(1) < COARSE + FINE / 100]


def _fits(problem: Problem, solved: Hypotheses) -> Fits:
    """The posterior over the grid's scales, and what the votes leave uncertain at the likeliest."""
    most = problem.of_votes(MOST_VOTES)
    best = float(solved.log_probability.max())
    evidence = best + float(np.log(np.exp(solved.log_probability - best).sum() * FINE))
    each = _normalised(solved.log_probability + _bags(most, solved))
    weight = each.mean(0)
    means = each @ (solved.unknown[:, :2] @ problem.weights)
    likeliest = int(np.argmax(solved.log_probability))
    covariance, known, of_known = _covariances(most, solved, likeliest)
    return Fits(
        weight=weight,
        log_evidence=evidence,
        log_scale=solved.unknown[:, :2],
        covariance=known,
        of_known=of_known,
        drawing=covariance - known,
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
    """(BAGS, V) by how much bags of votes, drawn with replacement, move the log probabilities of hypotheses.

    To first order no hypothesis need be fitted anew, since each is where its probability is greatest: a vote that
    is drawn twice adds its log density once more. The sum over a bag is taken to be normal: so the bags do not
    depend on the order of the votes, nor their cost on the number.
    """
    density = np.log(members(problem.table, *problem.along(solved))[1])
    apart = density - density.mean(1, keepdims=True)
    believed = believed_share(apart.shape[1])
    variance, axes = np.linalg.eigh(apart @ apart.T * believed**2 / BAG)
    variance, axes = variance[-BAG_AXES:][::-1], axes[:, -BAG_AXES:][:, ::-1]
    towards = np.where(solved.unknown[:, :2].sum(1) @ (axes - axes.mean(0)) < 0, -1, 1)
    drawn = np.random.default_rng(0).standard_normal((BAG_AXES, BAGS // 2))[: len(variance)].T
    moved = drawn @ (axes * towards * np.sqrt(np.maximum(variance, 0))).T
    return np.vstack([moved, -moved])


def _covariances(problem: Problem, solved: Hypotheses, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three (2, 2) of the scales by length and width at the `k`-th: with every unknown, with the drawing's share known,
    and with the votes' classes known besides.

    The information of votes that wore their classes, with the unknowns' priors, less what the guessing loses: the
    covariance of each vote's score over the classes that it may be of (Louis 1982); the shares are unknown, too.
    """
    (counts,), *_ = levels(solved.counts[k : k + 1], len(problem.shares))
    along = problem.along(solved.where(np.array([k])))
    p, share = members(problem.table, *along)[0][:, 0], counts / counts.sum()
    residual = np.einsum("kiu,u->ki", problem.turn, solved.unknown[k])[:, None] - problem.gap
    pull = -np.einsum("knij,knj->kni", problem.inverse, residual)
    many = len(share)
    score = np.zeros((*p.shape, UNKNOWNS + many))
    score[..., :UNKNOWNS] = np.einsum("kiu,kni->knu", problem.turn, pull)
    # No more is believed of the shares than `counts` holds: else guessing would lose more of them than there is.
    score[:many, :, UNKNOWNS:] = np.sqrt(believed_share(p.shape[1])) * (np.eye(many) - share)[:, None]
    expected = np.einsum("kn,knd->nd", p, score)
    lost = np.tensordot(p[..., None] * score, score, ((0, 1), (0, 1))) - expected.T @ expected
    whole = np.zeros_like(lost)
    information = np.einsum("kn,knij->kij", p, problem.inverse)
    whole[:UNKNOWNS, :UNKNOWNS] = np.einsum("kiu,kij,kjw->uw", problem.turn, information, problem.turn) + problem.prior
    whole[UNKNOWNS:, UNKNOWNS:] = counts.sum() * (np.diag(share) - np.outer(share, share)) + 1e-6 * np.eye(many)
    without = np.delete(np.arange(len(whole)), UNKNOWNS - 1)
    less, less_lost = whole[np.ix_(without, without)], lost[np.ix_(without, without)]
    return _of_scales(whole, lost), _of_scales(less, less_lost), _of_scales(less, np.zeros_like(less))


def _normalised(log_weight: np.ndarray) -> np.ndarray:
    """(B, V) weights whose rows sum to one."""
    weight = np.exp(log_weight - log_weight.max(1, keepdims=True))
    return weight / weight.sum(1, keepdims=True)


def _of_scales(whole: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """(2, 2) of the first two unknowns, whose information is `whole` less what is `lost`.

    In units in which all is known to one; a guess may lose most of what there is to know, but not more.
    """
    root = np.linalg.cholesky(np.linalg.inv(whole))
    kept, axes = np.linalg.eigh(np.eye(len(whole)) - root.T @ lost @ root)
    half = root[:2] @ axes / np.sqrt(np.maximum(kept, LEAST_KEPT))
    return half @ half.T
