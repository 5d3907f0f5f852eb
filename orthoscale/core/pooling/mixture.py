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

Detectors draw vehicles as the usual vehicle that they expect, more or less: small ones too large, large ones too small.
So the classes are compared with boxes as the detector draws them (`Drawing`), and how strongly it does is one more
unknown: classes that stand apart (kei and ordinary cars) tell it.

What vehicles are called (car, pickup, van, larger) tells classes apart that sizes confuse: a street of pickups from one
of cars at another scale. How often a detector is mistaken differs from place to place, and all vehicles of a place have
that in common. So what those of each class are called is fitted like the shares of the classes, about what the
detector's card says (`Confusion`): a hundred vehicles do not overrule what ten of them would leave open.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import chain

import numpy as np
from scipy.special import digamma, gammaln, ndtr

from ..boxes import KINDS
from ..market_segments import PLACE_VEHICLES, Class, Places

# Outlier class: uniform over a box in (log length, log width) as wide as anything a detector could call a vehicle.
OUTLIER_DENSITY = 1 / (3.0 * 2.5)
OUTLIER_SHARE = 0.1  # of the boxes, beforehand, ...
OUTLIER_BOXES = 10.0  # ... as if it had been counted on so many: it depends on the picture, not on the country's mix
# Vans of middle size and large ones, minivans, pickups of middle and of full size, and the largest SUVs, which a
# detector of small vehicles finds too: the mean and the spread of those six segments (5.00 to 5.85 m long, 1.86 to
# 2.05 m wide; four are in data/fleets.json, the vans in the table that it was made from). Which of them stand at a
# place is not known, so their mean there is a parameter of its own, with the spread between the segments for a prior.
LARGER = Class(
    "larger", 1.0, np.array([5.39, 1.98, 2.0]), np.array([0.31, 0.065, 0.25]), 0.5, np.zeros(3),
    kinds=np.array([0.25, 0.25, 0.4, 0.1]),  # those six in equal parts, and small lorries; judged
)  # fmt: skip
# Small lorries, large vans and minibuses, which look like cars to a detector of small vehicles: the middle and the
# spread of their usual sizes (Toyota Coaster 6.3 to 7.0 x 2.04 m, Isuzu NPR 6.0 to 7.7 x 2.1, Mercedes Sprinter, long,
# 7.0 x 2.02, Tata 407 5.7 x 2.1, American cutaway vans 7.3 x 2.4; makers' sheets, recalled). They say little of the
# scale. Without a class of their own they would be LARGER at a smaller one, and cars the smallest there are.
LORRIES = Class(
    "small lorries and buses", 1.0, np.array([6.8, 2.2, 2.7]), np.array([0.7, 0.15, 0.35]), 0.5, np.zeros(3),
    kinds=np.array([0.0, 0.0, 0.4, 0.6]),
)  # fmt: skip
LORRIES_SHARE = 0.03  # of the vehicles: 19 of 521 boxes of eight orthophotos are longer than 5.9 m, none American
# That share is known as if it had been counted on so many: it is 0 to 0.06 at the six of those places that have more
# than 20 boxes. Where most vehicles would be lorries, it is the scale that is wrong.
LORRIES_VEHICLES = 100.0
# Vehicles of which a part is not told: it lies under a tree or a roof or in black shade, or looks like the ground. What
# is measured of them is too short, by little or by half, and hardly too narrow. Without a class of their own the
# fleet's smallest vehicles would have to be as short, which is a larger scale: at 52 American places made of chips
# (benchmarks/results/places.md) the error was 6.1 % (root mean square) without this class and 4.3 % with it; other
# sizes, spreads and twice the share gave 4.1 to 4.9 %. Since then the measurer tells fewer vehicles too short, so half
# as many are expected.
HIDDEN_SIZE, HIDDEN_SD = (0.78, 0.94), (0.15, 0.1)  # mean and spread, as shares of the fleet's mean length and width
HIDDEN_SHARE, HIDDEN_VEHICLES = 0.03, 100.0  # of the vehicles, as with lorries: where most would be, the scale is wrong
BESIDE_FLEET = 3  # classes beside a fleet's own: LARGER, LORRIES, and the hidden
# The share of LARGER at a place, beyond the fleet's own. Vans are 10 to 12 % of the light vehicles registered in Europe
# (ACEA: 30 of 280 million), which fleets of cars leave out. A fleet with pickups has its long vehicles already; some
# are left out all the same. How well that share is known: `Places.left_out`.
LEFT_OUT = 0.11
LEFT_OUT_AT_LEAST = 0.05
LONG = 5.2  # [m] a third of LARGER is shorter than that
# The tables' shapes (spreads, tails, shares of classes) are good to about 14 %, which is what 25 vehicles can tell of a
# spread. More of them make neither a fleet nor a mix more likely than another: what they would tell apart is finer than
# what is known. On those 52 places the densities of the truths are e^4 times higher with 25 than with 50, with 12 they
# are lower again.
SHAPE_VEHICLES = 25
SOUGHT, COARSE, FINE = 1.0, 0.04, 0.015  # of the grid about the votes' median, and its two steps [log scale]
COARSE_VOTES = 60  # votes by which the coarse grid is judged
MANY = 200  # votes above which so many of them tell first what the scale cannot be
# Votes that the scale is fitted to, at most. Of a thousand vehicles the number leaves 0.4 % open, of 5,000 less than
# 0.2 %, where fleet and margin leave 3 to 5 %: more of them cost time and memory, and tell nothing.
MOST_VOTES = 5000
IMPOSSIBLE = 9.0  # log probability below the best from which a scale is not tried again
LEAST_KEPT = 0.02  # share of the information that is left however much the classes overlap
COARSE_STEPS, FINE_STEPS, STILL = 12, 40, 3e-4  # of fitting: at most so many, until nothing moves by more
# Log probability below the best, by steps of fitting, from which a scale is given up. Of those that turned out possible
# on six real places with 84 fleets, none was below 100 after two steps, 36 after four, 13 after eight.
GIVEN_UP = {2: 130.0, 4: 60.0, 8: 25.0}
UNKNOWNS = 5
# What boxes without a vehicle are called: any kind alike. Lorries, which are as little of these classes, are larger.
OUTLIER_CALLED = 1 / len(KINDS)
# Of the vehicles of a kind, how many are called any kind however good the card's table is: readings have mistakes too.
CALLED_ANYTHING = 0.02
# A bag of as many votes as there are would count the luck of the draw twice, once in each posterior and once between
# them; one of twice as many counts half of it again, for what the tables get wrong.
BAG = 2.0  # votes in a bag, per vote
BAGS = 256
BAG_AXES = 6  # directions in which that luck moves a posterior; on 16 real places they hold all but 0.4 % of it


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
class Confusion:
    """What vehicles are called, when they are of a kind: a measurer's confusion table, and how it holds at a place.

    table : (4, 4) shares; what vehicles of each of `boxes.KINDS` (rows) are called (columns), on average over places.
    vehicles : a place has shares of its own, as if it had them from so many vehicles (a Dirichlet distribution: one
        sigma of a share p is the root of p (1 - p) / (vehicles + 1)).
    """

    table: np.ndarray
    vehicles: float

    @property
    def shares(self) -> np.ndarray:
        """(4, 4) `table` as it is believed; its rows sum to one."""
        return (1 - CALLED_ANYTHING) * self.table / self.table.sum(1, keepdims=True) + CALLED_ANYTHING / len(KINDS)

    def called(self, classes: Sequence[Class]) -> np.ndarray:
        """(K, 4) what the vehicles of each class are called, as parameters of Dirichlet distributions."""
        return self.vehicles * np.array([c.kinds for c in classes]) @ self.shares


