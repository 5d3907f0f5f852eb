"""Two measurements of one model's scale: do they agree, and what do they say together?"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .pooling import Scale
from .posterior import Z90

CONTRADICTION = 3.0  # sigmas from which two measurements of one scale contradict each other
OWN = ("sampling", "margin", "geometry")  # parts of the uncertainty in which two looks at the same vehicles may differ
# What one look of a detector differs by from another at the same vehicles (relative, one sigma). An assumption: the two
# real scenes part by 3.2 % and 0.9 % in all.
OWN_MARGIN = 0.015


@dataclass(frozen=True)
class Agreement:
    """The two looks, by name; how far apart they are (log of second over first), and one sigma of that."""

    scales: dict[str, Scale]
    difference: float
    sd: float

    @property
    def tension(self) -> float:
        return abs(self.difference) / self.sd

    @property
    def contradicts(self) -> bool:
        return self.tension > CONTRADICTION

    def sentence(self) -> str:
        """In words."""
        (first, a), (second, b) = self.scales.items()
        return (
            f"{second} gives {b.value:.5g} {b.unit}, {first} {a.value:.5g}: {100 * self.difference:+.1f} %, "
            f"{self.tension:.1f} sigmas of what they may differ by"
        )


def compare(scales: dict[str, Scale]) -> Agreement:
    """How two scales of one source, by the same vehicles, fit together.

    Fleet errors, and most of the detector's, are the same in both and cancel; sampling and geometry are taken as
    independent, which lets them differ by more than two looks at the same vehicles should.
    """
    a, b = scales.values()
    own = [scale.parts.get(name, 0.0) ** 2 for scale in (a, b) for name in ("sampling", "geometry")]
    sd = float(np.sqrt(sum(own) + 2 * OWN_MARGIN**2))
    return Agreement(scales, float(np.log(b.value / a.value)), sd)


def together(agreement: Agreement) -> Scale:
    """The pooled scale: the first, moved towards the second by its weight.

    Weights are the inverse variances of what the two do not share. Vehicles, detector and ground are largely the same,
    so no part of the uncertainty gets smaller than its weighted mean, and their difference is part of it.
    """
    a, b = agreement.scales.values()
    own = np.array([sum(v**2 for k, v in s.parts.items() if k in OWN) for s in (a, b)])
    weight = (1 / own) / (1 / own).sum()
    log_value = float(weight @ np.log([a.value, b.value]))
    parts = {name: float(weight @ [a.parts[name], b.parts[name]]) for name in a.parts}
    excess = weight[0] * weight[1] * max(agreement.difference**2 - agreement.sd**2, 0.0)
    parts["sampling"] = float(np.hypot(parts["sampling"], np.sqrt(excess)))
    sd = np.sqrt(sum(v**2 for v in parts.values()))
    return replace(
        a,
        value=float(np.exp(log_value)),
        interval90=(float(np.exp(log_value - Z90 * sd)), float(np.exp(log_value + Z90 * sd))),
        parts=parts,
        checks={**a.checks, **{name: scale.value for name, scale in agreement.scales.items()}},
    )
