"""Whether one scale holds for parts of a reconstruction that share no point: each is measured by its own vehicles."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..boxes import Boxes
from ..detections import Detections
from ..normal import Z90
from ..pooling.agreement import CONTRADICTION
from ..remarks import CAUTION, REFUSAL, Remark, amount
from ..scale import Scale
from ..verdicts import AT_BEST_DOUBTED, UNUSABLE
from .surface import LOTS_SD

NOT_SHARED = ("sampling", "geometry")  # parts of the uncertainty that two parts of a model do not share
PARTS_NAMED = 4  # how many parts are named
FEW_IMAGES = 0.05  # share of the images below which a part without a scale of its own leaves the verdict as it is
SPLIT_HINT = "Save each part as a model of its own (colmap image_deleter), and fix each by itself"


@dataclass(frozen=True)
class PartScale:
    """The scale of a part of a reconstruction. images : names of the part's. scale : by the vehicles in them, None for
    too few."""

    images: Sequence[str]
    scale: Scale | None

    @property
    def own_sd(self) -> float:
        """Relative one-sigma of the error that other parts do not share: they have other vehicles and other ground."""
        parts = {} if self.scale is None else self.scale.parts
        return float(np.sqrt(sum(parts.get(name, 0.0) ** 2 for name in NOT_SHARED) + LOTS_SD**2))

    @property
    def said(self) -> str:
        """Its images and its scale, in words."""
        images = f"{amount(len(self.images), 'images')} ({self.images[0]} ...)"
        if self.scale is None:
            return f"{images} have too few vehicles"
        return f"{images} give {self.scale.value:.4g} by {amount(self.scale.vehicles_used, 'vehicles')}"


@dataclass(frozen=True)
class Parts:
    """The parts of a reconstruction, compared. known : those with a scale of their own, the most certain first.
    unknown : the others."""

    known: tuple[PartScale, ...]
    unknown: tuple[PartScale, ...]

    @classmethod
    def of(cls, parts: Iterable[PartScale]) -> Parts:
        """Of all `parts`."""
        every = tuple(parts)
        known = sorted((p for p in every if p.scale is not None), key=lambda part: part.own_sd)
        return cls(tuple(known), tuple(p for p in every if p.scale is None))

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
        """Whether any two have different scales, certainly."""
        return self.tension > CONTRADICTION

    @property
    def said(self) -> str:
        """The scale of each, in words."""
        return _listed((*self.known, *self.unknown))

    @property
    def contradiction(self) -> str:
        """The sentence that refuses one scale for all of them."""
        return f"parts of the model that share no point have different scales: {self.said}"

    def _from_first(self) -> list[tuple[float, float]]:
        """Log ratio of the scale of each part to that of the first, and its one sigma."""
        if not self.known:
            return []
        first, *others = ((np.log(p.scale.value), p.own_sd) for p in self.known if p.scale is not None)
        return [(float(log - first[0]), float(np.hypot(sd, first[1]))) for log, sd in others]

    def judged(self, scale: Scale) -> Scale:
        """`scale`, which was measured of all parts together, as these show it.

        If they contradict each other it is ``unusable``, and its interval covers all of them. If a part that is not
        FEW_IMAGES has no scale of its own, nothing says that `scale` holds there: the verdict is AT_BEST_DOUBTED.
        """
        if self.contradict:
            ends = [end for part in self.known if part.scale is not None for end in part.scale.interval90]
            low, high = min(*ends, *scale.interval90), max(*ends, *scale.interval90)
            spread = {"conflict": max(float(np.log(high / low)) / (2 * Z90), scale.relative_sd)}
            wide = replace(scale, interval90=(low, high), parts=spread, verdict=UNUSABLE)
            return wide.remarked(Remark(REFUSAL, self.contradiction, SPLIT_HINT))
        images = sum(len(part.images) for part in (*self.known, *self.unknown))
        if sum(len(part.images) for part in self.unknown) < FEW_IMAGES * images:
            return scale
        text = f"parts of the model that share no point: {_listed(self.unknown)}, so nothing tells their scale"
        return scale.remarked(Remark(CAUTION, text), at_best=AT_BEST_DOUBTED)


def _listed(parts: Sequence[PartScale]) -> str:
    more = len(parts) - PARTS_NAMED
    return "; ".join(part.said for part in parts[:PARTS_NAMED]) + (f"; and {more} more parts" if more > 0 else "")


def found_in(images: Collection[str], found: Detections) -> Detections:
    """Those of the detections `found` that lie in the frames named `images`, without ground pictures: these were warped
    onto the ground of the whole reconstruction."""

    def kept(boxes: dict[str, Boxes]) -> dict[str, Boxes]:
        return {name: some for name, some in boxes.items() if name in images}

    return replace(
        found,
        boxes=kept(found.boxes),
        doubtful=kept(found.doubtful),
        set_aside={why: kept(boxes) for why, boxes in found.set_aside.items()},
        objects={},
        planar=None,
    )
