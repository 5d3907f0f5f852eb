"""Which votes are vehicles of which class, when neither the scale nor the share of each class is known.

A place has its own mix of vehicles. Most of all the share of vans, pickups and small trucks differs, and it is the one
that the scale is confused with: many vans at a small scale look like cars at a larger one. So the fit is made for each
share of larger vehicles that is possible, and each such fit counts as much as its likelihood and the prior say. What
comes out is not one scale but several with weights: the interval is as wide, and as lopsided, as the confusion.

Detectors draw vehicles as the usual vehicle that they expect, more or less: small ones too large, large ones too small.
So the classes are compared with boxes as the detector draws them (`Drawing`), and how strongly it does is one more
unknown: classes that stand apart (kei and ordinary cars) tell it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from ..market_segments import Class

# Outlier class: uniform over a box in (log length, log width) as wide as anything a detector could call a vehicle.
OUTLIER_DENSITY = 1 / (3.0 * 2.5)
OUTLIER_SHARE = 0.1  # at the start; then estimated, between these bounds
OUTLIER_BOUNDS = (0.01, 0.6)
PRIOR_SHARES = 30.0  # votes that the national shares count for: a share of a third strays by 0.08 between places
# Vans, pickups, minivans and the largest SUVs, which a detector of small vehicles finds too: the mean and the spread
# of those six segments of the fleet table (5.00 to 5.85 m long, 1.86 to 2.05 m wide). Which of them stand at a place is
# not known, so their mean there is a parameter of its own, with the spread between the segments for a prior.
LARGER = Class("larger", 1.0, np.array([5.39, 1.98, 2.0]), np.array([0.31, 0.065, 0.25]), 0.5, np.zeros(3))
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
# Votes that the scale is fitted to, at most. Of a thousand vehicles the number leaves 0.4 % open, of 5,000 less than
# 0.2 %, where fleet and margin leave 3 to 5 %: more of them cost time and memory, and tell nothing.
MOST = 5000
LEAST_KEPT = 0.02  # share of the information that is left however much the classes overlap
# The tables' shapes (spreads, tails, shares of classes) are good to about 10 %, which is what 50 vehicles can tell of a
# spread. More of them make neither a fleet nor a share of larger vehicles more likely than another: what they would
# tell apart is finer than what is known.
SHAPE_VEHICLES = 50
EM_ROUNDS = 120
EM_SETTLED = 1e-4
UNKNOWNS = 5


@dataclass(frozen=True)
class Drawing:
    """How a detector draws sizes: log box = log vehicle + share * (log usual - log vehicle), and the margin.

    share, share_sd : (2,) of length and width, 0 for a faithful detector, and one sigma; both stray as one.
    usual : (2,) length and width that boxes are drawn to [m].
    """

    share: np.ndarray
    share_sd: np.ndarray
    usual: np.ndarray

    def log_mean(self, part: Class) -> np.ndarray:
        """(2,) of the boxes of a class, their margin taken off."""
        return part.log_mean + self.share * (np.log(self.usual) - part.log_mean)

    def covariance(self, covariance: np.ndarray) -> np.ndarray:
        """(2, 2) of boxes, in logarithms, where that of vehicles is `covariance`."""
        return covariance * np.outer(1 - self.share, 1 - self.share)

    def slope(self, part: Class) -> np.ndarray:
        """(2,) change of `log_mean` for one sigma of the share."""
        return self.share_sd * (np.log(self.usual) - part.log_mean)


FAITHFUL = Drawing(np.zeros(2), np.zeros(2), np.ones(2))


@dataclass(frozen=True)
class Fits:
    """One fit for each share of larger vehicles (V).

    weight : (V,) posterior probability of each share; they sum to one.
    log_evidence : of the fleet as a whole, comparable between fleets for the same votes, SHAPE_VEHICLES at most.
    log_scale : (V, 2) by lengths and by widths.
    covariance : (V, 2, 2) of these, from the votes' number, noise and unknown classes.
    drawing : (V, 2, 2) the more of it that comes from not knowing how strongly the detector draws to the usual.
    count : (V,) votes that are vehicles, the sum of their probabilities.
    member : (K + 1, N) probability of each class, the larger vehicles last, over all shares; what is missing from one
        is to be none.
    """

    weight: np.ndarray
    log_evidence: float
    log_scale: np.ndarray
    covariance: np.ndarray
    drawing: np.ndarray
    count: np.ndarray
    member: np.ndarray


@dataclass(frozen=True)
class _Likelihood:
    """What N votes would say, were they of each of the classes (K + 1).

    gap : (K + 1, N, 2) log scale by each. spread, inverse : (K + 1, N, 2, 2) its covariance, and the inverse. height :
    (K + 1, N) of each normal distribution.
    """

    gap: np.ndarray
    spread: np.ndarray
    inverse: np.ndarray
    height: np.ndarray

    @classmethod
    def of(
        cls, log_size: np.ndarray, noise: np.ndarray, means: np.ndarray, covariances: np.ndarray, rough: float
    ) -> _Likelihood:
        """Of votes of `log_size` (N, 2) and `noise` (N, 2) [units] for classes with the log `means` (K + 1, 2) and
        `covariances` (K + 1, 2, 2); `rough` is the log scale by lengths."""
        # A box's noise is a share of what its vehicle should measure, not of what it does measure: else boxes that came
        # out large by chance would count for more. The scale for it need only be rough, but it is one: by a scale of
        # their own, widths that are far too small for any vehicle would be nothing but noise, and contradict nobody.
        relative = (noise / np.exp(means - rough)[:, None]) ** 2
        spread = covariances[:, None] + relative[..., None] * np.eye(2)
        inverse = np.linalg.inv(spread)
        height = np.sqrt(np.linalg.det(inverse)) / (2 * np.pi)
        # Noise lowers a logarithm's mean by half its variance.
        return cls((means[:, None] - 0.5 * relative) - log_size, spread, inverse, height)

    def members(
        self, moved: np.ndarray, weight: np.ndarray, outliers: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(V, K + 1, N) probability of each class, (V, N) density of each vote, (V, K + 1, N, 2) its pull upwards in
        scale; at the log scales `moved` (V, K + 1, 2) that each class has, and the shares `weight` (V, K + 1) and
        `outliers` (V,)."""
        i00, i01, i11 = self.inverse[..., 0, 0], self.inverse[..., 0, 1], self.inverse[..., 1, 1]
        r0, r1 = (moved[..., k, None] - self.gap[..., k] for k in (0, 1))  # (V, K + 1, N)
        density = self.height * np.exp(-0.5 * (i00 * r0**2 + 2 * i01 * r0 * r1 + i11 * r1**2))
        weighted = weight[..., None] * density
        total = weighted.sum(1) + (outliers * OUTLIER_DENSITY)[:, None]
        return weighted / total[:, None], total, -np.stack([i00 * r0 + i01 * r1, i01 * r0 + i11 * r1], -1)


