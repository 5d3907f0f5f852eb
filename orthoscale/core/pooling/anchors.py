"""The anchors of one source as evidence: one piece for each kind.

Anchors of one kind are not independent: the same painter measured them, the same picture distorts them, and the same
structure deceives the finder. So however many there are, the share `SHARED` of the variance of each fit remains, and
all of the variance of the standard; and the kind as a whole is a false find with the probability of its most certain
anchor. A kind may support several scales, one for each standard and each group of anchors that agree. Each is weighted
by its standard's prior and by the square of the number of anchors that support it, since false finds seldom agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..anchors import BAYS, AnchorVote, Standard, holding, size_in_words
from ..evidence import Evidence
from .posterior import Posterior

# Share of a fit's variance that all anchors of a kind have in common. Tennis courts on 100 pictures of exact scale err
# by 0.40 % each (one sigma) and by 0.29 % together (90 % within 0.47 %), half of the variance: `docs/anchors.md`.
SHARED = 0.5
FOREIGN = 0.05  # factor on the prior of a standard of other countries: what is built abroad is copied
NO_RULE = 0.2  # share of bays and lane lines that follow no rule of the tables; judged
OF_NO_STANDARD = 0.02  # probability that a true anchor, however certain its find, follows no standard of its kind
LEAST_FIT = 2e-4  # least relative one sigma of any anchor's fit
MEAN_STEPS = 30  # iterations of a mean of the anchors that agree on one scale; it settles in about five
SETTLED_LOG = 1e-7
ONE_SCALE = 0.5  # sigmas within which two such means are one
LEAST_WEIGHT = 1e-4  # least weight of a scale that a kind may mean; scales below are dropped


@dataclass(frozen=True)
class _Reading:
    """The N anchors that may follow one standard: log scale, variance of the fit, probability that it is an anchor of
    that standard, and density if it is not. `rule` is the variance of objects built to the standard."""

    log_scale: np.ndarray
    fit: np.ndarray
    probability: np.ndarray
    mistaken: np.ndarray
    rule: float

    @property
    def own(self) -> np.ndarray:
        """(N,) variance of each that it does not share with the others of its kind."""
        return (1 - SHARED) * self.fit + self.rule

    def members(self, log_scale: float) -> np.ndarray:
        """(N,) probability that each anchor means `log_scale`, if its kind does."""
        density = np.exp(-0.5 * (self.log_scale - log_scale) ** 2 / self.own) / np.sqrt(2 * np.pi * self.own)
        likely = self.probability * density
        return likely / (likely + self.mistaken)

    def fit_of_mean(self, member: np.ndarray) -> float:
        """Variance of the mean from the fits, where `member` (N,) is the probability that each anchor belongs to it:
        the shared part stays, the part of each one's own falls with their number. A lone anchor has all of its own."""
        precision = 1 / self.own
        alone = precision / (member @ precision)  # weight of each in the mean, if it is a member
        shared = float(member * alone @ np.sqrt(self.fit)) ** 2
        return SHARED * shared + (1 - SHARED) * float(member * alone * np.minimum(alone, 1) @ self.fit)

    def means(self) -> list[float]:
        """The log scales on which anchors agree: means in which each counts by its probability of belonging there
        (redescending M-estimates), started from every anchor's own scale."""
        apart = ONE_SCALE * float(np.sqrt(self.own.min()))
        found: list[float] = []
        for mean in self.log_scale[np.unique(np.round(self.log_scale / apart), return_index=True)[1]].tolist():
            for _ in range(MEAN_STEPS):
                weight = self.members(mean) / self.own
                before, mean = mean, float(weight @ self.log_scale / weight.sum())
                if abs(mean - before) < SETTLED_LOG:
                    break
            if all(abs(mean - other) > apart for other in found):
                found.append(mean)
        return found


def evidence_of(votes: Sequence[AnchorVote], country: str = "") -> list[Evidence]:
    """The evidence of `votes`, one piece for each kind, in the order in which the kinds come. Votes that only tell the
    country (`Anchor.unlike`) are left out.

    country : ISO code of two letters, empty where it is not known; standards of other countries are less likely there.
    Parking bays follow only the country's standards or, if it has none, those that apply everywhere.
    """
    votes = [
        vote.of(tuple(holding(vote.anchor.standards, country))) if vote.anchor.kind == BAYS else vote
        for vote in votes
        if not vote.anchor.unlike
    ]
    kinds = dict.fromkeys(vote.anchor.kind for vote in votes)
    return [_of_kind(kind, _measuring([v for v in votes if v.anchor.kind == kind]), country) for kind in kinds]


def tells_country(vote: AnchorVote) -> bool:
    """Whether `vote` is evidence on the country and not on the scale, if the country is not known. Bays are made for a
    country's cars, so a wrong guess of the country makes bays and vehicles wrong together; for lane lines each country
    has rules of its own. Their size relative to cars suits some countries and not others."""
    bays = vote.anchor.kind == BAYS and any(standard.countries for standard in vote.anchor.standards)
    return bays or bool(vote.anchor.unlike)


