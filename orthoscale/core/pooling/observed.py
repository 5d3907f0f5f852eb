"""What is seen of vehicles, and how a detector distorts it: sizes are drawn to the usual, kinds are confused.

Detectors draw vehicles as the usual vehicle that they expect, more or less: small ones too large, large ones too small.
So the classes are compared with boxes as the detector draws them (`Drawing`), and how strongly it does is one more
unknown: classes that stand apart (kei and ordinary cars) tell it.

What vehicles are called (car, pickup, van, larger) tells classes apart that sizes confuse: a street of pickups from one
of cars at another scale. How often a detector is mistaken differs from place to place, and all vehicles of a place have
that in common. So what those of each class are called is fitted like the shares of the classes, about what the
detector's card says (`Confusion`): a hundred vehicles do not overrule what ten of them would leave open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..boxes import KINDS
from ..market_segments import Class

# Of the vehicles of a kind, how many are called any kind however good the card's table is: readings have mistakes too.
CALLED_ANYTHING = 0.02


@dataclass(frozen=True)
class Drawing:
    """How a detector draws sizes: log box = log vehicle + share * (log usual - log vehicle), and the margin.

    share, share_sd : (2,) of length and width, 0 for a faithful detector, and one sigma; both stray as one.
    usual : (2,) length and width that boxes are drawn to [m].
    """

    share: np.ndarray
    share_sd: np.ndarray
    usual: np.ndarray

    def log_mean(self, part: Class) -> np.ndarray:
        """(2,) of the boxes of a class, their margin taken off."""
        return part.log_mean + self.share * (np.log(self.usual) - part.log_mean)

    def covariance(self, covariance: np.ndarray) -> np.ndarray:
        """(2, 2) of boxes, in logarithms, where that of vehicles is `covariance`."""
        return covariance * np.outer(1 - self.share, 1 - self.share)

    def slope(self, part: Class) -> np.ndarray:
        """(2,) change of `log_mean` for one sigma of the share."""
        return self.share_sd * (np.log(self.usual) - part.log_mean)


FAITHFUL = Drawing(np.zeros(2), np.zeros(2), np.ones(2))


@dataclass(frozen=True)
class Confusion:
    """What vehicles are called, when they are of a kind: a measurer's confusion table, and how it holds at a place.

    table : (4, 4) shares; what vehicles of each of `boxes.KINDS` (rows) are called (columns), on average over places.
    vehicles : a place has shares of its own, as if it had them from so many vehicles (a Dirichlet distribution: one
        sigma of a share p is the root of p (1 - p) / (vehicles + 1)).
    """

    table: np.ndarray
    vehicles: float

    @property
    def shares(self) -> np.ndarray:
        """(4, 4) `table` as it is believed; its rows sum to one."""
        return (1 - CALLED_ANYTHING) * self.table / self.table.sum(1, keepdims=True) + CALLED_ANYTHING / len(KINDS)

    def called(self, classes: Sequence[Class]) -> np.ndarray:
        """(K, 4) what the vehicles of each class are called, as parameters of Dirichlet distributions."""
        return self.vehicles * np.array([c.kinds for c in classes]) @ self.shares


@dataclass(frozen=True)
class Seen:
    """What is seen of N vehicles.

    log_size : (N, 2) logarithms of length and width [any unit]. noise : (N, 2) their one-sigma noise [the unit].
    called : (N, 4) shares of `boxes.KINDS` that each is called, zeros where nobody looked; (N, 0) where nobody did.
    """

    log_size: np.ndarray
    noise: np.ndarray
    called: np.ndarray

    def __len__(self) -> int:
        return len(self.log_size)

    def __getitem__(self, some: np.ndarray) -> Seen:
        return Seen(self.log_size[some], self.noise[some], self.called[some])
