"""Many vehicles, one scale: robust pooling in log space, with an interval that says where its width comes from.

In logarithms every vehicle reads ``log size = log fleet size - log scale + noise``, for length and for width. First the
boxes that no vehicle of the fleet would give are set aside (a mixture of the fleet and an outlier class). The rest give
two scales, one from lengths and one from widths, with a joint covariance

    covariance = scatter / N  +  what is not known of the fleet's mean  +  what is not known of the detector's margin
                 + what is not known of the geometry

and the answer is their best linear combination (generalised least squares). So lengths rule where pixels are coarse and
widths where they are fine, without a rule for it. Only the first term shrinks with more vehicles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .errors import TooLittleEvidence
from .fleet import Class, Fleet
from .votes import Votes

MIN_VEHICLES = 5  # arXiv 2603.07535 asks for the same
Z90 = 1.6449  # two-sided 90 % of a normal distribution
# Outlier class: uniform over a box in (log length, log width) as wide as anything a detector could call a vehicle.
OUTLIER_DENSITY = 1 / (3.0 * 2.5)
OUTLIER_SHARE = 0.1  # at the start; then estimated, between these bounds
OUTLIER_BOUNDS = (0.01, 0.6)
SMALLEST_SHARE = 0.3  # of a box that must be left once the margin is taken off
USUAL_VIEWS = 4  # views of a typical box's vehicle from which a single view counts as a mistake
PRIOR_SHARES = 10.0  # votes that the national shares of the fleet's classes count for
PRIOR_VOTES = 5.0  # the fleet's own scatter counts as so many vehicles, so that five lucky ones do not look certain
VERDICTS = (("good", 0.03), ("fair", 0.06), ("poor", 0.15))  # relative one-sigma of the scale, upper bounds
CHECK_LIMIT = 2.5  # sigmas between length and width before the verdict is lowered


@dataclass(frozen=True)
class Ruler:
    """How a detector's boxes relate to vehicles: length_px = vehicle + margin[0], and the same for the width.

    margin : (2,) excess of box length and width over the vehicle [detector px].
    margin_sd : (2,) its one-sigma uncertainty [detector px].
    bias_sd : (2,) relative uncertainty of box length and width that no number of boxes removes (labels, paint, shade).
    common_sd : the part of that which lengths and widths share: all boxes of a scene a little large, or small.
    noise : (2,) one-sigma noise of one box's length and width [detector px].
    """

    margin: tuple[float, float] = (0.0, 0.0)
    margin_sd: tuple[float, float] = (0.7, 0.7)
    bias_sd: tuple[float, float] = (0.015, 0.02)
    common_sd: float = 0.0
    noise: tuple[float, float] = (2.0, 1.2)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Ruler:
        """From the plain values of a card or a detections file. Raises TypeError, ValueError for others."""
        plain: dict[str, Any] = {
            k: tuple(map(float, v)) if isinstance(v, list) else float(v) for k, v in values.items()
        }
        return cls(**plain)


@dataclass(frozen=True)
class Scale:
    """Metres per unit of the source, and how well that is known.

    value : metres per pixel of an orthophoto, or per unit of a model.
    interval90 : (low, high), contains the truth nine times in ten.
    parts : relative one-sigma of each source of uncertainty: sampling, fleet, margin, geometry.
    checks : the scale from lengths alone, from widths alone and from length minus width (free of a symmetric margin).
    weights : share of lengths and widths in the answer.
    tension : sigmas between the scale from lengths and that from widths.
    used : (N,) bool, votes that count; reasons : (N,) why the others do not ('' where used).
    """

    value: float
    unit: str
    interval90: tuple[float, float]
    parts: dict[str, float]
    checks: dict[str, float]
    weights: tuple[float, float]
    tension: float
    fleet: str
    verdict: str
    used: np.ndarray = field(repr=False)
    reasons: list[str] = field(repr=False)
    remarks: tuple[str, ...] = ()

    @property
    def relative_sd(self) -> float:
        return float(np.sqrt(sum(sd**2 for sd in self.parts.values())))

    @property
    def vehicles_used(self) -> int:
        return int(self.used.sum())

    @property
    def rejected(self) -> dict[str, int]:
        """How many votes were set aside, by reason."""
        counts: dict[str, int] = {}
        for reason in filter(None, self.reasons):
            counts[reason] = counts.get(reason, 0) + 1
        return dict(sorted(counts.items(), key=lambda item: -item[1]))


def pool(votes: Votes, fleet: Fleet, ruler: Ruler, unit: str, geometry: np.ndarray | None = None) -> Scale:
    """The scale that `votes` give, for vehicles of `fleet`, measured with `ruler`.

    `geometry` (2, 2) is the relative covariance of lengths and widths that comes from the source's geometry (ground
    height, effective height), shared by all votes.
    Raises TooLittleEvidence for fewer than MIN_VEHICLES usable votes.
    """
    size = votes.size - np.asarray(ruler.margin) * votes.pixel[:, None]
    fleeting = _fleeting(votes)
    measurable = (size > SMALLEST_SHARE * votes.size).all(1) & ~fleeting
    if measurable.sum() < MIN_VEHICLES:
        raise TooLittleEvidence(f"{int(measurable.sum())} usable vehicles, {MIN_VEHICLES} are needed")
    log_size = np.log(size[measurable])
    share_px = votes.pixel[measurable, None] / size[measurable]  # one pixel as a share of length and width
    noise = (np.asarray(ruler.noise) * share_px) ** 2 / np.maximum(votes.views[measurable, None], 1)

    systematic = fleet.log_mean_covariance + _margin_covariance(ruler, np.median(share_px, axis=0))
    systematic = systematic + (0 if geometry is None else geometry)
    membership, unsure = _fit(log_size, noise, fleet.classes, systematic)
    inlier = membership.sum(0) > 0.5
    used = np.zeros(len(votes), bool)
    used[measurable] = inlier
    if used.sum() < MIN_VEHICLES:
        raise TooLittleEvidence(
            f"{len(votes)} boxes, but only {int(used.sum())} have the sizes of vehicles of one scale; "
            f"{MIN_VEHICLES} are needed"
        )

    p = membership * inlier
    w = p.sum(0)
    gap = np.array([c.log_mean for c in fleet.classes])[:, None] - log_size  # (classes, N, 2) log scale by each
    estimates = (p[..., None] * gap).sum((0, 1)) / w.sum()
    effective = w.sum() ** 2 / (w**2).sum()
    residual = gap - estimates
    scatter = np.einsum("kn,kni,knj->ij", p, residual, residual)
    expected = _fleet_scatter(fleet) + np.diag(np.average(noise, axis=0, weights=w))
    covariances = {
        "sampling": (scatter + PRIOR_VOTES * expected) / (w.sum() + PRIOR_VOTES) / effective + unsure,
        "fleet": fleet.log_mean_covariance,
        "margin": _margin_covariance(ruler, np.average(share_px, axis=0, weights=w)),
        "geometry": np.zeros((2, 2)) if geometry is None else geometry,
    }
    total = sum(covariances.values())
    weights = _combine(total)
    log_scale = float(weights @ estimates)
    parts = {name: float(np.sqrt(weights @ c @ weights)) for name, c in covariances.items()}

    difference = float(estimates[0] - estimates[1])
    tension = abs(difference) / np.sqrt(total[0, 0] + total[1, 1] - 2 * total[0, 1])
    sd = float(np.sqrt(weights @ total @ weights)) * max(1.0, tension / CHECK_LIMIT)
    if tension > CHECK_LIMIT:
        # Two measurements that contradict each other know less than either claims (Birge 1932): widen what they share.
        parts["margin"] = float(np.sqrt(sd**2 - sum(v**2 for k, v in parts.items() if k != "margin")))
    mean = np.average(log_size, axis=0, weights=w)
    alike = np.exp(estimates + mean)  # [m] the fleet's vehicles that stand here, by lengths and by widths
    from_difference = (alike[0] - alike[1]) / np.subtract(*np.exp(mean))
    verdict, remarks = _verdict(sd, tension, difference)
    return Scale(
        value=float(np.exp(log_scale)),
        unit=unit,
        interval90=(float(np.exp(log_scale - Z90 * sd)), float(np.exp(log_scale + Z90 * sd))),
        parts=parts,
        checks={
            "length": float(np.exp(estimates[0])),
            "width": float(np.exp(estimates[1])),
            "length_minus_width": float(from_difference),
        },
        weights=(float(weights[0]), float(weights[1])),
        tension=float(tension),
        fleet=fleet.code,
        verdict=verdict,
        used=used,
        reasons=_reasons(used, measurable, fleeting, log_size, mean),
        remarks=tuple(remarks),
    )


def _fit(
    log_size: np.ndarray, noise: np.ndarray, classes: Sequence[Class], systematic: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which votes are vehicles of which class.

    Returns (classes, N) probabilities; what is missing from one is to be none. And the (2, 2)
    covariance that the scales by length and width gain because classes and shares are only guessed.

    Expectation-maximisation over the scale, the classes' shares and the share of outliers, from the best point of a
    grid of scales. The shares start at the fleet's, which count as PRIOR_SHARES votes: a car park has its own mix.
    Lengths and widths have a scale each, for fleet, margin and geometry may be off; `systematic` (2, 2) says how far
    the two may part. With one scale for both, a fleet a little too long would turn cars into pickups.
    """
    national = np.array([c.weight for c in classes]) / sum(c.weight for c in classes)
    means = np.array([c.log_mean for c in classes])
    covariance = np.array([c.log_covariance for c in classes])[:, None] + noise[:, :, None] * np.eye(2)  # (K, N, 2, 2)

    def density(log_scale: np.ndarray | float, inverse: np.ndarray) -> np.ndarray:
        """(K, N), not weighted by the classes' shares."""
        r = log_size + log_scale - means[:, None]
        square = np.einsum("kni,knij,knj->kn", r, inverse, r)
        return np.sqrt(np.linalg.det(inverse)) / (2 * np.pi) * np.exp(-0.5 * square)

    centre = float(np.median((national @ means - log_size).mean(1)))
    grid = centre + np.arange(-1.2, 1.2, 0.02)
    coarse = np.linalg.inv(covariance + systematic)
    likelihood = [
        np.log((1 - OUTLIER_SHARE) * (national @ density(g, coarse)) + OUTLIER_SHARE * OUTLIER_DENSITY).sum()
        for g in grid
    ]
    log_scale, share, outliers = np.full(2, grid[int(np.argmax(likelihood))]), national, OUTLIER_SHARE
    inverse = np.linalg.inv(covariance)
    together = np.linalg.inv(systematic)  # holds the two scales to one another, and leaves what they share free
    together = together - np.outer(together.sum(0), together.sum(0)) / together.sum()
    for _ in range(200):
        weighted = (1 - outliers) * share[:, None] * density(log_scale, inverse)
        p = weighted / (weighted.sum(0) + outliers * OUTLIER_DENSITY)
        information = np.einsum("kn,knij->ij", p, inverse) + together
        new = np.linalg.solve(information, np.einsum("kn,knij,knj->i", p, inverse, means[:, None] - log_size))
        outliers = float(np.clip(1 - p.sum(0).mean(), *OUTLIER_BOUNDS))
        share = (p.sum(1) + PRIOR_SHARES * national) / (p.sum() + PRIOR_SHARES)
        done = np.abs(new - log_scale).max() < 1e-7
        log_scale = new
        if done:
            break

    # What is known of scales and shares together, from the votes' scores (Berndt et al. 1974), against what would be
    # known of the scales if every vote wore its class.
    pull = np.einsum("kn,knij,knj->ni", p, inverse, means[:, None] - log_size - log_scale)
    score = np.hstack([pull, p.T - (1 - outliers) * share])
    known = score.T @ score
    known[:2, :2] += together
    known[2:, 2:] += PRIOR_SHARES * (np.diag(share) - np.outer(share, share)) + 1e-6 * np.eye(len(share))
    gain, axes = np.linalg.eigh(np.linalg.inv(known)[:2, :2] - np.linalg.inv(information))
    return p, (axes * np.maximum(gain, 0)) @ axes.T


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