@dataclass(frozen=True)
class Seen:
    """What is seen of N vehicles.

    log_size : (N, 2) logarithms of length and width [any unit]. noise : (N, 2) their one-sigma noise [the unit].
    called : (N, 4) shares of `boxes.KINDS` that each is called, zeros where nobody looked; (N, 0) where nobody did.
    """

    log_size: np.ndarray
    noise: np.ndarray
    called: np.ndarray

    def __len__(self) -> int:
        return len(self.log_size)

    def __getitem__(self, some: np.ndarray) -> Seen:
        return Seen(self.log_size[some], self.noise[some], self.called[some])


@dataclass(frozen=True)
class Fits:
    """One fit for each scale that is possible (V).

    weight : (V,) posterior probability of each; they sum to one.
    log_evidence : of the fleet as a whole, comparable between fleets for the same votes, SHAPE_VEHICLES at most.
    log_scale : (V, 2) by lengths and by widths.
    covariance : (2, 2) of these at the likeliest, from the votes' number, noise and unknown classes.
    drawing : (2, 2) the more of it that comes from not knowing how strongly the detector draws to the usual.
    chance : variance of the answer between draws of as many vehicles [log scale]: more of them would lessen it.
    member : (K + 1, N) probability of each class over all scales, LARGER last; what is missing from one is to be a
        lorry, partly hidden, or none.
    """

    weight: np.ndarray
    log_evidence: float
    log_scale: np.ndarray
    covariance: np.ndarray
    drawing: np.ndarray
    chance: float
    member: np.ndarray


