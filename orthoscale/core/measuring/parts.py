"""Whether one scale holds for parts of a reconstruction that share no point: each is measured by its own vehicles."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..detections import Detections
from ..pooling.agreement import CONTRADICTION
from ..remarks import CAUTION, ON_PARTS, REFUSAL, Remark, amount
from ..scale import Scale
from ..verdicts import AT_BEST_DOUBTED
from .surface import LOTS_SD

NOT_SHARED = ("sampling", "geometry")  # parts of the uncertainty that two parts of a model do not share
PARTS_NAMED = 4  # how many parts are named
FEW_IMAGES = 0.05  # share of the images below which a part without a scale of its own leaves the verdict as it is
SPLIT_HINT = "Save each part as a model of its own (colmap image_deleter), and fix each by itself"


@dataclass(frozen=True)
class PartScale:
    """The scale of a part of a reconstruction. images : names of the part's. scale : by the vehicles in them."""

    images: Sequence[str]
    scale: Scale

    @property
    def log_value(self) -> float:
        """Logarithm of the scale's value."""
        return float(np.log(self.scale.value))

    @property
    def own_sd(self) -> float:
        """Relative one-sigma of the error that other parts do not share: they have other vehicles and other ground."""
        return float(np.sqrt(sum(self.scale.parts.get(name, 0.0) ** 2 for name in NOT_SHARED) + LOTS_SD**2))


@dataclass(frozen=True)
class Parts:
    """The parts of a reconstruction, compared. known : those with a scale of their own, the most certain first.
    unknown : names of the images of each of the others."""

    known: tuple[PartScale, ...]
    unknown: tuple[Sequence[str], ...]

    @classmethod
    def of(cls, scales: Sequence[tuple[Sequence[str], Scale | None]]) -> Parts:
        """scales : the images of each part, and its scale, None for too few vehicles."""
        known = [PartScale(images, scale) for images, scale in scales if scale is not None]
        unknown = tuple(images for images, scale in scales if scale is None)
        return cls(tuple(sorted(known, key=lambda part: part.own_sd)), unknown)

    @property
    def difference(self) -> float:
        """The largest relative difference from the most certain part."""
        return float(np.expm1(max((abs(log) for log, _ in self._from_first()), default=0.0)))

    @property
    def tension(self) -> float:
        """Sigmas by which the part that differs most clearly differs from the most certain one."""
        return max((abs(log) / sd for log, sd in self._from_first()), default=0.0)

    @property
    def contradict(self) -> bool:
        """Whether one scale cannot be that of all of them."""
        return self.tension > CONTRADICTION

    @property
    def said(self) -> str:
        """The scale of each, in words."""
        return _listed([*map(_of_part, self.known), *map(_without, self.unknown)])

    @property
    def contradiction(self) -> str:
        """The sentence that refuses one scale for all of them."""
        return f"parts of the model that share no point have different scales: {self.said}"

    def _from_first(self) -> list[tuple[float, float]]:
        """Log ratio of the scale of each further part to that of the first, and its one sigma."""
        return [
            (part.log_value - self.known[0].log_value, float(np.hypot(part.own_sd, self.known[0].own_sd)))
            for part in self.known[1:]
        ]

    def judged(self, scale: Scale) -> Scale:
        """`scale`, which was measured of all parts together, as these show it.

        If they contradict each other it is ``unusable``, and its interval covers all of them. If FEW_IMAGES or more are
        in parts without a scale of their own, nothing says that `scale` holds there: the verdict is AT_BEST_DOUBTED.
        """
        if self.contradict:
            wide = scale.contradicted_by([part.scale for part in self.known])
            return wide.remarked(Remark(REFUSAL, self.contradiction, SPLIT_HINT, ON_PARTS))
        without = sum(map(len, self.unknown))
        if without < FEW_IMAGES * (without + sum(len(part.images) for part in self.known)):
            return scale
        unknown = _listed([*map(_without, self.unknown)])
        text = f"{unknown}, and share no point with others: nothing tells their scale"
        return scale.remarked(Remark(CAUTION, text), at_best=AT_BEST_DOUBTED)


def _named(images: Sequence[str]) -> str:
    return f"{amount(len(images), 'images')} ({images[0]} ...)"


def _of_part(part: PartScale) -> str:
    scale = part.scale
    return f"{_named(part.images)} give {scale.value:.4g} {scale.unit} by {amount(scale.vehicles_used, 'vehicles')}"


def _without(images: Sequence[str]) -> str:
    return f"{_named(images)} have too few vehicles"


def _listed(said: Sequence[str]) -> str:
    more = len(said) - PARTS_NAMED
    return "; ".join(said[:PARTS_NAMED]) + (f"; and {amount(more, 'more parts')}" if more > 0 else "")


def found_in(images: Container[str], found: Detections) -> Detections:
    """The vehicles of `found` in the frames named `images`; those in ground pictures are left out, which were warped
    onto the ground of the whole reconstruction."""
    return replace(found.only_in(images), objects={}, planar=None)
