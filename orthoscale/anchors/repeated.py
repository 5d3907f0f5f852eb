"""A row of equal objects at one period as an anchor."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..core.anchors import Anchor, Standard
from .periods import Row
from .strokes import Strokes

LOCAL_STRETCH = 0.004  # relative one sigma of the local stretch of orthophotos: from tennis courts on 100 American ones


class Repeated(Protocol):
    """Equal `strokes` at one period.

    row : their places in order. relative_sd : relative one sigma of the period, by the fit.
    """

    @property
    def strokes(self) -> Strokes: ...
    @property
    def row(self) -> Row: ...
    @property
    def relative_sd(self) -> float: ...

    def lines(self) -> np.ndarray:
        """(N, 2, 2) lines of the fitted model, from end to end [px]."""
        ...


def anchor_of(found: Repeated, kind: str, standards: tuple[Standard, ...], false: float) -> Anchor:
    """`found` as an anchor of `kind`; its reference length is the period."""
    return Anchor(
        kind=kind,
        place=found.strokes.centre.mean(0),
        lines=found.lines(),
        pixels=found.row.period,
        relative_sd=float(np.hypot(found.relative_sd, LOCAL_STRETCH)),
        residual=found.row.residual,
        standards=standards,
        false=false,
        count=len(found.row.number),
    )
