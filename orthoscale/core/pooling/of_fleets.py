"""The scale by the vehicles if they are of one fleet, under each of several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..fleet import Fleet
from .mixture import FINE, Fits, fit
from .observed import Seen
from .posterior import Posterior
from .problem import Mix, believed, combine

FEW = 60  # votes by which candidate fleets are compared; their shapes count for 25 at most (`solver`)
LEAST_LEARNT = 0.05  # least share of the prior variance of lengths against widths that vehicles remove


@dataclass(frozen=True)
class OfVehicles:
    """The scale by the vehicles, if they are of one fleet."""

    posterior: Posterior
    parts: dict[str, float]
    estimates: np.ndarray  # (2,) log scale by lengths and by widths, each by itself
    weights: np.ndarray  # (2,) of these
    tension: float
    larger_share: float
    inlier: np.ndarray  # (N,) bool, of the usable votes
    log_evidence: float
    of_one_model: float = 0.0  # probability that all are


def of_fleets(seen: Seen, fleets: Sequence[Fleet], known: Mapping[str, np.ndarray]) -> list[OfVehicles | None]:
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


def _vehicles(fits: Fits, mix: Mix, shared: Mapping[str, np.ndarray]) -> OfVehicles:
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
    return OfVehicles(
        posterior=posterior,
        parts={"sampling": float(np.sqrt(sampling)), **parts},
        estimates=estimates,
        weights=weights - apart * (weights @ left) / before,
        tension=float(tension),
        larger_share=float(fits.member[-1].sum() / fits.member.sum()),
        inlier=fits.member.sum(0) > 0.5,
        log_evidence=fits.log_evidence,
    )
