"""Errors common to all sizes of one measuring mode, by cause, and what remains of them in the mean of two modes.

Two modes share some causes: a ground that is too high, or a focal length that is too long, affects both. Shared errors
do not average out; errors of one mode alone do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..by_value import ByValue

# Names of shared causes: errors of the card's effective height at the ends and at the sides of vehicles; and errors of
# the bodies fitted to the views of a reconstruction, as far as they are not the card's.
ENDS, SIDES = "height of ends", "height of sides"
FITTED_ENDS, FITTED_SIDES = "fitted ends", "fitted sides"


@dataclass(frozen=True, eq=False)
class Systematic(ByValue):
    """Errors common to all sizes of one measuring mode.

    own : (2,) relative one-sigmas of all lengths, and of all widths, that no other mode shares. shared : by cause, (2,)
    how much larger lengths and widths come out (log) if the cause is one sigma off. Causes of the same name are
    identical in all modes; different causes are independent.
    """

    own: np.ndarray = field(default_factory=lambda: np.zeros(2))
    shared: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def covariance(self) -> np.ndarray:
        """(2, 2) relative covariance of lengths and widths."""
        return np.diag(np.square(self.own)) + sum((np.outer(s, s) for s in self.shared.values()), np.zeros((2, 2)))

    def and_shared(self, more: Mapping[str, np.ndarray]) -> Systematic:
        """The same with `more` shared causes."""
        return replace(self, shared={**self.shared, **more})

    def cross(self, other: Systematic) -> np.ndarray:
        """(2,) covariance with the errors of `other`: between the lengths of both, and between the widths of both."""
        causes = self.shared.keys() & other.shared.keys()
        return sum((self.shared[cause] * other.shared[cause] for cause in sorted(causes)), np.zeros(2))

    def mean(self, other: Systematic, weight: np.ndarray) -> Systematic:
        """Errors of the mean (of logarithms) of two modes' lengths and widths, in which `other` has `weight` (2,)."""
        none = np.zeros(2)
        return Systematic(
            np.hypot((1 - weight) * self.own, weight * other.own),
            {
                cause: (1 - weight) * self.shared.get(cause, none) + weight * other.shared.get(cause, none)
                for cause in {**self.shared, **other.shared}
            },
        )


def of_height(alone: np.ndarray, left: np.ndarray | float = 1.0) -> Systematic:
    """Errors of sizes from the uncertainty of vehicles' bodies, including their heights.

    alone : (2,) relative one-sigmas of lengths and widths. left : (2,) correlation of these errors with the error of
    the card's effective heights: 1 if the heights come from the card alone. The rest is the fit's, common to all modes
    that measure by the fitted ruler.
    """
    by_card = alone * left
    by_fit = np.sqrt(np.maximum(np.square(alone) - np.square(by_card), 0.0))
    causes = {ENDS: (by_card[0], 0.0), SIDES: (0.0, by_card[1])}
    causes |= {FITTED_ENDS: (by_fit[0], 0.0), FITTED_SIDES: (0.0, by_fit[1])}
    return Systematic(shared={cause: np.array(error) for cause, error in causes.items()})