def _verdict(sd: float, tension: float, difference: float) -> tuple[str, list[str]]:
    names = [name for name, _ in VERDICTS] + ["refuse"]
    rank = next((k for k, (_, limit) in enumerate(VERDICTS) if sd <= limit), len(VERDICTS))
    remarks = []
    if tension > CHECK_LIMIT:
        rank = min(rank + 1, len(VERDICTS) - 1)
        larger, smaller = ("lengths", "widths") if difference > 0 else ("widths", "lengths")
        percent = 100 * abs(np.expm1(difference))
        remarks.append(
            f"{larger} give a larger scale than {smaller} by {percent:.0f} %: another fleet, or boxes that do not fit"
        )
    return names[rank], remarks


def _fleeting(votes: Votes) -> np.ndarray:
    """(N,) bool: seen in a single frame where vehicles are usually seen in many. Mistakes flicker, parked cars stay."""
    usual = np.median(np.repeat(votes.views, votes.views)) if len(votes) else 0
    return (votes.views == 1) & (usual >= USUAL_VIEWS)


def _reasons(
    used: np.ndarray, measurable: np.ndarray, fleeting: np.ndarray, log_size: np.ndarray, mean: np.ndarray
) -> list[str]:
    reasons = ["seen in one frame only" if f else "smaller than the detector's margin" for f in fleeting]
    for index, (d_length, d_width) in zip(np.flatnonzero(measurable), log_size - mean, strict=True):
        if used[index]:
            reasons[index] = ""
        elif abs(d_length - d_width) > max(abs(d_length), abs(d_width)):
            reasons[index] = "wrong shape for a car"
        else:
            reasons[index] = "too small for a car" if d_length + d_width < 0 else "too large for a car"
    return reasons
