"""Many vehicles, one scale: robust pooling in log space, with an interval that says where its width comes from.

In logarithms every vehicle reads ``log size = log fleet size - log scale + noise``, for length and for width. `mixture`
sorts out which votes are vehicles of which class and gives two scales, one from lengths and one from widths, for each
mix of vehicles that may stand there. Their joint covariance is

    covariance = votes and their classes  +  what is not known of the fleet's mean
                 + what is not known of the detector's margin  + what is not known of the geometry

and the answer is their best linear combination (generalised least squares). So lengths rule where pixels are coarse and
widths where they are fine, without a rule for it. Only the first term shrinks with more vehicles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import TooLittleEvidence
from ..evidence import Evidence, combined
from ..fleet import Fleet
from ..ruler import Ruler
from ..scale import Scale
from ..verdicts import CHECK_LIMIT, reasons, remark_on_shape, verdict
from ..votes import Votes
from .mixture import Drawing, Fits, fit
from .posterior import Posterior

MIN_VEHICLES = 5  # arXiv 2603.07535 asks for the same
SMALLEST_SHARE = 0.3  # of a box that must be left once the margin is taken off
PRIOR_VOTES = 5.0  # the fleet's own scatter counts as so many vehicles, so that five lucky ones do not look certain
# What the mixture of classes and of larger vehicles leaves wrong, one sigma of all sizes alike: simulated car parks
# come out 1.3 % large without vans and 1.4 % small with a quarter of them (benchmarks/interval_coverage.py).
MIXTURE_SD = 0.013
LIKELY = 0.01  # probability below which a fleet is not reported
ENOUGH = 300  # votes by which candidate fleets are compared; their shapes count for 50 at most (`mixture`)


@dataclass(frozen=True)
class _Vehicles:
    """What the vehicles say, if they are of one fleet."""

    posterior: Posterior
    parts: dict[str, float]
    estimates: np.ndarray  # (2,) log scale by lengths and by widths
    weights: np.ndarray  # (2,) of these
    tension: float
    larger_share: float
    inlier: np.ndarray  # (N,) bool, of the measurable votes
    log_evidence: float


def pool(
    votes: Votes,
    fleet: Fleet,
    ruler: Ruler,
    unit: str,
    geometry: np.ndarray | None = None,
    evidence: Sequence[Evidence] = (),
) -> Scale:
    """The scale that `votes` give, for vehicles of `fleet`, measured with `ruler`.

    `geometry` (2, 2) is the relative covariance of lengths and widths that comes from the source's geometry (ground
    height, effective height), shared by all votes. `evidence` is what else is known of the scale.
    Where `fleet` has candidates, each is tried, and counts as much as the shape of the vehicles makes it likely.
    Raises TooLittleEvidence for fewer than MIN_VEHICLES usable votes, or boxes shaped like no vehicles.
    """
    size = votes.size - np.asarray(ruler.margin) * votes.pixel[:, None]
    fleeting = votes.fleeting
    measurable = (size > SMALLEST_SHARE * votes.size).all(1) & ~fleeting
    if measurable.sum() < MIN_VEHICLES:
        raise TooLittleEvidence(f"{int(measurable.sum())} usable vehicles, {MIN_VEHICLES} are needed")
    size = size[measurable]
    geometry = np.zeros((2, 2)) if geometry is None else geometry
    noise = _noise(votes, ruler)[measurable]
    share_px = np.median(votes.pixel[measurable, None] / size, axis=0)  # one pixel as a share of length and width
    known = {"margin": _margin_covariance(ruler, share_px), "geometry": geometry}

    best, fleets = _of_candidates(np.log(size), noise, fleet, known, ruler.drawing)
    if best.inlier.sum() < MIN_VEHICLES:
        raise TooLittleEvidence(
            f"{len(votes)} boxes, but only {int(best.inlier.sum())} have the sizes of vehicles of one scale; "
            f"{MIN_VEHICLES} are needed"
        )
    posterior, parts = best.posterior, dict(best.parts)
    remarks = []
    difference = float(best.estimates[0] - best.estimates[1])
    if best.tension > CHECK_LIMIT:
        # Two measurements that contradict each other know less than either claims (Birge 1932): widen what they share.
        widened = posterior.widened(best.tension / CHECK_LIMIT)
        parts["margin"] = float(np.sqrt(parts["margin"] ** 2 + widened.spread**2 - posterior.spread**2))
        posterior = widened
        remarks.append(remark_on_shape(difference, best.tension))
    vehicles = posterior
    used = np.zeros(len(votes), bool)
    used[measurable] = best.inlier
    mean = np.log(size[best.inlier]).mean(0)
    alike = np.exp(best.estimates + mean)  # [m] the fleet's vehicles that stand here, by lengths and by widths
    from_difference = (alike[0] - alike[1]) / np.subtract(*np.exp(mean))
    together = combined(vehicles, parts, evidence)
    value, low, high = together.summary
    return Scale(
        value=value,
        unit=unit,
        interval90=(low, high),
        parts=together.parts,
        checks={
            "length": float(np.exp(best.estimates[0])),
            "width": float(np.exp(best.estimates[1])),
            "length_minus_width": float(from_difference),
        },
        weights=(float(best.weights[0]), float(best.weights[1])),
        tension=best.tension,
        conflict=together.conflict,
        fleet=fleet.code,
        verdict=verdict(together.posterior.spread, best.tension > CHECK_LIMIT, together.conflict > 0),
        used=used,
        reasons=reasons(used, measurable, fleeting, np.log(size), mean),
        remarks=(*together.remarks, *remarks),
        larger_share=best.larger_share,
        fleets=fleets,
        evidence=together.evidence,
    )


def _noise(votes: Votes, ruler: Ruler) -> np.ndarray:
    """(N, 2) one-sigma noise of each vote's size [units]: its boxes' own where they have one, else the ruler's."""
    variance = (np.asarray(ruler.noise) * votes.pixel[:, None]) ** 2
    if votes.sigma is not None:
        variance = np.where(np.isfinite(votes.sigma), (votes.sigma * votes.size) ** 2, variance)
    return np.sqrt(variance / np.maximum(votes.views, 1)[:, None])


