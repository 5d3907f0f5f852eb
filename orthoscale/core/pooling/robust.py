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

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import TooLittleEvidence
from ..anchors import AnchorVote
from ..evidence import Evidence
from ..fleet import MOSTLY, Fleet
from ..normal import of_median
from ..remarks import CAUTION, INFO, Remark, amount, signed
from ..ruler import Ruler
from ..scale import Scale
from ..verdicts import CHECK_LIMIT, reasons, remark_on_shape, verdict
from ..votes import Votes
from .anchors import country_agreement, evidence_of, tells_country
from .by_kind import country_likelihoods
from .combining import combined
from .mixture import FINE, Fits, fit
from .observed import Seen
from .one_model import OneModel, of_one_model
from .posterior import Posterior
from .problem import Mix, believed, combine

MIN_VEHICLES = 5  # arXiv 2603.07535 asks for the same
SMALLEST_SHARE = 0.3  # least share of a box that must be left once the margin is taken off
# Share of the variance of a measured box that all views of a vehicle have in common: from its paint, its shade, its
# shape. On nine vehicles of `brighton`, with 29 boxes read by eye, lengths err by 1.8 % (one sigma) from vehicle to
# vehicle and by 1.8 % from view to view of one, widths by 3.0 and 4.0 %.
OF_THE_VEHICLE = 0.5
LIKELY_ONE = 0.5  # probability above which a place of one model is reported
LIKELY = 0.01  # probability below which a fleet is not reported
MOVED_BY = 7  # number of the likeliest fleets that are fitted to all votes
LEAST_LEARNT = 0.05  # least share of the prior variance of lengths against widths that vehicles remove
FEW = 60  # votes by which candidate fleets are compared; their shapes count for 25 at most (`solver`)
# How far the evidence of shapes on the country is believed: the power of its likelihood. In simulation shapes tell
# Japan from Germany. On 12 orthophotos of six countries the boxes of version 5 made the true country the less likely
# the more they were believed (mean log probability -7.0 if fully, -4.3 by a tenth, -4.2 if not at all:
# benchmarks/country_from_shapes.py), for boxes are too wide or too long together, as vehicles of another country are.
# The kinds are fully believed (`by_kind`); the little that they add to the shapes' tenth is counted twice.
SHAPES_TOLD = 0.1
# A place where most vehicles are of one class is proposed where that explains the sizes so many times better [nats]
# than the country's mix, and changes the scale by so much: at half of simulated lots with 60 % minis in Germany, 0 to 8
# % of usual ones, and wrongly at 3 of 190 real scenes (benchmarks/results/pooling.md, "Odd places").
PROPOSED, CHANGES = 2.0, 0.05
RARE = (0.025, 0.35)  # shares of a class that may be proposed: what is commoner dominates many places


@dataclass(frozen=True)
class _Vehicles:
    """The scale by the vehicles, if they are of one fleet."""

    posterior: Posterior
    parts: dict[str, float]
    estimates: np.ndarray  # (2,) log scale by lengths and by widths, each by itself
    weights: np.ndarray  # (2,) of these
    tension: float
    larger_share: float
    inlier: np.ndarray  # (N,) bool, of the measurable votes
    log_evidence: float
    of_one_model: float = 0.0  # probability that all are


