"""Errors against the truth: per region, and how they change with thresholds and with wrong geometry."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.detections import Detections
from ..core.fleet import Fleet
from ..core.pooling.paper import MIN_SCORE, MIN_VEHICLES
from .methods import METHODS, Estimate, Method
from .readers import Sample, changed

SCORES = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
VEHICLE_COUNTS = (1, 3, 5, 8, 12, 20)
PITCH_ERRORS = (-5.0, -2.0, -1.0, 0.0, 1.0, 2.0, 5.0)  # [deg]
FOCAL_ERRORS = (-0.05, -0.02, 0.0, 0.02, 0.05)
Step = Callable[[int, int], None] | None


@dataclass(frozen=True)
class Scored:
    """One photo: the truth, and the estimate of each method; None if it has too few vehicles."""

    sample: Sample
    estimates: dict[str, Estimate | None]


def score(
    samples: Sequence[Sample],
    found: Detections,
    fleet: Fleet,
    methods: Mapping[str, Method] = METHODS,
    min_score: float = MIN_SCORE,
    step: Step = None,
) -> list[Scored]:
    """The estimate of each method for each photo; thresholds of the number of vehicles are left to `summary`."""
    rows = []
    for k, sample in enumerate(samples):
        estimates = {name: method(sample.photo, found, fleet, min_score) for name, method in methods.items()}
        rows.append(Scored(sample, estimates))
        if step:
            step(k + 1, len(samples))
    return rows


def summary(rows: Sequence[Scored], method: str, min_vehicles: int = MIN_VEHICLES) -> dict[str, Any]:
    """One line of a table: how many photos were usable, and the errors of their altitudes [per cent].

    mape : mean absolute percentage error. bias : mean error. in_interval : share of truths in the 90 % interval, None
    for methods without one.
    """
    usable = [(r.sample, e) for r in rows if (e := r.estimates[method]) is not None and e.vehicles >= min_vehicles]
    truth = np.array([s.altitude for s, _ in usable])
    error = np.array([100 * (e.altitude / s.altitude - 1) for s, e in usable])
    inside = [e.low <= s.altitude <= e.high for s, e in usable if e.low is not None and e.high is not None]
    few = not usable
    return {
        "images": len(rows),
        "used": len(usable),
        "used_ratio": len(usable) / len(rows) if rows else 0.0,
        "mean_vehicles": None if few else float(np.mean([e.vehicles for _, e in usable])),
        "altitude_m": None if few else [float(truth.min()), float(truth.mean()), float(truth.max())],
        "mape": None if few else float(np.abs(error).mean()),
        "median_ape": None if few else float(np.median(np.abs(error))),
        "worst_ape": None if few else float(np.abs(error).max()),
        "bias": None if few else float(error.mean()),
        "in_interval": None if not inside else float(np.mean(inside)),
    }


def by_region(rows: Sequence[Scored], methods: Iterable[str]) -> dict[str, list[dict[str, Any]]]:
    """`summary` of each region, and of all photos if there are several regions, by method."""
    regions = list(dict.fromkeys(r.sample.region for r in rows))
    tables = {}
    for method in methods:
        lines = [{"region": g, **summary([r for r in rows if r.sample.region == g], method)} for g in regions]
        if len(regions) > 1:
            lines.append({"region": "all", **summary(rows, method)})
        tables[method] = lines
    return tables


def ablation(
    samples: Sequence[Sample], found: Detections, fleet: Fleet, methods: Mapping[str, Method], step: Step = None
) -> list[dict[str, Any]]:
    """MAPE and used ratio by score threshold and least number of vehicles (the paper's ablation)."""
    lines = []
    for k, min_score in enumerate(SCORES):
        rows = score(samples, found, fleet, methods, min_score)
        for method in methods:
            for count in VEHICLE_COUNTS:
                line = summary(rows, method, count)
                wanted = ("used", "used_ratio", "mape", "bias")
                lines.append(
                    {"method": method, "min_score": min_score, "min_vehicles": count} | {w: line[w] for w in wanted}
                )
        if step:
            step(k + 1, len(SCORES))
    return lines


def sensitivity(
    samples: Sequence[Sample], found: Detections, fleet: Fleet, methods: Mapping[str, Method], step: Step = None
) -> list[dict[str, Any]]:
    """MAPE and bias by error of pitch or focal length (the paper's sensitivity analysis)."""
    wrong = [("pitch_deg", e, changed(samples, pitch_deg=e)) for e in PITCH_ERRORS]
    wrong += [("focal", e, changed(samples, focal=1 + e)) for e in FOCAL_ERRORS]
    lines = []
    for k, (what, error, altered) in enumerate(wrong):
        rows = score(altered, found, fleet, methods)
        for method in methods:
            line = summary(rows, method)
            wanted = ("used", "mape", "bias")
            lines.append({"method": method, "wrong": what, "by": error} | {w: line[w] for w in wanted})
        if step:
            step(k + 1, len(wrong))
    return lines


def photo_rows(rows: Sequence[Scored]) -> list[dict[str, Any]]:
    """A line per photo: the truth, and for each method the altitude, its interval and the number of vehicles used."""
    lines = []
    for r in rows:
        line: dict[str, Any] = {
            "photo": r.sample.photo.name,
            "region": r.sample.region,
            "altitude_m": round(r.sample.altitude, 3),
            "pitch_deg": round(float(np.degrees(r.sample.photo.pitch)), 2),
        }
        for method, e in r.estimates.items():
            line |= {
                f"{method}_m": None if e is None else round(e.altitude, 3),
                f"{method}_low_m": None if e is None or e.low is None else round(e.low, 3),
                f"{method}_high_m": None
                if e is None or e.high is None or not np.isfinite(e.high)
                else round(e.high, 3),
                f"{method}_vehicles": 0 if e is None else e.vehicles,
            }
        lines.append(line)
    return lines