def _of_candidates(
    log_size: np.ndarray, noise: np.ndarray, fleet: Fleet, known: Mapping[str, np.ndarray], drawing: Drawing
) -> tuple[_Vehicles, dict[str, float]]:
    """What the votes say if they are of one of the candidates of `fleet`, and the probability of each, by code.

    Arguments as of `_of_fleet`. Everything is the likeliest's, but for the posterior, which is that of them all: what
    it is wider by is a part of not knowing the fleet.
    """
    candidates = fleet.candidates or (fleet,)
    count = len(log_size)
    some = np.linspace(0, count - 1, min(count, ENOUGH)).astype(int) if len(candidates) > 1 else np.arange(count)
    fits: dict[int, _Vehicles] = {}
    for k, candidate in enumerate(candidates):
        try:
            fits[k] = _of_fleet(log_size[some], noise[some], candidate, known, drawing)
        except TooLittleEvidence:  # it cannot be this one
            if k + 1 == len(candidates) and not fits:
                raise
    each, candidates = list(fits.values()), tuple(candidates[k] for k in fits)
    prior = tuple((fleet.prior or (1.0,))[k] for k in fits)
    probability = _probabilities(np.array([v.log_evidence for v in each]), prior)
    likeliest = int(np.argmax(probability))
    if len(some) < count:
        each[likeliest] = _of_fleet(log_size, noise, candidates[likeliest], known, drawing)
    best, fleets = each[likeliest], {}
    for candidate, share in zip(candidates, probability, strict=True):
        if share > LIKELY:
            fleets[candidate.code] = float(share)
    if len(each) == 1:
        return best, fleets
    posterior = Posterior.mixed([v.posterior for v in each], probability)
    others = sum(v**2 for name, v in best.parts.items() if name != "fleet")
    wider = float(np.sqrt(max(posterior.spread**2 - others, best.parts["fleet"] ** 2)))
    return replace(best, posterior=posterior, parts={**best.parts, "fleet": wider}), fleets