def pool(
    votes: Votes,
    fleet: Fleet,
    ruler: Ruler,
    unit: str,
    geometry: np.ndarray | None = None,
    evidence: Sequence[Evidence] = (),
    anchors: Sequence[AnchorVote] = (),
    country: str = "",
) -> Scale:
    """The scale that `votes` give, for vehicles of `fleet`, measured with `ruler`.

    `geometry` (2, 2) is the relative covariance of lengths and widths that comes from the source's geometry (ground
    height, effective height), shared by all votes. `evidence` is other evidence on the scale, `anchors` the objects of
    standard size that were found. `country` decides between their standards (`evidence_of`); if it is not known, some
    anchors help to decide between the candidates of `fleet` (`tells_country`).
    If `fleet` has candidates, each is tried, and weighted by its probability given the vehicles and anchors.
    Raises TooLittleEvidence for fewer than MIN_VEHICLES usable votes, or boxes shaped like no vehicles.
    """
    index, size = _measurable(votes, ruler)
    seen, known = _seen(votes, index, size, ruler, geometry)
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
    mean = np.log(size[best.inlier]).mean(0)
    measuring = [vote for vote in anchors if not tells_country(vote)] if unknown else anchors
    together = combined(vehicles, parts, (*evidence, *evidence_of(measuring, country)))
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
        reasons=reasons(used, index, votes.fleeting, np.log(size), mean),
        remarks=(*together.remarks, *_remarks(best, telling, anchors)),
        larger_share=best.larger_share,
        fleets=fleets,
        evidence=together.evidence,
        support=together.support,
        by_vehicles=parts,
    )


def proposed_class(
    votes: Votes, fleet: Fleet, ruler: Ruler, geometry: np.ndarray | None = None, named: str = ""
) -> Iterator[Remark]:
    """The remark that most vehicles may be of one class that is rare in `fleet`, where their sizes suit that better.

    Only the user can say so: by sizes alone such a place hardly differs from one of other classes at another scale, and
    it is rare. named : what the user calls the fleet, if not by its code. Other arguments as of `pool`, and the same
    error.
    """
    if fleet.candidates or any(c.weight >= MOSTLY for c in fleet.classes):
        return
    seen, known = _seen(votes, *_measurable(votes, ruler), ruler, geometry)
    names = [c.name for c in fleet.classes if RARE[0] < c.weight < RARE[1]]
    usual, *each = _of_fleets(seen.few(FEW), [fleet, *map(fleet.mostly, names)], known)
    if usual is None:
        return
    found = {name: one for name, one in zip(names, each, strict=True) if one is not None}
    likeliest = max(found, key=lambda name: found[name].log_evidence, default="")
    if not likeliest or found[likeliest].log_evidence < usual.log_evidence + PROPOSED:
        return
    change = found[likeliest].posterior.centre - usual.posterior.centre
    if abs(change) > CHANGES:
        yield Remark(
            CAUTION,
            f"the sizes suit a place where most vehicles are of the class {likeliest} better than the mix of fleet "
            f"{fleet.code}, and that would change the scale by {signed(np.expm1(change))}: if the picture shows that "
            f"they are, name it with --fleet {shlex.quote(f'{named or fleet.code}:{likeliest}')}",
        )


def _seen(
    votes: Votes, index: np.ndarray, size: np.ndarray, ruler: Ruler, geometry: np.ndarray | None
) -> tuple[Seen, dict[str, np.ndarray]]:
    """What is seen of the votes that `_measurable` returns; and by part of the uncertainty, the (2, 2) covariances of
    the errors common to all of them, without the fleet's."""
    noise, called = vote_noise(votes, ruler)[index], _called(votes, ruler)[index]
    share_px = np.median(votes.pixel[index, None] / size, axis=0)  # one pixel as a share of length and width
    known = {
        "margin": _margin_covariance(ruler, share_px),
        "geometry": np.zeros((2, 2)) if geometry is None else geometry,
    }
    return Seen(np.log(size), noise, called, ruler.shrinkage, ruler.confusion), known


def _measurable(votes: Votes, ruler: Ruler) -> tuple[np.ndarray, np.ndarray]:
    """Indices (M,) of the votes that can be used, in the order of their sizes, and these sizes (M, 2) without the
    margin [units]. Raises TooLittleEvidence for fewer than MIN_VEHICLES."""
    size = votes.size - np.asarray(ruler.margin) * votes.pixel[:, None]
    index = np.flatnonzero((size > SMALLEST_SHARE * votes.size).all(1) & ~votes.fleeting)
    if len(index) < MIN_VEHICLES:
        raise TooLittleEvidence(f"{amount(len(index), 'usable vehicles')}, {MIN_VEHICLES} are needed")
    index = index[np.lexsort(size[index].T[::-1])]  # some stages take every n-th: sorted, so that order is irrelevant
    return index, size[index]