@dataclass(frozen=True)
class Mix:
    """What a fleet tells the fit.

    systematic : (2, 2) covariance by which lengths and widths may be off together. weights : (2,) of the two scales.
    place : how much places are like their country (`market_segments.PLACE_VEHICLES`).
    """

    classes: Sequence[Class]
    systematic: np.ndarray
    weights: np.ndarray
    place: Sequence[Places] = PLACE_VEHICLES


def fit(
    seen: Seen, mixes: Sequence[Mix], drawing: Drawing = FAITHFUL, confusion: Confusion | None = None
) -> list[Fits | None]:
    """Of each of `mixes`, fits to the vehicles that are `seen`; None where no vote supports any class.

    Lengths and widths have a scale each, for fleet, margin and geometry may be off; `Mix.systematic` says how far
    the two may part: that holds the vehicles to the shape of their class. The grid is one of the sum of the two with
    `Mix.weights`. At each of its scales the shares of the classes are fitted by variational Bayes (Bishop, Pattern
    Recognition and Machine Learning, 10.2, with the components known), and what else is unknown by Newton's steps.
    `drawing` is how the detector draws sizes. `confusion` is how it confuses kinds; needed where kinds are seen.
    """
    out: list[Fits | None] = [None] * len(mixes)
    # Those of as many classes are solved in step, since for one fleet alone numpy's calls would take most of the time.
    for number in {len(mix.classes) for mix in mixes}:
        alike = [k for k, mix in enumerate(mixes) if len(mix.classes) == number]
        problems = [_Problem.of(seen, mixes[k], drawing, confusion) for k in alike]
        for k, problem, solved in zip(alike, problems, _possible(problems), strict=True):
            with suppress(np.linalg.LinAlgError):
                out[k] = problem.fits(solved)
    return out


def _possible(problems: Sequence[_Problem]) -> list[_Solved]:
    """What stands there at each scale that is possible: sought on a coarse grid with few votes, then on a fine one."""
    coarse = np.arange(-SOUGHT, SOUGHT, COARSE)
    few = [p.of_votes(COARSE_VOTES) for p in problems]
    solved = _solved(few, [p.start(p.middle + coarse) for p in problems], COARSE_STEPS)
    some = [p.of_votes(MANY) for p in problems]
    solved = _solved(some, [p.start(_finer(s)) for p, s in zip(problems, solved, strict=True)], FINE_STEPS)
    if problems[0].gap.shape[1] > MANY:
        most = [p.of_votes(MOST_VOTES) for p in problems]
        solved = _solved(most, [s.where(s.possible) for s in solved], FINE_STEPS)
    return solved


@dataclass(frozen=True)
class _Solved:
    """What stands there for each of V hypotheses: the scale, and how much the place is like its country.

    prior : (V, C) what a place has beforehand, counts : afterwards, as the parameters of Dirichlet distributions
    (`_levels`). log_prior : (V,) log probability beforehand; log_probability : afterwards, but for a
    constant. unknown : (V, UNKNOWNS).
    """

    prior: np.ndarray
    log_prior: np.ndarray
    counts: np.ndarray
    unknown: np.ndarray
    log_probability: np.ndarray

    @property
    def possible(self) -> np.ndarray:
        """(V,) bool."""
        return self.log_probability > self.log_probability.max() - IMPOSSIBLE

    def where(self, wanted: np.ndarray) -> _Solved:
        """Only the hypotheses that are `wanted` (V,)."""
        return _Solved(*(getattr(self, field.name)[wanted] for field in fields(self)))


