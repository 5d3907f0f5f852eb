"""Many vehicles, one scale: robust pooling in log space, with an interval and the parts of its uncertainty.

In logarithms every vehicle reads ``log size = log fleet size - log scale + noise``, for length and for width. `mixture`
finds which votes are vehicles of which class and gives two scales, one from lengths and one from widths, for each mix
of vehicles that may be there. Their joint covariance is

    covariance = votes and their classes  +  uncertainty of the fleet's mean
                 + uncertainty of the detector's margin  + uncertainty of the geometry

and the answer is their best linear combination (generalised least squares). So lengths dominate where pixels are coarse
and widths where they are fine, without a rule for it. Only the first term shrinks with more vehicles. `one_model` adds
what follows if all vehicles are of a single model.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...errors import TooLittleEvidence
from ..anchors import AnchorVote
from ..evidence import Evidence
from ..fleet import Fleet
from ..remarks import INFO, Remark
from ..ruler import Ruler
from ..scale import Scale
from ..verdicts import CHECK_LIMIT, reasons, remark_on_shape, verdict
from ..votes import Votes
from .anchors import country_agreement, evidence_of, tells_country
from .by_kind import country_likelihoods
from .combining import combined
from .observed import Seen
from .of_fleets import FEW, OfVehicles, of_fleets
from .one_model import OneModel, of_one_model
from .posterior import Posterior
from .usable import MIN_VEHICLES, usable

LIKELY_ONE = 0.5  # probability above which a place of one model is reported
LIKELY = 0.01  # probability below which a fleet is not reported
MOVED_BY = 7  # number of the likeliest fleets that are fitted to all votes
# How far the evidence of shapes on the country is believed: the power of its likelihood. In simulation shapes tell
# Japan from Germany. On 12 orthophotos of six countries the boxes of version 5 made the true country the less likely
# the more they were believed (mean log probability -7.0 if fully, -4.3 by a tenth, -4.2 if not at all:
# benchmarks/country_from_shapes.py), for boxes are too wide or too long together, as vehicles of another country are.
# The kinds are fully believed (`by_kind`); the little that they add to the shapes' tenth is counted twice.
SHAPES_TOLD = 0.1


def pool(
    votes: Votes,
    fleet: Fleet,
    ruler: Ruler,
    unit: str,
    of_geometry: np.ndarray | None = None,
    evidence: Sequence[Evidence] = (),
    anchors: Sequence[AnchorVote] = (),
    country: str = "",
) -> Scale:
    """The scale that `votes` give, for vehicles of `fleet`, measured with `ruler`.

    `of_geometry` (2, 2) is the relative covariance of lengths and widths that comes from the source's geometry (ground
    height, effective height), shared by all votes. `evidence` is other evidence on the scale, `anchors` the objects of
    standard size that were found. `country` decides between their standards (`evidence_of`); if it is not known, some
    anchors help to decide between the candidates of `fleet` (`tells_country`).
    If `fleet` has candidates, each is tried, and weighted by its probability given the vehicles and anchors.
    Raises TooLittleEvidence for fewer than MIN_VEHICLES usable votes, or boxes shaped like no vehicles.
    """
    index, seen, known = usable(votes, ruler, of_geometry)
    unknown = bool(fleet.candidates) and not country
    telling = [vote for vote in anchors if tells_country(vote)] if unknown else []
    best, fleets = _of_candidates(seen, fleet, known, telling)
    best = _perhaps_of_one_model(best, of_one_model(seen, fleet, known))
    if best.inlier.sum() < MIN_VEHICLES:
        raise TooLittleEvidence(
            f"{len(votes)} boxes, but only {int(best.inlier.sum())} fit vehicles at one scale; "
            f"{MIN_VEHICLES} are needed"
        )
    vehicles, parts = _widened(best)
    used = np.zeros(len(votes), bool)
    used[index] = best.inlier
    mean = seen.log_size[best.inlier].mean(0)
    measuring = [vote for vote in anchors if not tells_country(vote)] if unknown else anchors
    together = combined(vehicles, parts, (*evidence, *evidence_of(measuring, country)), unit)
    value, low, high = together.summary
    judged = together.support.judged(together.posterior.spread)
    return Scale(
        value=value,
        unit=unit,
        interval90=(low, high),
        parts=together.parts,
        checks=_checks(best, mean),
        weights=(float(best.weights[0]), float(best.weights[1])),
        tension=best.tension,
        conflict=together.conflict,
        fleet=fleet.code,
        verdict=verdict(judged, best.tension > CHECK_LIMIT, together.conflict > 0, together.support.doubted),
        used=used,
        reasons=reasons(used, index, votes.fleeting, seen.log_size, mean),
        remarks=(*together.remarks, *_remarks(best, telling, anchors)),
        larger_share=best.larger_share,
        fleets=fleets,
        evidence=together.evidence,
        support=together.support,
        by_vehicles=parts,
    )


def _widened(best: OfVehicles) -> tuple[Posterior, dict[str, float]]:
    """The posterior of the scale by the vehicles, and the parts of its uncertainty; widened if lengths and widths
    contradict each other, for then both are less certain than they claim (Birge 1932)."""
    posterior, parts = best.posterior, dict(best.parts)
    if best.tension > CHECK_LIMIT:
        widened = posterior.widened(best.tension / CHECK_LIMIT)
        parts["margin"] = float(np.sqrt(parts["margin"] ** 2 + widened.spread**2 - posterior.spread**2))
        posterior = widened
    return posterior, parts


def _checks(best: OfVehicles, mean: np.ndarray) -> dict[str, float]:
    """The scale by lengths alone, by widths alone and, if the two differ, by length minus width. mean : (2,) mean log
    length and width of the vehicles [units]."""
    alike = np.exp(best.estimates + mean)  # [m] mean size of the vehicles here by the fleet, along both axes
    by_size = dict(zip(("length", "width"), np.exp(best.estimates).tolist(), strict=True))
    longer, units = alike[0] - alike[1], float(np.subtract(*np.exp(mean)))
    return {**by_size, "length_minus_width": float(longer / units)} if units > 0 else by_size


def _remarks(best: OfVehicles, telling: Sequence[AnchorVote], anchors: Sequence[AnchorVote]) -> Iterator[Remark]:
    """Remarks on the vehicles' shapes, and on anchors that do not count. telling : those that tell the country."""
    if best.tension > CHECK_LIMIT:
        yield remark_on_shape(float(best.estimates[0] - best.estimates[1]), best.tension)
    if best.of_one_model > LIKELY_ONE:
        yield Remark(
            INFO,
            "the vehicles are as alike as if they were of one model, as at a taxi rank or a dealer's: which model is "
            "not known, so the interval is wide",
        )
    if telling:
        kinds = " and ".join(dict.fromkeys(vote.anchor.kind for vote in telling))
        yield Remark(INFO, f"{kinds} tell the country, not the scale: each country has sizes of its own")
    elif any(vote.anchor.unlike for vote in anchors):
        yield Remark(INFO, "lane dashes do not count: the country is not known, and each has its own rules")