def _widened(best: _Vehicles) -> tuple[Posterior, dict[str, float]]:
    """The posterior of the scale by the vehicles, and the parts of its uncertainty; widened if lengths and widths
    contradict each other, for then both are less certain than they claim (Birge 1932)."""
    posterior, parts = best.posterior, dict(best.parts)
    if best.tension > CHECK_LIMIT:
        widened = posterior.widened(best.tension / CHECK_LIMIT)
        parts["margin"] = float(np.sqrt(parts["margin"] ** 2 + widened.spread**2 - posterior.spread**2))
        posterior = widened
    return posterior, parts


def _checks(best: _Vehicles, mean: np.ndarray) -> dict[str, float]:
    """The scale by lengths alone, by widths alone and, if the two differ, by length minus width. mean : (2,) mean log
    length and width of the vehicles [units]."""
    alike = np.exp(best.estimates + mean)  # [m] mean size of the vehicles here by the fleet, along both axes
    by_size = dict(zip(("length", "width"), np.exp(best.estimates).tolist(), strict=True))
    longer, units = alike[0] - alike[1], float(np.subtract(*np.exp(mean)))
    return {**by_size, "length_minus_width": float(longer / units)} if units > 0 else by_size


def _remarks(best: _Vehicles, telling: Sequence[AnchorVote], anchors: Sequence[AnchorVote]) -> Iterator[Remark]:
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


def vote_noise(votes: Votes, ruler: Ruler) -> np.ndarray:
    """(N, 2) one-sigma noise of each vote's size [units]: that of its boxes, or else the ruler's; and the errors that
    its views share."""
    views = np.maximum(votes.views, 1)
    variance = (np.asarray(ruler.noise) * votes.pixel[:, None]) ** 2 * of_median(views)[:, None]
    own = (votes.sigma * votes.size * left_by_views(views)[:, None]) ** 2
    variance = np.where(np.isfinite(own), own, variance)
    if votes.lasting is not None:
        variance = variance + (votes.lasting * votes.size) ** 2
    return np.sqrt(variance)


def _called(votes: Votes, ruler: Ruler) -> np.ndarray:
    """(N, 4) probability of each kind for each vote, zeros where it was not assessed; (N, 0) if kinds are not used."""
    if not ruler.kinds or np.isnan(votes.kinds).all():
        return np.empty((len(votes), 0))
    return np.where(np.isnan(votes.kinds).any(1, keepdims=True), 0.0, votes.kinds)


def left_by_views(views: np.ndarray) -> np.ndarray:
    """(N,) share of a measured box's sigma that is left in the median of so many `views` (N,) of one vehicle."""
    return np.sqrt(OF_THE_VEHICLE + (1 - OF_THE_VEHICLE) * of_median(np.maximum(views, 1)))