def country_agreement(votes: Sequence[AnchorVote], vehicles: Mapping[str, Posterior]) -> dict[str, float]:
    """The likelihood of each country: that `votes` and the vehicles agree on one scale there, up to a common factor.

    votes : those that tell the country; the priors of their standards are shares of a country's anchors. vehicles : by
    code of the country, the scale that the vehicles give if they are from there. A country without known standards may
    follow those of any other.
    """
    kinds = dict.fromkeys(vote.anchor.kind for vote in votes)
    each = [_measuring([vote for vote in votes if vote.anchor.kind == kind]) for kind in kinds]
    out = {}
    for country, scale in vehicles.items():
        out[country] = 1.0
        for these in each:  # each kind is compared with the vehicles and the kinds before it together
            factor, scale = _agreement(these, country, scale)
            out[country] *= factor
    return out


def _agreement(votes: Sequence[AnchorVote], country: str, scale: Posterior) -> tuple[float, Posterior]:
    """That likelihood for `votes` of one kind in one country; and the `scale` there, updated with them."""
    own = [holding(vote.anchor.standards, country) for vote in votes]
    like = np.array([_likeness(vote, these, country) for vote, these in zip(votes, own, strict=True)])
    # If none can be of that country, its standards do not matter, for `like` is 0.
    some = like > 0 if like.any() else np.ones(len(like), bool)
    there = [vote.of(tuple(these)) for vote, these, keep in zip(votes, own, some, strict=True) if keep]
    (found,) = evidence_of(there, country)
    doubt = 1 - (1 - found.doubt) * (1 - NO_RULE)
    known = found.posterior, doubt, found.window, float(like.mean())
    return scale.agreement(*known), scale.times_doubted(*known)


def _likeness(vote: AnchorVote, own: Sequence[Standard], country: str) -> float:
    """Probability that an anchor built to a standard of `country` follows one of `own`, those that `vote` may follow
    there."""
    if country in vote.anchor.unlike:
        return 0.0
    likely = sum(standard.prior for standard in own)
    if any(country in standard.countries or not standard.countries for standard in own):
        return min(likely, 1.0)
    return likely / len({code for standard in own for code in standard.countries} | set(vote.anchor.unlike))


def _measuring(votes: Sequence[AnchorVote]) -> list[AnchorVote]:
    """Of `votes` of one kind those that were found by their lines, if any were: those that were only seen as boxes
    measure the same objects worse."""
    return [vote for vote in votes if len(vote.anchor.lines)] or list(votes)


def _of_kind(kind: str, votes: Sequence[AnchorVote], country: str) -> Evidence:
    rows, supporters = [], []
    kind_sd, common = max(vote.kind_sd for vote in votes), max(vote.shared_sd for vote in votes)
    for standard in dict.fromkeys(standard for vote in votes for standard in vote.anchor.standards):
        these = [k for k, vote in enumerate(votes) if standard in vote.anchor.standards]
        reading = _reading([votes[k] for k in these], standard, country)
        for mean in reading.means():
            member = reading.members(mean)
            variance = reading.fit_of_mean(member) + reading.rule + kind_sd**2
            rows.append((float(member @ reading.probability * member.sum()), mean, np.sqrt(variance), standard))
            supporters.append([k for k, share in zip(these, member, strict=True) if share > 0.5] or these)
    columns = list(zip(*rows, strict=True))
    weight, means, sds = (np.array(column, float) for column in columns[:3])
    weight = weight / weight.sum()
    those = [votes[k] for k in supporters[int(np.argmax(weight))]]
    words = [_in_words(kind, [votes[k] for k in s], row[3]) for s, row in zip(supporters, rows, strict=True)]
    doubt, window = min(vote.anchor.false for vote in those), float(np.median([vote.window for vote in those]))
    found = Evidence.mixed(kind, Posterior(weight, means, sds), words, doubt, window, common)
    likely = weight > LEAST_WEIGHT
    documented = all(row[3].documented for row, keep in zip(rows, likely, strict=True) if keep)
    return replace(found.only(likely), documented=documented)


def _reading(votes: Sequence[AnchorVote], standard: Standard, country: str) -> _Reading:
    priors = [{s: _prior(s, country) for s in vote.anchor.standards} for vote in votes]
    share = np.array([prior[standard] / sum(prior.values()) for prior in priors])
    false = np.array([vote.anchor.false for vote in votes])
    return _Reading(
        log_scale=np.log(standard.metres) - np.log([vote.units for vote in votes]),
        fit=np.maximum([vote.relative_sd for vote in votes], LEAST_FIT) ** 2,
        probability=(1 - false) * share,
        mistaken=(false + OF_NO_STANDARD * (1 - false)) / np.array([vote.window for vote in votes]),
        rule=standard.relative_sd**2,
    )


def _prior(standard: Standard, country: str) -> float:
    foreign = country and standard.countries and country not in standard.countries
    return standard.prior * (FOREIGN if foreign else 1.0)


def _in_words(kind: str, votes: Sequence[AnchorVote], standard: Standard) -> str:
    """For people: what was found, and what it is taken for."""
    count, repeated = len(votes), sum(vote.anchor.count for vote in votes)
    many = f"{count} x {kind}" if count > 1 else kind
    rows = f"{repeated} in {'rows' if count > 1 else 'a row'}" if repeated > count else ""
    return f"{many} ({size_in_words(standard.name, standard.metres, rows)})"
