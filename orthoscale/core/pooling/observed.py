"""What is seen of vehicles, and how a detector distorts it: sizes shrink towards the usual one, kinds are confused.

Detectors draw every vehicle a little like the usual one that they expect: small ones too large, large ones too small.
So the sizes of classes are shrunk in the same way before they are compared with boxes (`Shrinkage`). How strongly the
detector shrinks is one more unknown: classes of distinct sizes (kei and ordinary cars) determine it.

What vehicles are called (car, pickup, van, larger) tells classes apart that sizes confuse: a street of pickups from one
of cars at another scale. How often a detector is mistaken differs from place to place, and all vehicles of a place have
that in common. So the shares of each class that are called each kind are fitted like the shares of the classes, about
those on the detector's card (`Confusion`): a hundred vehicles do not settle what ten of them would leave open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..boxes import KINDS
from ..evenly import evenly
from ..market_segments import Class

# Share of a kind's vehicles that are called any kind at random, however good the card's table: the readings by which it
# was made contain mistakes too.
CALLED_ANYTHING = 0.02


@dataclass(frozen=True)
class Shrinkage:
    """A detector's shrinkage: log box = log vehicle + share * (log usual - log vehicle), and then the margin.

    share : (2,) of length and width, 0 for a faithful detector. share_sd : (2,) one sigma; the errors of the two are
        fully correlated.
    usual : (2,) length and width towards which boxes shrink [m].
    """

    share: np.ndarray
    share_sd: np.ndarray
    usual: np.ndarray

    def log_mean(self, part: Class) -> np.ndarray:
        """(2,) mean log length and log width of the boxes of a class, without the margin."""
        return part.log_mean + self.share * (np.log(self.usual) - part.log_mean)

    def covariance(self, covariance: np.ndarray) -> np.ndarray:
        """(2, 2) covariance of boxes, in logarithms, from the `covariance` of the vehicles."""
        return covariance * np.outer(1 - self.share, 1 - self.share)

    def slope(self, part: Class) -> np.ndarray:
        """(2,) change of `log_mean` for one sigma of the share."""
        return self.share_sd * (np.log(self.usual) - part.log_mean)


FAITHFUL = Shrinkage(np.zeros(2), np.zeros(2), np.ones(2))


@dataclass(frozen=True)
class Confusion:
    """What vehicles of each kind are called: a measurer's confusion matrix, and how far it holds at one place.

    table : (4, 4) shares; what vehicles of each of `boxes.KINDS` (rows) are called (columns), on average over places.
    vehicles : a place has shares of its own, as if they came from so many vehicles (a Dirichlet distribution: one sigma
        of a share p is the root of p (1 - p) / (vehicles + 1)).
    """

    table: np.ndarray
    vehicles: float

    @property
    def shares(self) -> np.ndarray:
        """(4, 4) `table` with CALLED_ANYTHING; its rows sum to one."""
        return (1 - CALLED_ANYTHING) * self.table / self.table.sum(1, keepdims=True) + CALLED_ANYTHING / len(KINDS)

    def called(self, classes: Sequence[Class]) -> np.ndarray:
        """(K, 4) parameters of the Dirichlet distributions of what the vehicles of each class are called."""
        return self.vehicles * np.array([c.kinds for c in classes]) @ self.shares


@dataclass(frozen=True)
class Seen:
    """What is seen of N vehicles, and how the detector distorts it.

    log_size : (N, 2) logarithms of length and width [any unit]. noise : (N, 2) one-sigma noise of the sizes [the unit].
    called : (N, 4) probability of each of `boxes.KINDS`, zeros where it was not assessed; (N, 0) if it never was.
    shrinkage : of the sizes. confusion : of the kinds; needed where these were assessed.
    """

    log_size: np.ndarray
    noise: np.ndarray
    called: np.ndarray
    shrinkage: Shrinkage = FAITHFUL
    confusion: Confusion | None = None

    def __len__(self) -> int:
        return len(self.log_size)

    def __getitem__(self, some: np.ndarray) -> Seen:
        return replace(self, log_size=self.log_size[some], noise=self.noise[some], called=self.called[some])

    def few(self, number: int) -> Seen:
        """`number` of them, evenly chosen, or all if there are no more."""
        return self[evenly(len(self), number)]