def _of_candidates(
    seen: Seen, fleet: Fleet, known: Mapping[str, np.ndarray], telling: Sequence[AnchorVote]
) -> tuple[_Vehicles, dict[str, float]]:
    """The scale by the votes if they are of one of the candidates of `fleet`; and the probability of each, by code.

    Arguments as of `_of_fleets`; `telling` are anchors that suit some candidates and not others. All values are those
    of the likeliest candidate, except the posterior, which is that of all candidates: by how much it is wider counts
    as uncertainty of the fleet.
    """
    candidates, count = fleet.candidates or (fleet,), len(seen)

    def tried(wanted: Sequence[int], number: int) -> dict[int, _Vehicles]:
        """The scale by `number` of the votes under each `wanted` candidate; without candidates that cannot be."""
        found = _of_fleets(seen.few(number), [candidates[k] for k in wanted], known)
        out = {k: v for k, v in zip(wanted, found, strict=True) if v is not None}
        if not out:
            raise TooLittleEvidence(f"no boxes have the shape of vehicles of the fleet {candidates[wanted[-1]].code}")
        return out

    if len(candidates) == 1:
        return tried([0], count)[0], {candidates[0].code: 1.0}
    prior = np.array(fleet.prior)
    if seen.confusion and seen.called.size:
        prior = prior * country_likelihoods(seen.called, candidates, prior, seen.confusion)
    each = tried(range(len(candidates)), FEW)
    probability = _probabilities(each, prior)
    several = sorted(probability, key=probability.__getitem__, reverse=True)[:MOVED_BY]
    full = tried(several, count) if count > FEW else {k: each[k] for k in several}
    scales = _by_all_votes(each, full)
    probability = _given_anchors(probability, {k: candidates[k].code for k in scales}, scales, telling)
    best = full[max(full, key=probability.__getitem__)]  # all votes may be impossible for the likeliest one
    fleets = {candidates[k].code: p for k, p in probability.items() if p > LIKELY}
    posterior = Posterior.mixed(list(scales.values()), np.array([probability[k] for k in scales]))
    return _by_fleets(best, posterior), fleets


def _by_all_votes(each: Mapping[int, _Vehicles], full: Mapping[int, _Vehicles]) -> dict[int, Posterior]:
    """The scale under each candidate by all votes, where `each` is by FEW of them and `full`, for the likeliest
    candidates only, by all.

    The median shift of the likeliest fleets' scales from FEW to all votes is applied to every fleet. One fleet alone
    would give it too badly: its posterior may have two modes, of which all votes choose the other.
    """
    moved = np.median([full[k].posterior.centre - each[k].posterior.centre for k in full])
    return {k: replace(v.posterior, mean=v.posterior.mean + moved) for k, v in each.items()}


def _perhaps_of_one_model(best: _Vehicles, one: OneModel | None) -> _Vehicles:
    """`best`, with the posterior that all vehicles may be of `one` model as well."""
    if one is None:
        return best
    share = one.probability(best.log_evidence)
    posterior = Posterior.mixed([best.posterior, one.posterior], np.array([1 - share, share]))
    return replace(_by_fleets(best, posterior), of_one_model=share)


def _by_fleets(best: _Vehicles, posterior: Posterior) -> _Vehicles:
    """`best` with the `posterior` over several fleets or mixes: by how much it is wider counts as uncertainty of the
    fleet."""
    others = sum(v**2 for name, v in best.parts.items() if name != "fleet")
    wider = float(np.sqrt(max(posterior.spread**2 - others, best.parts["fleet"] ** 2)))
    return replace(best, posterior=posterior, parts={**best.parts, "fleet": wider})


def _of_fleets(seen: Seen, fleets: Sequence[Fleet], known: Mapping[str, np.ndarray]) -> list[_Vehicles | None]:
    """The scale by the vehicles `seen` under each of `fleets`, None where they cannot be of it. known : by part of the
    uncertainty, the (2, 2) covariances of the other errors common to all of them."""
    every, mixes = [], []
    for fleet in fleets:
        classes = fleet.told_apart_by_kind if seen.called.size else fleet.told_apart
        shared = {"fleet": seen.shrinkage.covariance(fleet.class_mean_covariance(classes)), **known}
        systematic = believed(sum(shared.values(), np.zeros((2, 2))))
        every.append(shared)
        # Weights by the common errors alone: the fit ties the two scales by these, and so contains the votes' scatter.
        mixes.append(Mix(classes, systematic, combine(systematic), fleet.place_vehicles))
    found = fit(seen, mixes)
    return [
        None if fits is None or fits.member.sum() < 1 else _vehicles(fits, mix, shared)
        for fits, mix, shared in zip(found, mixes, every, strict=True)
    ]


