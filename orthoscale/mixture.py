"""Which votes are vehicles of which class, when neither the scale nor the share of each class is known.

A place has its own mix of vehicles. Most of all the share of vans, pickups and small trucks differs, and it is the one
that the scale is confused with: many vans at a small scale look like cars at a larger one. So the fit is made for each
share of larger vehicles that is possible, and each such fit counts as much as its likelihood and the prior say. What
comes out is not one scale but several with weights: the interval is as wide, and as lopsided, as the confusion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from .fleet import Class

# Outlier class: uniform over a box in (log length, log width) as wide as anything a detector could call a vehicle.
OUTLIER_DENSITY = 1 / (3.0 * 2.5)
OUTLIER_SHARE = 0.1  # at the start; then estimated, between these bounds
OUTLIER_BOUNDS = (0.01, 0.6)
PRIOR_SHARES = 10.0  # votes that the national shares of the fleet's classes count for
# Vans, pickups, minivans and the largest SUVs, which a detector of small vehicles finds too: the mean and the spread
# of those six segments of the fleet table (5.00 to 5.85 m long, 1.86 to 2.05 m wide). Which of them stand at a place is
# not known, so their mean there is a parameter of its own, with the spread between the segments for a prior.
LARGER = Class("larger", 1.0, np.array([5.39, 1.98, 2.0]), np.array([0.31, 0.065, 0.25]), 0.5)
# Prior of their share at a place, beyond the fleet's own: Beta(1, b). Vans are 10 to 12 % of the light vehicles
# registered in Europe (ACEA: 30 of 280 million), which fleets of cars leave out. A fleet with pickups has its long
# vehicles already; some are left out all the same. A mean of 11 % has one place in ten above a quarter.
LEFT_OUT = 0.11
LEFT_OUT_AT_LEAST = 0.05
LONG = 5.2  # [m] a third of LARGER is shorter than that
LARGER_SHARES = np.arange(0.01, 0.61, 0.02)
STARTERS = 300  # votes from which the starting point is searched
MANY = 1000  # votes above which STARTERS of them rule out, first, what share of larger vehicles cannot be
RULED_OUT = 1e-4
LEAST_KEPT = 0.02  # share of the information that is left however much the classes overlap
# The tables' shapes (spreads, tails, shares of classes) are good to about 10 %, which is what 50 vehicles can tell of a
# spread. More of them make neither a fleet nor a share of larger vehicles more likely than another: what they would
# tell apart is finer than what is known.
SHAPE_VEHICLES = 50
ROUNDS = 120
SETTLED = 1e-4


@dataclass(frozen=True)
class Fits:
    """One fit for each share of larger vehicles (V).

    weight : (V,) posterior probability of each share; they sum to one.
    log_evidence : of the fleet as a whole, comparable between fleets for the same votes, SHAPE_VEHICLES at most.
    log_scale : (V, 2) by lengths and by widths.
    covariance : (V, 2, 2) of these, from the votes' number, noise and unknown classes.
    member : (V, K + 1, N) probability of each class, the larger vehicles last; what is missing from one is to be none.
    """

    weight: np.ndarray
    log_evidence: float
    log_scale: np.ndarray
    covariance: np.ndarray
    member: np.ndarray


def fit(
    log_size: np.ndarray,
    noise: np.ndarray,
    classes: Sequence[Class],
    systematic: np.ndarray,
    shares: np.ndarray = LARGER_SHARES,
) -> Fits:
    """Fits to votes of `log_size` (N, 2), whose boxes have the one-sigma `noise` (N, 2) [units of the sizes].

    Expectation-maximisation over the scale, the shares of the classes and the share of outliers. The shares start at
    the fleet's, which count as PRIOR_SHARES votes. Lengths and widths have a scale each, for fleet, margin and geometry
    may be off; `systematic` (2, 2) says how far the two may part: that holds the vehicles to the shape of their class.
    `shares` (V,) of larger vehicles are tried.
    """
    if len(log_size) > MANY and len(shares) > 1:
        some = np.linspace(0, len(log_size) - 1, STARTERS).astype(int)
        first = fit(log_size[some], noise[some], classes, systematic, shares)
        shares = shares[first.weight > RULED_OUT]
    national = np.array([c.weight for c in classes]) / sum(c.weight for c in classes)
    every = [*classes, LARGER]
    means = np.array([c.log_mean for c in every])
    # A box's noise is a share of what its vehicle should measure, not of what it does measure: else boxes that came out
    # large by chance would count for more. The scale for it need only be rough.
    rough = np.median(np.median(means[:-1], axis=0) - log_size, axis=0)
    noise = (noise / np.exp(means - rough)[:, None]) ** 2
    spread = np.array([c.log_covariance for c in every])[:, None] + noise[..., None] * np.eye(2)
    inverse = np.linalg.inv(spread)
    height = np.sqrt(np.linalg.det(inverse)) / (2 * np.pi)  # (K + 1, N) of each normal distribution
    # (K + 1, N, 2) log scale by each vote, were it of each class; noise lowers a logarithm's mean by half its variance.
    gap = (means[:, None] - 0.5 * noise) - log_size
    tie = np.linalg.inv(systematic)  # holds the two scales to one another, and leaves what they share free
    tie = tie - np.outer(tie.sum(0), tie.sum(0)) / tie.sum()

    v = shares
    share = np.repeat(national[None], len(v), 0)
    outliers = np.full(len(v), OUTLIER_SHARE)
    log_scale = _start(gap, spread + systematic, national, v)
    stray = np.zeros((len(v), 2))  # of the larger vehicles' mean here, from LARGER's
    stray_prior = np.linalg.inv(LARGER.log_covariance)
    i00, i01, i11 = inverse[..., 0, 0], inverse[..., 0, 1], inverse[..., 1, 1]
    for _ in range(ROUNDS):
        r0, r1 = (np.repeat(log_scale[:, k, None], len(every), 1)[..., None] - gap[..., k] for k in (0, 1))
        r0[:, -1] -= stray[:, :1]
        r1[:, -1] -= stray[:, 1:]
        density = height * np.exp(-0.5 * (i00 * r0**2 + 2 * i01 * r0 * r1 + i11 * r1**2))
        prior = np.concatenate([share * (1 - v)[:, None], v[:, None]], 1) * (1 - outliers)[:, None]
        weighted = prior[..., None] * density
        total = weighted.sum(1) + (outliers * OUTLIER_DENSITY)[:, None]
        p = weighted / total[:, None]
        a00, a01, a11 = ((p * i).sum(2) for i in (i00, i01, i11))  # (V, K + 1)
        information = np.stack([np.stack([a00, a01], -1), np.stack([a01, a11], -1)], -2)
        pull0, pull1 = i00 * r0 + i01 * r1, i01 * r0 + i11 * r1
        pulled = -np.stack([(p * pull0).sum(2), (p * pull1).sum(2)], -1)  # (V, K + 1, 2) upwards in scale
        # Scales and stray are solved for together: where most votes are larger vehicles, they move as one.
        system = np.zeros((len(v), 4, 4))
        system[:, :2, :2] = information.sum(1) + tie
        system[:, :2, 2:] = system[:, 2:, :2] = -information[:, -1]
        system[:, 2:, 2:] = information[:, -1] + stray_prior
        right = np.concatenate([pulled.sum(1) - log_scale @ tie, -pulled[:, -1] - stray @ stray_prior], 1)
        step = np.linalg.solve(system, right[..., None])[..., 0]
        outliers = np.clip(1 - p.sum(1).mean(1), *OUTLIER_BOUNDS)
        ordinary = p[:, :-1].sum(2) + PRIOR_SHARES * national
        share = ordinary / ordinary.sum(1, keepdims=True)
        log_scale, stray = log_scale + step[:, :2], stray + step[:, 2:]
        if np.abs(step).max() < SETTLED:
            break

    pull = -np.stack([pull0, pull1], -1)
    covariance = np.array([_covariance(p[k], pull[k], system[k], share[k]) for k in range(len(v))])
    # Laplace's approximation of the integral over the scales, at the best shares and stray.
    log_posterior = np.log(total).sum(1) + 0.5 * np.linalg.slogdet(covariance)[1] + 0.5 * np.log(np.trace(tie))
    log_posterior -= 0.5 * np.einsum("vi,ij,vj->v", log_scale, tie, log_scale)
    log_posterior -= 0.5 * np.einsum("vi,ij,vj->v", stray, stray_prior, stray)
    log_posterior += PRIOR_SHARES * (national * np.log(share / national)).sum(1)
    log_posterior = min(1.0, SHAPE_VEHICLES / len(log_size)) * log_posterior + _log_prior(classes, v)
    weight = np.exp(log_posterior - log_posterior.max())
    evidence = float(log_posterior.max() + np.log(weight.sum()))
    return Fits(weight / weight.sum(), evidence, log_scale, covariance, p)


def _log_prior(classes: Sequence[Class], larger: np.ndarray) -> np.ndarray:
    """(V,) log density of each share of `larger` vehicles beyond those of `classes`."""
    own = sum(c.weight * ndtr((c.mean[0] - LONG) / c.sd[0]) for c in classes) / sum(c.weight for c in classes)
    b = 1 / max(LEFT_OUT - own, LEFT_OUT_AT_LEAST) - 1
    return np.log(b) + (b - 1) * np.log1p(-larger)


def _start(gap: np.ndarray, spread: np.ndarray, national: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """(V, 2) the best scale of a grid, the same for lengths and widths, for each share of larger vehicles."""
    some = np.linspace(0, gap.shape[1] - 1, min(gap.shape[1], STARTERS)).astype(int)
    gap, inverse = gap[:, some], np.linalg.inv(spread[:, some])
    grid = float(np.median(gap[:-1].mean((0, 2)))) + np.arange(-1.0, 1.0, 0.02)
    r = grid[:, None, None, None] - gap
    square = np.einsum("gkni,knij,gknj->gkn", r, inverse, r)
    density = np.sqrt(np.linalg.det(inverse)) / (2 * np.pi) * np.exp(-0.5 * square)
    ordinary = np.einsum("k,gkn->gn", national, density[:, :-1])
    mixed = [(1 - v) * ordinary + v * density[:, -1] for v in shares]
    likelihood = np.log((1 - OUTLIER_SHARE) * np.stack(mixed) + OUTLIER_SHARE * OUTLIER_DENSITY).sum(2)
    return np.repeat(grid[np.argmax(likelihood, 1)][:, None], 2, 1)


def _covariance(
    p: np.ndarray,
    pull: np.ndarray,
    system: np.ndarray,
    share: np.ndarray,
) -> np.ndarray:
    """(2, 2) of the scales by length and width, with shares and stray unknown and every vote's class only guessed.

    The information of votes that wore their classes, `system` (4, 4) for scales and stray with their priors, less what
    the guessing loses: the covariance of each vote's score over the classes that it may be of (Louis 1982).
    `pull` (K + 1, N, 2) is each vote's derivative by the scales, were it of each class.
    """
    many = len(share)
    score = np.zeros((*p.shape, 4 + many))
    score[..., :2] = pull
    score[-1, :, 2:4] = -pull[-1]
    score[:-1, :, 4:] = (np.eye(many) - share)[:, None]
    expected = np.einsum("kn,knd->nd", p, score)
    lost = np.einsum("kn,knd,kne->de", p, score, score) - expected.T @ expected
    whole = np.zeros_like(lost)
    whole[:4, :4] = system
    whole[4:, 4:] = (p[:-1].sum() + PRIOR_SHARES) * (np.diag(share) - np.outer(share, share)) + 1e-6 * np.eye(many)
    # In units in which all is known to one; a guess may lose most of what there is to know, but not more.
    root = np.linalg.cholesky(np.linalg.inv(whole))
    kept, axes = np.linalg.eigh(np.eye(len(whole)) - root.T @ lost @ root)
    half = root[:2] @ axes / np.sqrt(np.maximum(kept, LEAST_KEPT))
    return half @ half.T