def fit(
    log_size: np.ndarray,
    noise: np.ndarray,
    classes: Sequence[Class],
    systematic: np.ndarray,
    shares: np.ndarray = LARGER_SHARES,
    drawing: Drawing = FAITHFUL,
) -> Fits:
    """Fits to votes of `log_size` (N, 2), whose boxes have the one-sigma `noise` (N, 2) [units of the sizes].

    Expectation-maximisation over the scale, the shares of the classes and the share of outliers. The shares start at
    the fleet's, which count as PRIOR_SHARES votes. Lengths and widths have a scale each, for fleet, margin and geometry
    may be off; `systematic` (2, 2) says how far the two may part: that holds the vehicles to the shape of their class.
    `shares` (V,) of larger vehicles are tried. `drawing` is how the detector draws sizes.
    """
    if len(log_size) > MANY and len(shares) > 1:
        some = np.linspace(0, len(log_size) - 1, STARTERS).astype(int)
        first = fit(log_size[some], noise[some], classes, systematic, shares, drawing)
        shares = shares[first.weight > RULED_OUT]
    national = np.array([c.weight for c in classes]) / sum(c.weight for c in classes)
    every = [*classes, LARGER]
    means = np.array([drawing.log_mean(c) for c in every])
    covariances = np.array([drawing.covariance(c.log_covariance) for c in every])
    rough = float(np.median(np.median(means[:-1, 0]) - log_size[:, 0]))
    few = np.linspace(0, len(log_size) - 1, min(len(log_size), MOST)).astype(int)
    votes = _Likelihood.of(log_size[few], noise[few], means, covariances, rough)
    tie = np.linalg.inv(systematic)  # holds the two scales to one another, and leaves what they share free
    tie = tie - np.outer(tie.sum(0), tie.sum(0)) / tie.sum()

    # Unknowns: two scales, the stray of the larger vehicles' mean here from LARGER's, and of the drawing's share [its
    # one sigma]. They are solved for together: where most votes are larger vehicles, scales and stray move as one.
    turn = np.zeros((len(every), 2, UNKNOWNS))  # (K + 1, 2, UNKNOWNS) of the residuals
    turn[:, :, :2] = np.eye(2)
    turn[-1, :, 2:4] = -np.eye(2)
    turn[:, :, 4] = [-drawing.slope(c) for c in every]
    prior = np.zeros((UNKNOWNS, UNKNOWNS))
    prior[:2, :2], prior[4, 4] = tie, 1.0
    prior[2:4, 2:4] = np.linalg.inv(drawing.covariance(LARGER.log_covariance))

    v = shares
    share = np.repeat(national[None], len(v), 0)
    outliers = np.full(len(v), OUTLIER_SHARE)
    unknown = np.zeros((len(v), UNKNOWNS))
    unknown[:, :2] = _start(votes.gap, votes.spread + systematic, national, v)
    i00, i01, i11 = votes.inverse[..., 0, 0], votes.inverse[..., 0, 1], votes.inverse[..., 1, 1]
    for _ in range(EM_ROUNDS):
        moved = np.einsum("kiu,vu->vki", turn, unknown)
        weight = np.concatenate([share * (1 - v)[:, None], v[:, None]], 1) * (1 - outliers)[:, None]
        at = moved, weight, outliers
        p, total, pull = votes.members(*at)
        a00, a01, a11 = ((p * i).sum(2) for i in (i00, i01, i11))  # (V, K + 1)
        information = np.stack([np.stack([a00, a01], -1), np.stack([a01, a11], -1)], -2)
        pulled = (p[..., None] * pull).sum(2)  # (V, K + 1, 2) upwards in scale
        system = np.einsum("kiu,vkij,kjw->vuw", turn, information, turn) + prior
        right = np.einsum("kiu,vki->vu", turn, pulled) - unknown @ prior
        step = np.linalg.solve(system, right[..., None])[..., 0]
        outliers = np.clip(1 - p.sum(1).mean(1), *OUTLIER_BOUNDS)
        ordinary = p[:, :-1].sum(2) + PRIOR_SHARES * national
        share = ordinary / ordinary.sum(1, keepdims=True)
        unknown = unknown + step
        if np.abs(step[:, :4]).max() < EM_SETTLED:
            break

    log_scale = unknown[:, :2]
    each = [_covariances(p[k], pull[k], turn, system[k], share[k]) for k in range(len(v))]
    covariance, known = (np.array(c) for c in zip(*each, strict=True))
    # Laplace's approximation of the integral over the scales, at the best shares and stray.
    log_posterior = np.log(total).sum(1) + 0.5 * np.linalg.slogdet(covariance)[1] + 0.5 * np.log(np.trace(tie))
    log_posterior -= 0.5 * np.einsum("vi,ij,vj->v", unknown, prior, unknown)
    log_posterior += PRIOR_SHARES * (national * np.log(share / national)).sum(1)
    log_posterior = min(1.0, SHAPE_VEHICLES / len(few)) * log_posterior + _log_prior(classes, v)
    likely = np.exp(log_posterior - log_posterior.max())
    evidence = float(log_posterior.max() + np.log(likely.sum()))
    likely /= likely.sum()
    if len(few) == len(log_size):
        member = np.einsum("v,vkn->kn", likely, p)
    else:
        blocks = np.array_split(np.arange(len(log_size)), -(-len(log_size) // MOST))
        all_votes = (_Likelihood.of(log_size[k], noise[k], means, covariances, rough) for k in blocks)
        member = np.hstack([np.einsum("v,vkn->kn", likely, some.members(*at)[0]) for some in all_votes])
    return Fits(likely, evidence, log_scale, known, covariance - known, p.sum((1, 2)), member)


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


def _covariances(
    p: np.ndarray, pull: np.ndarray, turn: np.ndarray, system: np.ndarray, share: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Two (2, 2) of the scales by length and width: with every unknown, and with the drawing's share known.

    The information of votes that wore their classes, `system` with the unknowns' priors, less what the guessing loses:
    the covariance of each vote's score over the classes that it may be of (Louis 1982). `pull` (K + 1, N, 2) is each
    vote's derivative by the scales, were it of each class; `turn` as in `fit`; the classes' shares are unknown, too.
    """
    many = len(share)
    score = np.zeros((*p.shape, UNKNOWNS + many))
    score[..., :UNKNOWNS] = np.einsum("kiu,kni->knu", turn, pull)
    score[:-1, :, UNKNOWNS:] = (np.eye(many) - share)[:, None]
    expected = np.einsum("kn,knd->nd", p, score)
    lost = np.einsum("kn,knd,kne->de", p, score, score) - expected.T @ expected
    whole = np.zeros_like(lost)
    whole[:UNKNOWNS, :UNKNOWNS] = system
    whole[UNKNOWNS:, UNKNOWNS:] = (p[:-1].sum() + PRIOR_SHARES) * (
        np.diag(share) - np.outer(share, share)
    ) + 1e-6 * np.eye(many)
    without = np.delete(np.arange(len(whole)), UNKNOWNS - 1)
    return _of_scales(whole, lost), _of_scales(whole[np.ix_(without, without)], lost[np.ix_(without, without)])


def _of_scales(whole: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """(2, 2) of the first two unknowns, whose information is `whole` less what is `lost`.

    In units in which all is known to one; a guess may lose most of what there is to know, but not more.
    """
    root = np.linalg.cholesky(np.linalg.inv(whole))
    kept, axes = np.linalg.eigh(np.eye(len(whole)) - root.T @ lost @ root)
    half = root[:2] @ axes / np.sqrt(np.maximum(kept, LEAST_KEPT))
    return half @ half.T