def _of_candidates(
    seen: Seen, fleet: Fleet, known: Mapping[str, np.ndarray], telling: Sequence[AnchorVote]
) -> tuple[OfVehicles, dict[str, float]]:
    """The scale by the votes if they are of one of the candidates of `fleet`; and the probability of each, by code.

    Arguments as of `of_fleets`; `telling` are anchors that suit some candidates and not others. All values are those
    of the likeliest candidate, except the posterior, which is that of all candidates: by how much it is wider counts
    as uncertainty of the fleet.
    """
    candidates, count = {one.code: one for one in fleet.candidates or (fleet,)}, len(seen)

    def tried(codes: Sequence[str], number: int) -> dict[str, OfVehicles]:
        """The scale by `number` of the votes under each of the candidates `codes`; without those that cannot be."""
        found = of_fleets(seen.few(number), [candidates[code] for code in codes], known)
        out = {code: v for code, v in zip(codes, found, strict=True) if v is not None}
        if not out:
            raise TooLittleEvidence(f"no boxes have the shape of vehicles of the fleet {codes[-1]}")
        return out

    codes = list(candidates)
    if len(codes) == 1:
        return tried(codes, count)[codes[0]], {codes[0]: 1.0}
    prior = np.array(fleet.prior)
    if seen.confusion and seen.called.size:
        prior = prior * country_likelihoods(seen.called, fleet.candidates, prior, seen.confusion)
    each = tried(codes, FEW)
    probability = _probabilities(each, dict(zip(codes, prior.tolist(), strict=True)))
    several = sorted(probability, key=probability.__getitem__, reverse=True)[:MOVED_BY]
    full = tried(several, count) if count > FEW else {code: each[code] for code in several}
    scales = _by_all_votes(each, full)
    probability = _given_anchors(probability, scales, telling)
    best = full[max(full, key=probability.__getitem__)]  # all votes may be impossible for the likeliest one
    fleets = {code: p for code, p in probability.items() if p > LIKELY}
    posterior = Posterior.mixed(list(scales.values()), np.array([probability[code] for code in scales]))
    return _by_fleets(best, posterior), fleets


