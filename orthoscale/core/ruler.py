"""How a detector's boxes relate to vehicles: the ruler, from the detector's card or a calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .pooling.observed import Confusion, Shrinkage


@dataclass(frozen=True)
class Ruler:
    """How a detector's boxes relate to vehicles: length_px = vehicle + margin[0], and the same for the width.

    margin : (2,) excess of box length and width over the vehicle [detector px].
    margin_sd : (2,) its one-sigma uncertainty [detector px].
    bias_sd : (2,) relative uncertainty of box length and width that no number of boxes removes (labels, paint, shade).
    common_sd : the part of that which lengths and widths share: all boxes of a scene a little too large, or too small.
    noise : (2,) one-sigma noise of one box's length and width [detector px].
    shrink : (2,) shrinkage of a box's length and width, from the vehicle's towards the usual vehicle's: log box = log
        vehicle + shrink * (log usual - log vehicle), then the margin; 0 for a faithful detector, 1 for one that makes
        all alike. shrink_sd : (2,) its one-sigma uncertainty.
    usual : (2,) length and width towards which boxes shrink [m].
    kinds : (4, 4) confusion matrix of shares: what vehicles of each of `boxes.KINDS` (rows) are called (columns), on
        average over places; empty if it was not measured: the kinds are then not used. kinds_vehicles : how much places
        differ in it: as if each place's shares came from so many vehicles of a kind (`pooling.observed.Confusion`).
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
    def shrinkage(self) -> Shrinkage:
        """The detector's shrinkage, for `mixture`."""
        return Shrinkage(np.asarray(self.shrink), np.asarray(self.shrink_sd), np.asarray(self.usual))

    @property
    def confusion(self) -> Confusion | None:
        """How the detector confuses kinds of vehicles, for `mixture`; None if that is not known."""
        return Confusion(np.asarray(self.kinds), self.kinds_vehicles) if self.kinds else None
