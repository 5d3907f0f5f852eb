"""The posterior of a scale: a mixture of normal distributions of its logarithm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, softmax

from ..by_value import ByValue

NEGLIGIBLE = 1e-9  # weight of a part, as a share of the largest, below which the part is left out


@dataclass(frozen=True, eq=False)
class Posterior(ByValue):
    """Weights, means and one-sigmas (K,) of the parts of the mixture, in logarithms; the weights sum to one."""

    weight: np.ndarray
    mean: np.ndarray
    sd: np.ndarray

    @classmethod
    def normal(cls, mean: float, sd: float) -> Posterior:
        """One normal distribution of the logarithm."""
        return cls(np.ones(1), np.array([mean]), np.array([sd]))

    @classmethod
    def mixed(cls, parts: Sequence[Posterior], weight: np.ndarray) -> Posterior:
        """Several posteriors, one of which holds, with the probabilities `weight`."""
        return cls(
            np.concatenate([w * p.weight for p, w in zip(parts, weight, strict=True)]),
            np.concatenate([p.mean for p in parts]),
            np.concatenate([p.sd for p in parts]),
        )

    @property
    def centre(self) -> float:
        """The mean."""
        return float(self.weight @ self.mean)

    @property
    def spread(self) -> float:
        """The standard deviation."""
        return float(np.sqrt(self.weight @ (self.sd**2 + (self.mean - self.centre) ** 2)))

    def quantile(self, share: float) -> float:
        """The value below which `share` of the probability lies; by bisection, to 1e-9."""
        low, high = (float(f(self.mean + k * self.sd)) for f, k in ((np.min, -9), (np.max, 9)))
        while high - low > 1e-9:
            middle = (low + high) / 2
            if self.weight @ ndtr((middle - self.mean) / self.sd) < share:
                low = middle
            else:
                high = middle
        return (low + high) / 2

    def widened(self, factor: float) -> Posterior:
        """The same, with every distance from the centre `factor` times as large."""
        return Posterior(self.weight, self.centre + factor * (self.mean - self.centre), factor * self.sd)

    def times(self, other: Posterior) -> Posterior:
        """The posterior given `other`, an independent measurement, as well (Bayes' product)."""
        variance, more = self.sd[:, None] ** 2, other.sd**2
        total = variance + more
        mean = (self.mean[:, None] * more + other.mean * variance) / total
        weight = softmax(self._overlap(other))
        return Posterior(weight.ravel(), mean.ravel(), np.sqrt(variance * more / total).ravel())

    def agreement(self, other: Posterior, doubt: float, window: float, like: float = 1.0) -> float:
        """The likelihood of `other` lying where it does, by the model of `times_doubted` [per unit of log scale]."""
        return sum(self._true_and_false(other, doubt, window, like))

    def times_doubted(self, other: Posterior, doubt: float, window: float, like: float = 1.0) -> Posterior:
        """As `times`, but `other` is a mistake with probability `doubt`, and then says nothing: mistakes lie anywhere
        in a range as wide as `window` (in logarithms). Of what is no mistake, a share of `like` is of the sort of
        `other`; the rest would be found elsewhere. Parts that have become negligible are left out."""
        true, false = self._true_and_false(other, doubt, window, like)
        found = Posterior.mixed([self.times(other), self], np.array([true, false]) / (true + false))
        return found.only(found.weight > NEGLIGIBLE * found.weight.max())

    def blurred(self, variance: float) -> Posterior:
        """The same with `variance` added to that of every part, or taken off if negative; at least a tenth is left."""
        return Posterior(self.weight, self.mean, np.sqrt(np.maximum(self.sd**2 + variance, 0.1 * self.sd**2)))

    def only(self, which: np.ndarray) -> Posterior:
        """The posterior given that one of the parts `which` (K,) bool holds; at least one must be True."""
        weight = self.weight[which]
        return Posterior(weight / weight.sum(), self.mean[which], self.sd[which])

    def _true_and_false(self, other: Posterior, doubt: float, window: float, like: float) -> tuple[float, float]:
        """Density of `other` if it measures the same scale, and if it is a mistake."""
        overlap = self._overlap(other) - 0.5 * np.log(2 * np.pi)
        return (1 - doubt) * like * float(np.exp(overlap).sum()), doubt / window

    def _overlap(self, other: Posterior) -> np.ndarray:
        """(K, L) log of the integral of the product of each part with each of `other`, times sqrt(2 pi)."""
        total = self.sd[:, None] ** 2 + other.sd**2
        log_weight = np.log(self.weight)[:, None] + np.log(other.weight) - 0.5 * np.log(total)
        return log_weight - 0.5 * (self.mean[:, None] - other.mean) ** 2 / total
