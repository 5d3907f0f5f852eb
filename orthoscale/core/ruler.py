"""How a detector's boxes relate to vehicles: the ruler that a card gives, or a calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .pooling.observed import Confusion, Drawing


@dataclass(frozen=True)
class Ruler:
    """How a detector's boxes relate to vehicles: length_px = vehicle + margin[0], and the same for the width.

    margin : (2,) excess of box length and width over the vehicle [detector px].
    margin_sd : (2,) its one-sigma uncertainty [detector px].
    bias_sd : (2,) relative uncertainty of box length and width that no number of boxes removes (labels, paint, shade).
    common_sd : the part of that which lengths and widths share: all boxes of a scene a little large, or small.
    noise : (2,) one-sigma noise of one box's length and width [detector px].
    shrink : (2,) how far a box's length and width are drawn from the vehicle's to the usual one's: log box = log
        vehicle + shrink * (log usual - log vehicle), then the margin; 0 for a faithful detector, 1 for one that draws
        all alike. shrink_sd : (2,) its one-sigma uncertainty.
    usual : (2,) length and width that boxes are drawn to [m].
    kinds : (4, 4) shares: what vehicles of each of `boxes.KINDS` (rows) are called (columns), on average over places;
        none where that was not measured: what they are called then tells nothing. kinds_vehicles : how much places
        differ in it: as if each had its shares from so many vehicles of a kind (`pooling.observed.Confusion`).
    """

    margin: tuple[float, float] = (0.0, 0.0)
    margin_sd: tuple[float, float] = (0.7, 0.7)
    bias_sd: tuple[float, float] = (0.015, 0.02)
    common_sd: float = 0.0
    noise: tuple[float, float] = (2.0, 1.2)
    shrink: tuple[float, float] = (0.0, 0.0)
    shrink_sd: tuple[float, float] = (0.05, 0.05)
    usual: tuple[float, float] = (4.4, 1.78)
    kinds: tuple[tuple[float, float, float, float], ...] = ()
    kinds_vehicles: float = 10.0

    @property
    def drawing(self) -> Drawing:
        """How the detector draws sizes, for `mixture`."""
        return Drawing(np.asarray(self.shrink), np.asarray(self.shrink_sd), np.asarray(self.usual))

    @property
    def confusion(self) -> Confusion | None:
        """How far what vehicles are called is what they are, for `mixture`; None where that is not known."""
        return Confusion(np.asarray(self.kinds), self.kinds_vehicles) if self.kinds else None