def _vehicles(fits: Fits, mix: Mix, shared: Mapping[str, np.ndarray]) -> _Vehicles:
    """The scale by the `fits` to `mix`; `shared` are the (2, 2) parts of `Mix.systematic`."""
    systematic, weights = mix.systematic, mix.weights
    estimates = fits.weight @ fits.log_scale
    posterior = Posterior(
        fits.weight,
        fits.log_scale @ weights,
        np.full(len(fits.weight), np.sqrt(weights @ systematic @ weights + FINE**2 / 12)),
    )
    parts = {name: float(np.sqrt(weights @ c @ weights)) for name, c in shared.items()}
    # Sampling is what more vehicles would reduce; it is no less than the scatter of the scale between samples of as
    # many. More vehicles do not determine the shrinkage any better, so that counts as margin; nor the mix of vehicles
    # at this place, which counts as fleet.
    variance = posterior.spread**2
    rest = variance - sum(v**2 for v in parts.values())
    sampling = min(max(float(weights @ fits.covariance @ weights), fits.chance), rest)
    by_shrinkage = float(np.clip(weights @ fits.of_shrinkage @ weights, 0, rest - sampling))
    parts["margin"] = float(np.hypot(parts["margin"], np.sqrt(by_shrinkage)))
    parts["fleet"] = float(np.hypot(parts["fleet"], np.sqrt(rest - sampling - by_shrinkage)))
    # The prior ties the scales by lengths and by widths, so the fit has brought them nearer to each other: the
    # variance of their fitted difference is the prior variance minus the posterior one.
    apart = np.array([1.0, -1.0])
    before, left = apart @ systematic @ apart, fits.of_known @ apart
    learnt = max(before - apart @ left, LEAST_LEARNT * before)
    difference = apart @ estimates
    tension = abs(difference) / np.sqrt(learnt)
    # The two scales by the votes alone: the one that they determine less well was moved further. `weights` below are
    # those of these two in the answer, not of the tied ones.
    estimates = estimates + left / (apart @ left) * difference * (before / learnt - 1)
    return _Vehicles(
        posterior=posterior,
        parts={"sampling": float(np.sqrt(sampling)), **parts},
        estimates=estimates,
        weights=weights - apart * (weights @ left) / before,
        tension=float(tension),
        larger_share=float(fits.member[-1].sum() / fits.member.sum()),
        inlier=fits.member.sum(0) > 0.5,
        log_evidence=fits.log_evidence,
    )


def _probabilities(each: Mapping[int, _Vehicles], prior: np.ndarray) -> dict[int, float]:
    """The probability of each fleet, by the evidence of the vehicles' shapes and its `prior`."""
    log = np.array([v.log_evidence for v in each.values()])
    likelihood = prior[list(each)] * np.exp(SHAPES_TOLD * (log - log.max()))
    return dict(zip(each, (likelihood / likelihood.sum()).tolist(), strict=True))


def _given_anchors(
    probability: Mapping[int, float],
    codes: Mapping[int, str],
    scales: Mapping[int, Posterior],
    telling: Sequence[AnchorVote],
) -> dict[int, float]:
    """The probability of each fleet given the anchors that tell the country as well. codes : the fleets' codes. scales
    : by the vehicles of each."""
    suits = country_agreement(telling, {codes[k]: scale for k, scale in scales.items()})
    total = sum(p * suits[codes[k]] for k, p in probability.items())
    return {k: p * suits[codes[k]] / total for k, p in probability.items()}


def _margin_covariance(ruler: Ruler, share_px: np.ndarray) -> np.ndarray:
    """(2, 2) covariance from the margin's uncertainty, as a share of length and width, and from the box bias, own and
    shared. share_px : (2,) one pixel as a share of length and width."""
    own = (np.asarray(ruler.margin_sd) * share_px) ** 2 + np.asarray(ruler.bias_sd) ** 2
    return np.diag(own) + ruler.common_sd**2