def _of_fleet(
    log_size: np.ndarray, noise: np.ndarray, fleet: Fleet, known: Mapping[str, np.ndarray], drawing: Drawing
) -> _Vehicles:
    """What votes of `log_size` (N, 2) with `noise` (N, 2) [units] say, were they of `fleet`; `known` are the (2, 2)
    covariances of what else is uncertain about them all."""
    shared = {"fleet": drawing.covariance(fleet.log_mean_covariance) + MIXTURE_SD**2, **known}
    systematic = sum(shared.values(), np.zeros((2, 2)))
    none = TooLittleEvidence(f"no boxes have the shape of vehicles of the fleet {fleet.code}")
    try:
        fits = fit(log_size, noise, fleet.told_apart, systematic, drawing=drawing)
    except np.linalg.LinAlgError as error:  # no vote supports any class: nothing determines the scale
        raise none from error
    if fits.weight @ fits.count < 1:
        raise none
    # How strongly the detector draws to the usual is known no better from more vehicles: it is the margin's kin.
    drawn = np.einsum("v,vij->ij", fits.weight, fits.drawing)
    shared["margin"] = shared["margin"] + drawn
    systematic = systematic + drawn
    estimates = fits.weight @ fits.log_scale
    sampling = _sampling(fits, fleet)
    apart = fits.log_scale - estimates
    total = systematic + np.einsum("v,vij->ij", fits.weight, sampling + apart[:, :, None] * apart[:, None])
    weights = _combine(total)
    variance = np.einsum("i,vij,j->v", weights, sampling + systematic, weights)
    posterior = Posterior(fits.weight, fits.log_scale @ weights, np.sqrt(variance))
    parts = {name: float(np.sqrt(weights @ c @ weights)) for name, c in shared.items()}
    # Which mix of vehicles stands here is a thing not known of the fleet: more of them do not tell it better.
    mix = float(fits.weight @ (posterior.mean - posterior.centre) ** 2)
    parts["fleet"] = float(np.hypot(parts["fleet"], np.sqrt(mix)))
    rest = posterior.spread**2 - sum(v**2 for v in parts.values())
    return _Vehicles(
        posterior=posterior,
        parts={"sampling": float(np.sqrt(rest)), **parts},
        estimates=estimates,
        weights=weights,
        tension=float(abs(estimates[0] - estimates[1]) / np.sqrt(total[0, 0] + total[1, 1] - 2 * total[0, 1])),
        larger_share=float(fits.member[-1].sum() / fits.member.sum()),
        inlier=fits.member.sum(0) > 0.5,
        log_evidence=fits.log_evidence,
    )


def _sampling(fits: Fits, fleet: Fleet) -> np.ndarray:
    """(V, 2, 2) covariance of the scales from the votes alone; never less than PRIOR_VOTES more vehicles of the fleet
    would leave, for the scatter of a few votes is not known from themselves."""
    count = np.maximum(fits.count, 1)
    least = _fleet_scatter(fleet) * (PRIOR_VOTES / (count + PRIOR_VOTES) / count)[:, None, None]
    return fits.covariance + least


def _probabilities(log_evidence: np.ndarray, prior: Sequence[float]) -> np.ndarray:
    """Of each fleet, by what it makes of the vehicles and how likely it was at first."""
    likelihood = np.asarray(prior) * np.exp(log_evidence - log_evidence.max())
    return likelihood / likelihood.sum()


def _fleet_scatter(fleet: Fleet) -> np.ndarray:
    """(2, 2) covariance of log size between the vehicles of the whole fleet."""
    total = sum(c.weight for c in fleet.classes)
    out = np.zeros((2, 2))
    for c in fleet.classes:
        d = c.log_mean - fleet.log_mean
        out += c.weight / total * (c.log_covariance + np.outer(d, d))
    return out


def _margin_covariance(ruler: Ruler, share_px: np.ndarray) -> np.ndarray:
    """(2, 2): the margin's uncertainty as a share of length and width, and the boxes' relative bias, own and shared."""
    own = (np.asarray(ruler.margin_sd) * share_px) ** 2 + np.asarray(ruler.bias_sd) ** 2
    return np.diag(own) + ruler.common_sd**2


def _combine(total: np.ndarray) -> np.ndarray:
    """Weights of the best linear combination of two estimates; none below zero, because a negative weight trusts the
    covariance's correlations more than they deserve."""
    w = np.linalg.solve(total, np.ones(2))
    w = np.clip(w / w.sum(), 0, 1)
    return w / w.sum()