def _by_all_votes(each: Mapping[str, OfVehicles], full: Mapping[str, OfVehicles]) -> dict[str, Posterior]:
    """The scale by all votes under each candidate, by code, where `each` is by FEW of them and `full`, for the
    likeliest candidates only, by all.

    The median shift of the likeliest fleets' scales from FEW to all votes is applied to every fleet. One fleet alone
    would give it too badly: its posterior may have two modes, of which all votes choose the other.
    """
    moved = np.median([full[code].posterior.centre - each[code].posterior.centre for code in full])
    return {code: replace(v.posterior, mean=v.posterior.mean + moved) for code, v in each.items()}


def _perhaps_of_one_model(best: OfVehicles, one: OneModel | None) -> OfVehicles:
    """`best`, with the posterior that all vehicles may be of `one` model as well."""
    if one is None:
        return best
    share = one.probability(best.log_evidence)
    posterior = Posterior.mixed([best.posterior, one.posterior], np.array([1 - share, share]))
    return replace(_by_fleets(best, posterior), of_one_model=share)


def _by_fleets(best: OfVehicles, posterior: Posterior) -> OfVehicles:
    """`best` with the `posterior` over several fleets or mixes: by how much it is wider counts as uncertainty of the
    fleet."""
    others = sum(v**2 for name, v in best.parts.items() if name != "fleet")
    wider = float(np.sqrt(max(posterior.spread**2 - others, best.parts["fleet"] ** 2)))
    return replace(best, posterior=posterior, parts={**best.parts, "fleet": wider})


def _probabilities(each: Mapping[str, OfVehicles], prior: Mapping[str, float]) -> dict[str, float]:
    """The probability of each fleet, by code: by the evidence of the vehicles' shapes and its `prior`."""
    log = np.array([v.log_evidence for v in each.values()])
    likelihood = np.array([prior[code] for code in each]) * np.exp(SHAPES_TOLD * (log - log.max()))
    return dict(zip(each, (likelihood / likelihood.sum()).tolist(), strict=True))


def _given_anchors(
    probability: Mapping[str, float], scales: Mapping[str, Posterior], telling: Sequence[AnchorVote]
) -> dict[str, float]:
    """The probability of each fleet, by code, given the anchors that tell the country as well. scales : by the vehicles
    of each."""
    suits = country_agreement(telling, scales)
    total = sum(p * suits[code] for code, p in probability.items())
    return {code: p * suits[code] / total for code, p in probability.items()}
