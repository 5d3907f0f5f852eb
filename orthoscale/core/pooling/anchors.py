"""The anchors of one source as evidence: one piece for each kind.

Anchors of one kind are not independent: the same painter measured them, the same picture distorts them, and the same
structure deceives the finder. So of the variance of each fit the share `SHARED` remains, however many there are, and so
does all of the variance of the standard; and the kind as a whole is a false find with the probability of its most
certain anchor. A kind may support several scales, one for each standard and each group of anchors that agree. Each is
weighted by its standard's prior and by the square of the number of anchors that support it, since false finds seldom
agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..anchors import BAYS, AnchorVote, Standard, holding
from ..evidence import Evidence
from .posterior import Posterior

# Share of an anchor's variance that all of its kind have in common. Tennis courts on 100 pictures of exact scale err by
# 0.40 % each (one sigma) and by 0.29 % together (90 % within 0.47 %), half of the variance: `docs/anchors.md`.
SHARED = 0.5
FOREIGN = 0.05  # of a standard's prior that is left where it is another country's: what is built abroad is copied
NO_RULE = 0.2  # share of bays and lane lines that follow no rule of the tables, or of rules that these lack; judged
OF_NO_STANDARD = 0.02  # probability that an anchor, however sure that it is one, is of no standard of its kind
LEAST_FIT = 2e-4  # of any anchor's fit
MEAN_STEPS = 30  # of a mean of the anchors that mean one scale; it settles in about five
SETTLED_LOG = 1e-7
ONE_SCALE = 0.5  # sigmas within which two such means are one
LEAST_WEIGHT = 1e-4  # of a scale that a kind may mean, below which it is not carried on


@dataclass(frozen=True)
class _Reading:
    """What the anchors that may be of one standard say (N): log scale, variance of the fit, probability to be one and
    of that standard, and density where they are none; `rule` is the variance of the standard's things."""

    log_scale: np.ndarray
    fit: np.ndarray
    probability: np.ndarray
    mistaken: np.ndarray
    rule: float

    @property
    def own(self) -> np.ndarray:
        """(N,) variance by which each strays from others of its kind."""
        return (1 - SHARED) * self.fit + self.rule

    def members(self, log_scale: float) -> np.ndarray:
        """(N,) probability of each to mean `log_scale`, if the kind does."""
        density = np.exp(-0.5 * (self.log_scale - log_scale) ** 2 / self.own) / np.sqrt(2 * np.pi * self.own)
        likely = self.probability * density
        return likely / (likely + self.mistaken)

    def fit_of_mean(self, member: np.ndarray) -> float:
        """Variance that the fits leave in the mean of those that are each a `member` (N,) with that probability: what
        they share stays, what is each one's own falls with their number. A lone anchor has all of its own."""
        precision = 1 / self.own
        alone = precision / (member @ precision)  # of each the weight in the mean, if it is a member
        shared = float(member * alone @ np.sqrt(self.fit)) ** 2
        return SHARED * shared + (1 - SHARED) * float(member * alone * np.minimum(alone, 1) @ self.fit)

    def means(self) -> list[float]:
        """The scales about which anchors agree: means in which each counts by its probability to belong there
        (redescending M-estimates), from every anchor's own on."""
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
    """What `votes` say, a piece of evidence for each kind, in the order in which the kinds come. Those that only tell
    the country (`Anchor.unlike`) are left out.

    country : ISO code of two letters, empty where it is not known; standards of other countries are less likely there.
    Bays are the country's alone, or those of everywhere.
    """
    votes = [
        vote.of(tuple(holding(vote.anchor.standards, country))) if vote.anchor.kind == BAYS else vote
        for vote in votes
        if not vote.anchor.unlike
    ]
    kinds = dict.fromkeys(vote.anchor.kind for vote in votes)
    return [_of_kind(kind, _measuring([v for v in votes if v.anchor.kind == kind]), country) for kind in kinds]


def tells_country(vote: AnchorVote) -> bool:
    """Whether it tells the country, where that is not known, and is no measure of the scale then. Bays are made for a
    country's cars, so a wrong guess of the country makes bays and vehicles wrong together; of lane lines each country
    has rules of its own. How large they are in cars suits some countries and not others."""
    bays = vote.anchor.kind == BAYS and any(standard.countries for standard in vote.anchor.standards)
    return bays or bool(vote.anchor.unlike)


def country_agreement(votes: Sequence[AnchorVote], vehicles: Mapping[str, Posterior]) -> dict[str, float]:
    """How likely it is, in each country, that `votes` and the vehicles are of one scale, but for a common factor.

    votes : those that tell the country; the priors of their standards are shares of those of a country. vehicles : the
    scale by them, were they of that country, by code. A country of which no standard is known may have any other's.
    """
    kinds = dict.fromkeys(vote.anchor.kind for vote in votes)
    each = [_measuring([vote for vote in votes if vote.anchor.kind == kind]) for kind in kinds]
    out = {}
    for country, scale in vehicles.items():
        out[country] = 1.0
        for these in each:  # each with what the vehicles and the kinds before it say together
            factor, scale = _agreement(these, country, scale)
            out[country] *= factor
    return out


def _agreement(votes: Sequence[AnchorVote], country: str, scale: Posterior) -> tuple[float, Posterior]:
    """The same of `votes` of one kind, in one country; and the `scale` there when they are known, too."""
    own = [holding(vote.anchor.standards, country) for vote in votes]
    like = np.array([_likeness(vote, these, country) for vote, these in zip(votes, own, strict=True)])
    # Where none can be of that country its standards do not matter, for `like` is 0.
    some = like > 0 if like.any() else np.ones(len(like), bool)
    there = [vote.of(tuple(these)) for vote, these, keep in zip(votes, own, some, strict=True) if keep]
    (found,) = evidence_of(there, country)
    doubt = 1 - (1 - found.doubt) * (1 - NO_RULE)
    known = found.posterior, doubt, found.window, float(like.mean())
    return scale.agreement(*known), scale.times_doubted(*known)


def _likeness(vote: AnchorVote, own: Sequence[Standard], country: str) -> float:
    """Probability that what follows a standard of `country` follows one of those, `own`, that `vote` may be of."""
    if country in vote.anchor.unlike:
        return 0.0
    likely = sum(standard.prior for standard in own)
    if any(country in standard.countries or not standard.countries for standard in own):
        return min(likely, 1.0)
    return likely / len({code for standard in own for code in standard.countries} | set(vote.anchor.unlike))


def _measuring(votes: Sequence[AnchorVote]) -> list[AnchorVote]:
    """Of `votes` of one kind those that were found by their lines, if any were: what was only seen as boxes measures
    the same things worse."""
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
    rows = f", {repeated} in {'rows' if count > 1 else 'a row'}" if repeated > count else ""
    return f"{many} ({standard.name}, {standard.metres:.4g} m{rows})"
