"""What an orthophoto of known scale says of a detector: the pixels by which its boxes exceed vehicles.

In metres a box of zoom k is ``S + c x_k``: the vehicle, and a margin of c detector pixels, each x_k metres on the
ground. The same vehicles at several zooms tell S and c apart a little; what is known of the fleet (S) and of the
detector (c) beforehand tells the rest. All of it is one least-squares problem per axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UsageError
from .detections import Detections
from .fleet import Fleet
from .ruler import Ruler


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


def scaled_fleet(fleet: Fleet, factor: np.ndarray, relative_sd: np.ndarray, name: str, source: str) -> dict[str, Any]:
    """The entry of a fleet whose lengths and widths are `factor` (2,) times those of `fleet`, class by class, and whose
    mean is known to `relative_sd` (2,)."""
    grown = np.array([*factor, 1.0])

    def sizes(mean: np.ndarray, sd: np.ndarray) -> dict[str, list[float]]:
        pairs = zip(("length", "width", "height"), (mean * grown).tolist(), (sd * grown).tolist(), strict=True)
        return {axis: [round(m, 4), round(s, 4)] for axis, m, s in pairs}

    mean_sd = fleet.mean * grown * [*relative_sd, fleet.mean_sd[2] / fleet.mean[2]]
    return {
        "name": name,
        "source": source,
        "year": fleet.year,
        **sizes(fleet.mean, fleet.sd),
        "mean_sd": [round(float(v), 4) for v in mean_sd],
        "mixture": [
            {"class": c.name, "weight": c.weight, "corr_LW": c.corr_lw, **sizes(c.mean, c.sd)} for c in fleet.classes
        ],
    }
