"""Evidence on the scale besides the vehicles: known distances, ground control, GPS positions of frames, anchors.

Each piece is one measurement of metres per unit with its own uncertainty. `pooling.combining` combines them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .pooling.posterior import Posterior
from .remarks import CAUTION, Remark, percent

CONFLICT_LIMIT = 3.0  # sigmas between two measurements from which they contradict each other
SUPPORTS = 2.0  # sigmas within which two measurements support each other; beyond, there is a caution
BY_MAP = "map"  # kind of the evidence from a match with a georeferenced map
BY_GPS = "GPS positions"  # kind of the evidence from the positions of frames (`core.gps`)
BY_DISTANCE, BY_CONTROL = "known distance", "ground control"  # kinds of the evidence that a user gives
MAY_BE = {  # by kind, what may be wrong with evidence that does not fit the rest
    BY_DISTANCE: "the distance may be mistyped, or not on the ground",
    BY_CONTROL: "the points may be mistyped, or in another grid",
    BY_GPS: "the positions may be from another flight",
    BY_MAP: "the place on the map may be wrong",
}
OF_ANCHORS = "it may follow another standard, or be something else"


@dataclass(frozen=True)
class Evidence:
    """One measurement of the scale: metres per unit of the source; `says` describes it.

    relative_sd : one sigma of its `value`, with all errors. modes, words : if it may mean several scales, all of them,
    and a description of each; `value` is one of them. doubt : probability that it is false; then any scale in a range
    as wide as `window` (in logarithms) is possible. common : one sigma of the error that it shares with the vehicles
    and with all else that was seen on the same ground; contained in `relative_sd`, but not in `modes`. documented :
    False if it rests on a standard that is not documented (`Standard.documented`): it counts, but improves no verdict.

    Raises ValueError where `common` is not less than `relative_sd`.
    """

    kind: str
    value: float
    relative_sd: float
    says: str
    modes: Posterior | None = None
    words: tuple[str, ...] = ()
    doubt: float = 0.0
    window: float = 1.0
    common: float = 0.0
    documented: bool = True

    def __post_init__(self) -> None:
        if self.modes is None and self.common and self.common >= self.relative_sd:
            raise ValueError(
                f"{self.says}: `common` {self.common:g} is not less than `relative_sd` {self.relative_sd:g}"
            )

    @classmethod
    def mixed(
        cls,
        kind: str,
        modes: Posterior,
        words: Sequence[str],
        doubt: float = 0.0,
        window: float = 1.0,
        common: float = 0.0,
    ) -> Evidence:
        """Evidence for a mixture of scales; its `value` is the most likely of them."""
        return cls(kind, 1.0, 1.0, "", modes, tuple(words), doubt, window, common)._meaning(modes.weight)

    def meant(self, scale: Posterior) -> Evidence:
        """The same, with the mode that fits the given `scale` best as its `value`."""
        if self.modes is None:
            return self
        variance = self.modes.sd**2 + scale.spread**2
        off = (self.modes.mean - scale.centre) ** 2 / variance
        return self._meaning(self.modes.weight * np.exp(-0.5 * (off - off.min())) / np.sqrt(variance))

    def only(self, which: np.ndarray) -> Evidence:
        """The same, restricted to the modes `which` (K,) bool, of which at least one must be True."""
        if self.modes is None:
            return self
        modes = self.modes.only(which)
        words = [word for word, keep in zip(self.words, which, strict=True) if keep]
        return replace(self, modes=modes, words=tuple(words))._meaning(modes.weight)

    def _meaning(self, likely: np.ndarray) -> Evidence:
        best, modes = int(np.argmax(likely)), self.posterior
        value, sd = float(np.exp(modes.mean[best])), float(modes.sd[best])
        return replace(self, value=value, relative_sd=sd, says=self.words[best])

    @property
    def own_sd(self) -> float:
        """One sigma of its `value` without the error that it shares with others."""
        return float(np.sqrt(self.relative_sd**2 - self.common**2))

    @property
    def posterior(self) -> Posterior:
        """The distribution of the scale's logarithm, given that the evidence is not false."""
        return self.own.blurred(self.common**2)

    def without_shared(self, other: Evidence) -> tuple[Posterior, Posterior]:
        """The distributions of this and of `other`, without the error that both share."""
        shared = min(self.common, other.common) ** 2
        return self.own.blurred(self.common**2 - shared), other.own.blurred(other.common**2 - shared)

    @property
    def own(self) -> Posterior:
        """The distribution of the scale's logarithm without the error that it shares with others."""
        return self.modes or Posterior.normal(float(np.log(self.value)), self.own_sd)


@dataclass(frozen=True)
class Compared:
    """One piece of evidence compared with the rest: the vehicles and the other evidence, combined without it.

    value : the scale that it means, given the rest. rest : the scale that the rest gives. sd : one sigma of the
    difference of their logarithms. unit : of both scales. documented : as `Evidence.documented`.
    """

    kind: str
    says: str
    value: float
    rest: float
    sd: float
    unit: str
    documented: bool = True

    @property
    def difference(self) -> float:
        """By what share it lies above the rest; negative if below."""
        return self.value / self.rest - 1

    @property
    def sigmas(self) -> float:
        """How many sigmas the two lie apart."""
        return float(abs(np.log(self.value / self.rest))) / self.sd

    @property
    def doubtful(self) -> bool:
        """Whether the rest does not support it."""
        return self.sigmas >= SUPPORTS

    @property
    def remark(self) -> Remark:
        """A caution for evidence that is `doubtful`."""
        apart = f"{percent(abs(self.difference))} {'more' if self.difference > 0 else 'less'}"
        text = (
            f"{self.says}: gives {self.value:.5g} {self.unit}, {apart} than the {self.rest:.5g} of everything else "
            f"({self.sigmas:.1f} sigma): {MAY_BE.get(self.kind, OF_ANCHORS)}"
        )
        return Remark(CAUTION, text)


@dataclass(frozen=True)
class Support:
    """How far other evidence supports a scale, and how that limits its verdict.

    compared : each piece that counts, compared with all the rest; empty in a conflict. unproven : what undocumented
    evidence takes off the scale's one sigma, in quadrature. conflicts : the figures of each pair of measurements that
    contradict each other, those furthest apart first.
    """

    compared: tuple[Compared, ...] = ()
    unproven: float = 0.0
    conflicts: tuple[str, ...] = ()

    @property
    def refusals(self) -> tuple[str, ...]:
        """The sentence of each conflict."""
        return tuple(f"conflict: {figures}" for figures in self.conflicts)

    @property
    def doubted(self) -> bool:
        """Whether a documented piece of evidence does not fit the rest."""
        return any(one.doubtful and one.documented for one in self.compared)

    def judged(self, sd: float) -> float:
        """The relative one-sigma by which a scale of one sigma `sd` is judged: without undocumented evidence."""
        return float(np.hypot(sd, self.unproven))
