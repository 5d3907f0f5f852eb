"""A detector's margin from an orthophoto of known scale: the pixels by which its boxes exceed vehicles.

At resampling factor k a box measures ``S + c x_k`` metres: the vehicle, and a margin of c detector pixels of x_k metres
each. The same vehicles at several factors separate S from c to some extent; the priors of the fleet (S) and of the
detector (c) do the rest. All of it is one least-squares problem per axis.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..errors import UsageError
from .detections import Detections
from .fleet import Fleet
from .market_segments import AXES
from .normal import median_and_sd
from .ruler import Ruler

ISO_CODE = re.compile("[A-Z]{2}")
LEAST_SPREAD = 0.5  # least spread of a place's vehicles, relative to the country's: box noise is not known well enough


@dataclass(frozen=True)
class Calibration:
    """A detector's ruler as measured at one place and, on request, the sizes of that place's vehicles.

    fleet_entry : that place's vehicles as in a fleet file (`Fleet.from_entry`), None if they were not fitted.
    made_from : the orthophoto, its scale, fleet and counts, for people. called : in messages: its file.
    """

    detector: str
    detector_sha256: str
    ruler: Ruler
    fleet_entry: Mapping[str, Any] | None
    made_from: Mapping[str, Any]
    called: str = field(default="the calibration", compare=False)

    def require_of(self, detector: str, sha256: str) -> None:
        """Raise UsageError if this is not a calibration of `detector`, whose file has the hash `sha256`."""
        if sha256 != self.detector_sha256:
            raise UsageError(
                f"{self.called} was measured for {self.detector}, not for {detector}",
                "Calibrate the detector that is used: orthoscale calibrate ORTHO --detector FILE.",
            )

    def applied(self, found: Detections) -> Detections:
        """`found` with this ruler. Raises UsageError if the boxes are another detector's."""
        self.require_of(found.detector, found.detector_sha256)
        planar = found.planar
        if planar is not None and planar.detector_sha256 == self.detector_sha256:
            planar = replace(planar, ruler=self.ruler)
        return replace(found, ruler=self.ruler, planar=planar)


@dataclass(frozen=True)
class MarginFit:
    """size : the vehicles' mean size [m]. margin : of the boxes [detector px]. `_sd` : one sigma of each."""

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
    """The vehicles' mean size and the boxes' margin, along one axis.

    size : (K,) mean box size at each zoom [m], margin included. pixel : (K,) one detector pixel [m].
    size_sd : (K,) one sigma of each zoom's error, independent of the other zooms [m]. fleet : prior (mean, one sigma)
    of the vehicles' mean size [m]. margin : prior (value, one sigma) [detector px].
    """
    design = np.vstack([np.column_stack([np.ones(len(size)), pixel]), np.eye(2)])
    observed = np.concatenate([size, [fleet[0], margin[0]]])
    sd = np.concatenate([size_sd, [fleet[1], margin[1]]])
    covariance = np.linalg.inv((design / sd[:, None] ** 2).T @ design)
    estimate = covariance @ design.T @ (observed / sd**2)
    residual = (observed - design @ estimate) / sd
    # Where zooms, fleet and detector contradict each other, all sigmas are enlarged by the Birge ratio (1932).
    surprise = max(1.0, float(residual @ residual) / len(size))
    size_var, margin_var = surprise * np.diag(covariance)
    return MarginFit(float(estimate[0]), float(np.sqrt(size_var)), float(estimate[1]), float(np.sqrt(margin_var)))


def local_fleet_entry(
    size: np.ndarray, noise: np.ndarray, relative_sd: np.ndarray, fleet: Fleet, name: str, source: str
) -> dict[str, Any]:
    """The fleet entry of one class for vehicles of `size` (N, 2) [m], lengths and widths that were measured with the
    one-sigma `noise` (2,) [m].

    Uses the median and the median absolute deviation, which a few larger vehicles do not move. relative_sd : (2,) of
    the mean. fleet : the country's; it gives the heights, and the spread where the noise hides it.
    """
    log = np.log(size)
    middle, scatter = median_and_sd(log)
    least = LEAST_SPREAD * np.sqrt(np.diag(fleet.log_covariance))
    spread = np.maximum(np.sqrt(np.maximum(scatter**2 - (noise / np.exp(middle)) ** 2, 0)), least)
    mean = [*(np.exp(middle) * (1 + spread**2 / 2)), fleet.mean[2]]
    sd = [*(mean[:2] * spread), fleet.sd[2]]
    known = [*relative_sd, fleet.mean_sd[2] / fleet.mean[2]]
    covariance = fleet.log_covariance
    # The country also tells which standards lane dashes and parking bays follow.
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
