"""What is known of the scale besides vehicles: distances, ground control, standard objects, the pitch of parking rows.

Each piece is one measurement of metres per unit with its own uncertainty. Those that agree are combined; those that do
not are reported, and nothing is averaged away.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .pooling.posterior import Z90, Posterior
from .remarks import REFUSAL, Remark

CONFLICT_LIMIT = 3.0  # sigmas between two measurements from which they contradict each other
DISTANCE_SD = 0.01  # of a known distance's metres, where none is given: a tape, and pixels clicked by hand
SHORTEST, LONGEST = 1e-3, 1e6  # of a known distance [m]: what shows in a picture
SUREST = 1e-6  # sigma of a known distance, as a share of it: surveyors reach that
CONTROL_SD = 0.05  # of a ground control point's position, where its residuals do not say [m]


@dataclass(frozen=True)
class Evidence:
    """One measurement of the scale: metres per unit of the source, with a relative one-sigma; `says` where from."""

    kind: str
    value: float
    relative_sd: float
    says: str

    @property
    def posterior(self) -> Posterior:
        """The same as a normal distribution of the scale's logarithm."""
        return Posterior.normal(float(np.log(self.value)), self.relative_sd)


@dataclass(frozen=True)
class Combined:
    """What all measurements say together.

    conflict : sigmas between the two that contradict each other most, 0 where none do.
    summary : value and the ends of its 90 % interval. Where measurements conflict, the interval spans them all.
    """

    posterior: Posterior
    parts: dict[str, float]
    conflict: float
    remarks: list[Remark]
    summary: tuple[float, float, float]


def combined(vehicles: Posterior, parts: Mapping[str, float], evidence: Sequence[Evidence]) -> Combined:
    """`vehicles` and all `evidence` together; `parts` are the one-sigmas of which the vehicles' is made up.

    In a conflict the surest measurement gives the value, and the interval reaches over those of all.
    """
    sources = [("vehicles", vehicles), *((e.says, e.posterior) for e in evidence)]
    conflict, remarks = 0.0, list[Remark]()
    for k, (name, one) in enumerate(sources):
        for other_name, other in sources[k + 1 :]:
            sigmas = abs(one.centre - other.centre) / np.hypot(one.spread, other.spread)
            if sigmas > CONFLICT_LIMIT:
                conflict = max(conflict, float(sigmas))
                text = (
                    f"conflict: {name}: {np.exp(one.centre):.5g}, {other_name}: {np.exp(other.centre):.5g}, "
                    f"{sigmas:.1f} sigmas apart"
                )
                remarks.append(Remark(REFUSAL, text, "Check the given evidence and the boxes (--save-detections)"))
    if conflict:
        surest = min((p for _, p in sources), key=lambda p: p.spread)
        low = min(p.quantile(0.05) for _, p in sources)
        high = max(p.quantile(0.95) for _, p in sources)
        spread = max((high - low) / (2 * Z90), surest.spread)
        wide = Posterior.normal(surest.centre, spread)
        summary = (float(np.exp(surest.centre)), float(np.exp(low)), float(np.exp(high)))
        return Combined(wide, {"conflict": float(spread)}, conflict, remarks, summary)
    posterior = vehicles
    for e in evidence:
        posterior = posterior.times(e.posterior)
    value, low, high = (float(np.exp(posterior.quantile(q))) for q in (0.5, 0.05, 0.95))
    return Combined(posterior, _shares(vehicles, parts, evidence, posterior), 0.0, remarks, (value, low, high))


def _shares(
    vehicles: Posterior, parts: Mapping[str, float], evidence: Sequence[Evidence], posterior: Posterior
) -> dict[str, float]:
    """One-sigmas that each source contributes to the combination; their squares add up to its variance."""
    if not evidence:
        return dict(parts)
    precision = np.array([vehicles.spread**-2, *(e.relative_sd**-2 for e in evidence)])
    weight = precision / precision.sum()
    out = {name: float(sd * weight[0]) for name, sd in parts.items()}
    for e, w in zip(evidence, weight[1:], strict=True):
        out[e.kind] = float(np.hypot(out.get(e.kind, 0.0), e.relative_sd * w))
    adjust = posterior.spread / np.sqrt(sum(sd**2 for sd in out.values()))
    return {name: float(sd * adjust) for name, sd in out.items()}


def known_distance(points: np.ndarray, metres: float, sd: float | None = None, where: str = "") -> Evidence:
    """Two points (2, D) [units], `metres` apart, good to `sd` [m] (1 % where it is not given).

    Raises ValueError where the points coincide or a number is not positive.
    """
    units = float(np.linalg.norm(points[0] - points[1]))
    sd = DISTANCE_SD * metres if sd is None else sd
    if not (np.isfinite(units) and units > 0):
        raise ValueError("the points must differ")
    if not SHORTEST <= metres <= LONGEST:
        raise ValueError(f"the distance must be a number of metres from {SHORTEST:g} to {LONGEST:g}")
    if not SUREST * metres <= sd <= metres:
        raise ValueError("the sigma must be positive metres, from a millionth of the distance to all of it")
    return Evidence("known distance", metres / units, sd / metres, f"the known distance of {metres:g} m{where}")


def ground_control(units: np.ndarray, metres: np.ndarray) -> Evidence:
    """Points (N, D) [units] and the same points (N, D') [m], N >= 2: the scale of the similarity that takes one to the
    other (ratio of their spreads about the middle, Horn 1987), and its uncertainty from what does not fit.

    Distances between the points are compared, not positions, so axes may point anywhere. Raises ValueError.
    """
    if len(units) < 2 or len(units) != len(metres):
        raise ValueError("at least two points are needed, each in both systems")
    spread = [np.sqrt(((p - p.mean(0)) ** 2).sum()) for p in (units, metres)]
    if not np.isfinite(spread).all() or min(spread) <= 0:
        raise ValueError("the points must differ from one another")
    value = spread[1] / spread[0]
    i, j = np.triu_indices(len(units), 1)
    misfit = np.linalg.norm(metres[i] - metres[j], axis=1) - value * np.linalg.norm(units[i] - units[j], axis=1)
    sd = max(CONTROL_SD, float(np.sqrt((misfit**2).mean() / 2)))
    return Evidence("ground control", float(value), float(sd / spread[1]), f"ground control ({len(units)} points)")
