"""A detector's margin from an orthophoto of known scale: the pixels by which its boxes exceed vehicles.

At resampling factor k a box measures ``S + c x_k`` metres: the vehicle, and a margin of c detector pixels, each x_k
metres on the ground. The same vehicles at several factors separate S from c to some extent; the priors of the fleet (S)
and of the detector (c) do the rest. All of it is one least-squares problem per axis.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UsageError
from .detections import Detections
from .fleet import Fleet
from .market_segments import AXES
from .pooling.posterior import ROBUST_SD
from .ruler import Ruler

ISO_CODE = re.compile("[A-Z]{2}")
LEAST_SPREAD = 0.5  # of the country's, of the vehicles of a place: noise is known too badly to say that they are alike


@dataclass(frozen=True)
class Calibration:
    """A detector's ruler as measured at one place, and that place's vehicles where asked for.

    fleet_entry : that place's vehicles as in a fleet file (`Fleet.from_entry`), None where they were not fitted.
    made_from : the orthophoto, its scale, fleet and counts, for people.
    """

    detector: str
    detector_sha256: str
    ruler: Ruler
    fleet_entry: Mapping[str, Any] | None
    made_from: Mapping[str, Any]

    def applied(self, found: Detections, path: Path) -> Detections:
        """`found` with this ruler. Raises UsageError when other boxes than this detector's were found; `path` is the
        calibration's own, for the message."""
        if found.detector_sha256 != self.detector_sha256:
            raise UsageError(
                f"{path} was measured for {self.detector}, but these boxes are those of {found.detector}",
                "Calibrate the detector that is used: orthoscale calibrate ORTHO --detector FILE.",
            )
        planar = found.planar
        if planar is not None and planar.detector_sha256 == self.detector_sha256:
            planar = replace(planar, ruler=self.ruler)
        return replace(found, ruler=self.ruler, planar=planar)


@dataclass(frozen=True)
class MarginFit:
    """size, margin : the vehicles' mean size [m] and the boxes' margin [detector px]; `_sd` their one sigma each."""

    size: float
    size_sd: float
    margin: float
    margin_sd: float


def fit_margin(
    size: np.ndarray,
    pixel: np.ndarray,
    size_sd: np.ndarray,
    fleet: tuple[float, float],
    margin: tuple[float, float],
) -> MarginFit:
    """Vehicles' mean size and the boxes' margin, along one axis.

    size : (K,) mean box size at each zoom [m], margin included. pixel : (K,) one detector pixel [m].
    size_sd : (K,) what each zoom's boxes may be off by on their own [m]. fleet : (mean, one sigma) of the vehicles'
    mean size [m] beforehand. margin : (value, one sigma) beforehand [detector px].
    """
    design = np.vstack([np.column_stack([np.ones(len(size)), pixel]), np.eye(2)])
    observed = np.concatenate([size, [fleet[0], margin[0]]])
    sd = np.concatenate([size_sd, [fleet[1], margin[1]]])
    covariance = np.linalg.inv((design / sd[:, None] ** 2).T @ design)
    estimate = covariance @ design.T @ (observed / sd**2)
    residual = (observed - design @ estimate) / sd
    # Where zooms, fleet and detector contradict each other, all know less than they claim (Birge 1932).
    surprise = max(1.0, float(residual @ residual) / len(size))
    size_var, margin_var = surprise * np.diag(covariance)
    return MarginFit(float(estimate[0]), float(np.sqrt(size_var)), float(estimate[1]), float(np.sqrt(margin_var)))


def local_fleet_entry(
    size: np.ndarray, noise: np.ndarray, relative_sd: np.ndarray, fleet: Fleet, name: str, source: str
) -> dict[str, Any]:
    """The entry of a fleet of one class whose sizes are those of `size` (N, 2) [m], lengths and widths that were
    measured with the one-sigma `noise` (2,) [m].

    By median and median absolute deviation, which a few larger vehicles do not move. relative_sd : (2,) how well the
    mean is known. fleet : the country's, which gives the heights, and the spread where the noise hides it.
    """
    log = np.log(size)
    middle = np.median(log, axis=0)
    spread = ROBUST_SD * np.median(np.abs(log - middle), axis=0)
    least = LEAST_SPREAD * np.sqrt(np.diag(fleet.log_covariance))
    spread = np.maximum(np.sqrt(np.maximum(spread**2 - (noise / np.exp(middle)) ** 2, 0)), least)
    mean = [*(np.exp(middle) * (1 + spread**2 / 2)), fleet.mean[2]]
    sd = [*(mean[:2] * spread), fleet.sd[2]]
    known = [*relative_sd, fleet.mean_sd[2] / fleet.mean[2]]
    covariance = fleet.log_covariance
    # The place has its country's lane dashes and bays, too.
    country = {"country": fleet.country} if ISO_CODE.fullmatch(fleet.country) else {}
    return {
        "name": name,
        "source": source,
        **country,
        "year": fleet.year,
        **{a: [round(float(m), 4), round(float(s), 4)] for a, m, s in zip(AXES, mean, sd, strict=True)},
        "mean_sd": [round(float(m * k), 4) for m, k in zip(mean, known, strict=True)],
        "corr_LW": round(float(covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])), 3),
    }