def _finer(solved: _Solved) -> np.ndarray:
    """The grid of step FINE about those scales of a coarse one that are possible."""
    coarse = solved.unknown[solved.possible, :2].mean(1)
    fine = np.arange(coarse.min() - COARSE, coarse.max() + COARSE, FINE)
    return fine[np.abs(fine[:, None] - coarse).min(1) < COARSE]


@dataclass(frozen=True)
class _Problem:
    """K classes, LARGER, LORRIES and partly hidden vehicles, N votes, and UNKNOWNS: two scales, the stray of the larger
    vehicles' mean here from LARGER's (2), and of the drawing's share [its one sigma]. They are solved for together:
    where most votes are larger vehicles, scales and stray move as one.

    gap : (K + 3, N, 2) log scale by each vote, were it of each class. inverse : (K + 3, N, 2, 2) of its covariance.
    turn : (K + 3, 2, UNKNOWNS) of the residuals. prior : (UNKNOWNS, UNKNOWNS) inverse covariance beforehand.
    shares : (K,) of the classes in the country. larger : share of larger vehicles beside them. place : as of `Mix`.
    basis : (UNKNOWNS, UNKNOWNS - 1) along which the unknowns move while the sum of the scales with `weights` stays.
    called : (N, J) of `Seen`; J is the number of kinds, or 0. class_called : (K + 3, J) what is called so of each class
        in general, as the parameters of Dirichlet distributions.
    """

    gap: np.ndarray
    inverse: np.ndarray
    turn: np.ndarray
    prior: np.ndarray
    shares: np.ndarray
    larger: float
    place: Sequence[Places]
    weights: np.ndarray
    basis: np.ndarray
    called: np.ndarray
    class_called: np.ndarray

    @classmethod
    def of(cls, seen: Seen, mix: Mix, drawing: Drawing, confusion: Confusion | None) -> _Problem:
        """That of `fit`."""
        log_size, classes, weights = seen.log_size, mix.classes, mix.weights
        every = [*classes, LARGER, LORRIES, _hidden(classes)]
        means = np.array([drawing.log_mean(c) for c in every])
        # A box's noise is a share of what its vehicle should measure, not of what it does measure: else boxes that came
        # out large by chance would count for more. The scale for it need only be rough.
        rough = np.median(np.median(means[: len(classes)], axis=0) - log_size, axis=0)
        noise = (seen.noise / np.exp(means - rough)[:, None]) ** 2
        spread = np.array([drawing.covariance(c.log_covariance) for c in every])[:, None] + noise[..., None] * np.eye(2)
        tie = np.linalg.inv(mix.systematic)  # holds the two scales to one another, and leaves what they share free
        tie = tie - np.outer(tie.sum(0), tie.sum(0)) / tie.sum()
        turn = np.zeros((len(every), 2, UNKNOWNS))
        turn[:, :, :2] = np.eye(2)
        turn[len(classes), :, 2:4] = -np.eye(2)
        turn[:, :, 4] = [-drawing.slope(c) for c in every]
        prior = np.zeros((UNKNOWNS, UNKNOWNS))
        prior[:2, :2], prior[4, 4] = tie, 1.0
        prior[2:4, 2:4] = np.linalg.inv(drawing.covariance(LARGER.log_covariance))
        basis = np.zeros((UNKNOWNS, UNKNOWNS - 1))
        basis[:2, 0] = weights[1], -weights[0]
        basis[2:, 1:] = np.eye(UNKNOWNS - 2)
        return cls(
            # Noise lowers a logarithm's mean by half its variance.
            gap=(means[:, None] - 0.5 * noise) - log_size,
            inverse=np.linalg.inv(spread),
            turn=turn,
            prior=prior,
            shares=np.array([c.weight for c in classes]) / sum(c.weight for c in classes),
            larger=left_out(classes),
            place=mix.place,
            weights=weights,
            basis=basis,
            called=seen.called,
            class_called=confusion.called(every) if confusion and seen.called.size else np.empty((len(every), 0)),
        )

    @property
    def middle(self) -> float:
        """The scale by the votes' median, were all ordinary."""
        return float(np.median(self.gap[: len(self.shares)].mean(0) @ self.weights))

    def of_votes(self, number: int) -> _Problem:
        """The same for `number` of the votes, if there are more."""
        if number >= self.gap.shape[1]:
            return self
        some = np.linspace(0, self.gap.shape[1] - 1, number).astype(int)
        return replace(self, gap=self.gap[:, some], inverse=self.inverse[:, some], called=self.called[some])

    def start(self, grid: np.ndarray) -> _Solved:
        """The scales of `grid` (V,), each once for each of `place`, with the country's mix."""
        likely = np.repeat([kind.probability for kind in self.place], len(grid))
        unknown = np.zeros((len(likely), UNKNOWNS))
        unknown[:, :2] = np.tile(grid, len(self.place))[:, None]
        lorries, hidden = (LORRIES_SHARE, LORRIES_VEHICLES), (HIDDEN_SHARE, HIDDEN_VEHICLES)
        every = []
        for kind in self.place:
            own = kind.vehicles * kind.shares(self.shares)
            beside = [(self.larger, kind.left_out), lorries, hidden, (OUTLIER_SHARE, OUTLIER_BOXES)]
            levels = [[boxes * (1 - share), boxes * share] for share, boxes in beside]
            every.append([*own, *np.ravel(levels), *self.class_called.ravel()])
        prior = np.repeat(every, len(grid), axis=0)
        return _Solved(prior, np.log(likely), prior, unknown, np.log(likely))

    @cached_property
    def table(self) -> np.ndarray:
        """(K + 3, N, 7 + J) of each vote: the log density of a class is linear in these, the coefficients (`_along`)
        are quadratic in how far the unknowns move the class. Of the first six Newton's steps are made, the next J say
        what the vote is called."""
        i00, i01, i11 = self.inverse[..., 0, 0], self.inverse[..., 0, 1], self.inverse[..., 1, 1]
        g0, g1 = self.gap[..., 0], self.gap[..., 1]
        b0, b1 = i00 * g0 + i01 * g1, i01 * g0 + i11 * g1
        height = 0.5 * np.log(i00 * i11 - i01**2) - np.log(2 * np.pi) - 0.5 * (g0 * b0 + g1 * b1)
        called = np.broadcast_to(self.called, (*g0.shape, self.called.shape[1]))
        return np.concatenate(
            [np.stack([i00, i01, i11, b0, b1, np.ones_like(g0)], -1), called, height[..., None]], axis=-1
        )

    def along(self, unknown: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`_along` for this fleet."""
        return _along(self.turn[None].repeat(len(unknown), 0), unknown, counts)

    def members(self, solved: _Solved, weight: np.ndarray) -> np.ndarray:
        """(K + 1, N) probability of the fleet's classes and of LARGER over all hypotheses `solved`, which have `weight`
        (V,)."""
        count, along = self.gap.shape[1], self.along(solved.unknown, solved.counts)
        parts = np.array_split(self.table, -(-count // MOST_VOTES), axis=1)
        own = len(self.shares) + 1
        return np.hstack([np.einsum("v,kvn->kn", weight, _members(part, *along)[0][:own]) for part in parts])

    def fits(self, solved: _Solved) -> Fits:
        """The posterior over the grid's scales, and what the votes leave uncertain at the likeliest."""
        heard = self.of_votes(MOST_VOTES)
        best = float(solved.log_probability.max())
        evidence = best + float(np.log(np.exp(solved.log_probability - best).sum() * FINE))
        each = _normalised(solved.log_probability + heard._lucks(solved))
        weight = each.mean(0)
        means = each @ (solved.unknown[:, :2] @ self.weights)
        likeliest = int(np.argmax(solved.log_probability))
        covariance, known = heard._covariances(solved, likeliest)
        return Fits(
            weight=weight,
            log_evidence=evidence,
            log_scale=solved.unknown[:, :2],
            covariance=known,
            drawing=covariance - known,
            chance=BAG * float(means.var()),
            member=self.members(solved, weight),
        )

    def _lucks(self, solved: _Solved) -> np.ndarray:
        """(BAGS, V) by how much bags of votes, drawn with replacement, move the log probabilities of hypotheses.

        To first order no hypothesis need be fitted anew, since each is where its probability is greatest: a vote that
        is drawn twice adds its log density once more. The sum over a bag is taken to be normal: so the bags do not
        depend on the order of the votes, nor their cost on the number.
        """
        density = np.log(_members(self.table, *self.along(solved.unknown, solved.counts))[1])
        apart = density - density.mean(1, keepdims=True)
        count = apart.shape[1]
        told = min(1.0, SHAPE_VEHICLES / count)
        variance, axes = np.linalg.eigh(apart @ apart.T * told**2 / BAG)
        variance, axes = variance[-BAG_AXES:][::-1], axes[:, -BAG_AXES:][:, ::-1]
        towards = np.where(solved.unknown[:, :2].sum(1) @ (axes - axes.mean(0)) < 0, -1, 1)
        drawn = np.random.default_rng(0).standard_normal((BAG_AXES, BAGS // 2))[: len(variance)].T
        moved = drawn @ (axes * towards * np.sqrt(np.maximum(variance, 0))).T
        return np.vstack([moved, -moved])

    def _covariances(self, solved: _Solved, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Two (2, 2) of the scales by length and width at the `k`-th: with every unknown, and with the drawing's share
        known.

        The information of votes that wore their classes, with the unknowns' priors, less what the guessing loses: the
        covariance of each vote's score over the classes that it may be of (Louis 1982); the shares are unknown, too.
        """
        (counts,), *_ = _levels(solved.counts[k : k + 1], len(self.shares))
        along = self.along(solved.unknown[k : k + 1], solved.counts[k : k + 1])
        p, share = _members(self.table, *along)[0][:, 0], counts / counts.sum()
        residual = np.einsum("kiu,u->ki", self.turn, solved.unknown[k])[:, None] - self.gap
        pull = -np.einsum("knij,knj->kni", self.inverse, residual)
        many = len(share)
        score = np.zeros((*p.shape, UNKNOWNS + many))
        score[..., :UNKNOWNS] = np.einsum("kiu,kni->knu", self.turn, pull)
        score[:many, :, UNKNOWNS:] = (np.eye(many) - share)[:, None]
        expected = np.einsum("kn,knd->nd", p, score)
        lost = np.tensordot(p[..., None] * score, score, ((0, 1), (0, 1))) - expected.T @ expected
        whole = np.zeros_like(lost)
        information = np.einsum("kn,knij->kij", p, self.inverse)
        whole[:UNKNOWNS, :UNKNOWNS] = np.einsum("kiu,kij,kjw->uw", self.turn, information, self.turn) + self.prior
        whole[UNKNOWNS:, UNKNOWNS:] = counts.sum() * (np.diag(share) - np.outer(share, share)) + 1e-6 * np.eye(many)
        without = np.delete(np.arange(len(whole)), UNKNOWNS - 1)
        return _of_scales(whole, lost), _of_scales(whole[np.ix_(without, without)], lost[np.ix_(without, without)])


def _solved(problems: Sequence[_Problem], starts: Sequence[_Solved], steps: int) -> list[_Solved]:
    """What stands there for each hypothesis of each of `starts`, from where that is.

    `problems` are of the same votes and of as many classes. They are solved in step, and each hypothesis only until it
    is still, or so unlikely that it will not become possible.
    """
    owner = np.repeat(np.arange(len(problems)), [len(start.counts) for start in starts])
    start = _Solved(*(np.concatenate([getattr(s, field.name) for s in starts]) for field in fields(_Solved)))
    unknown, counts = start.unknown.copy(), start.counts.copy()
    turns, priors, bases = (np.array([getattr(p, name) for p in problems]) for name in ("turn", "prior", "basis"))
    bends = np.einsum("ckiu,ckjw->ckijuw", turns, turns).reshape(len(problems), -1, UNKNOWNS**2)
    classes, count = len(problems[0].shares), problems[0].gap.shape[1]
    told = min(1.0, SHAPE_VEHICLES / count)
    log_density, inside = np.empty(len(owner)), np.empty((len(owner), UNKNOWNS - 1, UNKNOWNS - 1))
    log_probability = np.empty(len(owner))
    hopeful = np.ones(len(owner), bool)
    going = np.arange(len(owner))

    def judge(which: np.ndarray) -> None:
        after, before, prior = counts[which], start.prior[which], priors[owner[which]]
        found = log_density[which] - 0.5 * np.einsum("vi,vij,vj->v", unknown[which], prior, unknown[which])
        found = told * found + start.log_prior[which]
        for one, other in zip(_levels(after, classes), _levels(before, classes), strict=True):
            found -= _divergence(one, other)
        # Laplace's approximation of the integral over what else is unknown.
        free = bases.transpose(0, 2, 1) @ priors @ bases
        information = told * (inside[which] - free[owner[which]]) + free[owner[which]]
        log_probability[which] = found + 0.5 * (
            np.linalg.slogdet(free)[1][owner[which]] - np.linalg.slogdet(information)[1]
        )

    for step in range(1, steps + 1):
        mine, prior, basis = owner[going], priors[owner[going]], bases[owner[going]]
        turn, here = turns[mine], unknown[going]
        along, none = _along(turn, here, counts[going])
        sums = np.empty((len(turns[0]), len(going), 6 + problems[0].called.shape[1]))
        system = np.empty((len(going), UNKNOWNS**2))
        for c in np.unique(mine):
            rows = slice(*np.searchsorted(mine, (c, c + 1)))
            p, density = _members(problems[c].table, along[:, rows], none[rows])
            sums[:, rows] = p @ problems[c].table[..., :-1]
            log_density[going[rows]] = np.log(density).sum(1)
            curved = sums[:, rows, [0, 1, 1, 2]].transpose(1, 0, 2).reshape(len(p[0]), -1)
            system[rows] = curved @ bends[c]
        a00, a01, a11, b0, b1, found = np.moveaxis(sums[..., :6], -1, 0)  # (K + 3, V) each
        called = sums[..., 6:].transpose(1, 0, 2).reshape(len(going), -1)
        m0, m1 = along[..., 3], along[..., 4]
        pulled = np.stack([b0 - a00 * m0 - a01 * m1, b1 - a01 * m0 - a11 * m1])  # (2, K + 3, V) upwards in scale
        right = np.einsum("vkiu,ikv->vu", turn, pulled) - np.einsum("vu,vuw->vw", here, prior)
        whole = system.reshape(-1, UNKNOWNS, UNKNOWNS) + prior
        inside[going] = basis.transpose(0, 2, 1) @ whole @ basis
        free = np.linalg.solve(inside[going], np.einsum("vu,vuw->vw", right, basis)[..., None])
        moved = (basis @ free)[..., 0]
        within = found.cumsum(0)[classes - 1 :]  # of a level with all levels inside it, (BESIDE_FLEET + 1, V)
        beside = [*found[classes:], count - within[-1]]
        after = told * np.column_stack([*found[:classes], *chain(*zip(within, beside, strict=True)), called])
        after += start.prior[going]
        change = np.maximum(np.abs(moved[:, :4]).max(1), np.abs(after - counts[going]).max(1) / count)
        counts[going], unknown[going] = after, here + moved
        left = change > STILL
        if step in GIVEN_UP:
            judge(going)
            best = np.full(len(problems), -np.inf)
            np.maximum.at(best, mine, log_probability[going])
            hopeful[going] = log_probability[going] > best[mine] - GIVEN_UP[step]
            left &= hopeful[going]
        going = going[left]
        if not len(going):
            break
    judge(np.flatnonzero(hopeful))
    every = _Solved(start.prior, start.log_prior, counts, unknown, log_probability)
    return [every.where(owner == c) for c in range(len(problems))]


def _along(turn: np.ndarray, unknown: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K + 3, V, 7 + J) coefficients of `_Problem.table` for hypotheses of `unknown` (V, UNKNOWNS) and `counts` (V, C),
    with `turn` (V, K + 3, 2, UNKNOWNS) of the fleet of each; and (V,) the density of outliers."""
    m0, m1 = np.einsum("vkiu,vu->ikv", turn, unknown)
    log_share, *rest = (
        (digamma(level) - digamma(level.sum(1, keepdims=True))).T
        for level in _levels(counts, turn.shape[1] - BESIDE_FLEET)
    )
    beside, called = rest[: BESIDE_FLEET + 1], rest[BESIDE_FLEET + 1 :]
    for within, other in beside:
        log_share = np.vstack([log_share + within, other])
    log_share, none = log_share[:-1], log_share[-1]
    along = [-0.5 * m0**2, -m0 * m1, -0.5 * m1**2, m0, m1, log_share, np.ones_like(m0)]
    if called:  # against what outliers are called
        along[6:6] = np.array(called).swapaxes(0, 1) - np.log(OUTLIER_CALLED)
    return np.stack(along, -1), OUTLIER_DENSITY * np.exp(none)


def _members(table: np.ndarray, along: np.ndarray, none: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K + 3, V, N) probability of each class for each hypothesis and vote of a `table`, and (V, N) density of the
    vote; `along` and `none` are those of `_along`."""
    p = along @ table.transpose(0, 2, 1)
    np.exp(p, out=p)
    total = p.sum(0)
    total += none[:, None]
    p /= total
    return p, total


def _levels(counts: np.ndarray, many: int) -> tuple[np.ndarray, ...]:
    """Of `counts` (V, C): (V, K) of the fleet's classes, which are so `many`; for LARGER, LORRIES, hidden vehicles and
    outliers in turn (V, 2) of all that is before it together, and of it; and if kinds are seen (V, J) for each of the
    K + 3 classes, of what it is called. A place that is odd in one is not therefore odd in another."""
    ends = np.cumsum([many, *[2] * (BESIDE_FLEET + 1)])
    *levels, called = np.split(counts, ends, axis=1)
    return *levels, *(np.split(called, many + BESIDE_FLEET, axis=1) if called.size else [])


def _hidden(classes: Sequence[Class]) -> Class:
    """What is seen of vehicles of `classes` that are partly hidden."""
    weight = np.array([c.weight for c in classes]) / sum(c.weight for c in classes)
    mean, kinds = weight @ [c.mean for c in classes], weight @ [c.kinds for c in classes]
    size, sd = (np.array([*share, 1.0]) * mean for share in (HIDDEN_SIZE, HIDDEN_SD))
    return Class("partly hidden", 1.0, size, sd, 0.0, np.zeros(3), kinds)


def _normalised(log_weight: np.ndarray) -> np.ndarray:
    """(B, V) weights whose rows sum to one."""
    weight = np.exp(log_weight - log_weight.max(1, keepdims=True))
    return weight / weight.sum(1, keepdims=True)


def left_out(classes: Sequence[Class]) -> float:
    """Share of LARGER beside a fleet of `classes`, beyond its own."""
    own = sum(c.weight * ndtr((c.mean[0] - LONG) / c.sd[0]) for c in classes) / sum(c.weight for c in classes)
    return float(max(LEFT_OUT - own, LEFT_OUT_AT_LEAST))


def _divergence(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """(V,) Kullback-Leibler divergence between Dirichlet distributions `after` and `before` (V, K) [nats]."""
    total = after.sum(1)
    return (
        gammaln(total)
        - gammaln(after).sum(1)
        - gammaln(before.sum(1))
        + gammaln(before).sum(1)
        + ((after - before) * (digamma(after) - digamma(total)[:, None])).sum(1)
    )


def _of_scales(whole: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """(2, 2) of the first two unknowns, whose information is `whole` less what is `lost`.

    In units in which all is known to one; a guess may lose most of what there is to know, but not more.
    """
    root = np.linalg.cholesky(np.linalg.inv(whole))
    kept, axes = np.linalg.eigh(np.eye(len(whole)) - root.T @ lost @ root)
    half = root[:2] @ axes / np.sqrt(np.maximum(kept, LEAST_KEPT))
    return half @ half.T
