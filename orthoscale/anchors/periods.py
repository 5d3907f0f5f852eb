"""The period of objects in a row: positions on a line, of which some are missing and some are outliers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln, stdtrit

from ..core.normal import Z90

NEAR_PLACE = 0.12  # of the period: a thing farther from its place does not belong to the row
ROW_ROUNDS = 3  # of fitting, each with the things that the one before found near the row
FINEST_SCATTER = 0.005  # of the period: a smaller scatter is luck, as nothing is built or measured more exactly
MISSING_IN_A_ROW = 2  # most in succession; beyond, another row begins


@dataclass(frozen=True)
class Row:
    """A row of things. period : [px]. start : the place of number 0 [px]. member : (M,) indices of the things. number :
    (M,) their numbers in the row, ascending, from 0. residual : (M,) their distances from their places [px]. sd : of
    the period [px], that of the normal distribution with the same 90 % interval.
    strays : how many more things were near a place but were left out.
    """

    period: float
    start: float
    member: np.ndarray
    number: np.ndarray
    residual: np.ndarray
    sd: float
    strays: int = 0

    @property
    def filled(self) -> float:
        """Share of the row's places that are taken."""
        return len(self.number) / (self.number[-1] + 1)

    @property
    def scatter(self) -> float:
        """Root mean square of the residuals for two fitted parameters, as a share of the period."""
        return float(np.sqrt((self.residual**2).sum() / max(len(self.residual) - 2, 1))) / self.period

    @property
    def regularity(self) -> float:
        """Natural logarithm of the likelihood ratio of a row to chance, which seldom puts so many things so near their
        places.

        By chance a thing lies anywhere within NEAR_PLACE of its place, with one sigma of NEAR_PLACE / sqrt(3). Chance
        has as many tries as there are choices of the strays.
        """
        n = len(self.number)
        tries = gammaln(n + self.strays + 1) - gammaln(n + 1) - gammaln(self.strays + 1)
        return float((n - 2) * np.log(NEAR_PLACE / np.sqrt(3) / max(self.scatter, FINEST_SCATTER)) - tries)


def find_row(place: np.ndarray, low: float, high: float, fewest: int) -> Row | None:
    """The best row in `place` (N,) [px] with a period from `low` to `high` [px]; None if it has fewer than `fewest`
    things.

    The three strongest values of the spectrum, the sum of exp(2 pi i place / period), give first guesses of the period;
    least squares over the numbered places follow. A row ends where more than two things in succession are missing. A
    stripe half under a vehicle is seen beside its place: such strays are left out where that makes the row more
    regular.
    """
    if len(place) < fewest:
        return None
    middle = np.median(place)
    off = place - middle
    span = max(float(np.ptp(place)), low)
    rate = np.arange(1 / high, 1 / low, 1 / (6 * span))
    spectrum = np.exp(2j * np.pi * off[:, None] * rate).sum(0)
    best = None
    for k in np.argsort(-np.abs(spectrum))[:3]:
        row = _fitted(off, 1 / rate[k], float(np.angle(spectrum[k]) / (2 * np.pi * rate[k])), fewest)
        if row is not None and low <= row.period <= high and (best is None or _worth(row) > _worth(best)):
            best = row
    if best is None:
        return None
    return replace(best, start=best.start + middle)


def _worth(row: Row) -> float:
    """How good a row is, to choose among rows of the same things: more things, fewer missing, closer to their
    places."""
    return len(row.number) * row.filled * (1 - (row.scatter / NEAR_PLACE))


def _fitted(place: np.ndarray, period: float, start: float, fewest: int) -> Row | None:
    for _ in range(ROW_ROUNDS):
        number = np.round((place - start) / period).astype(int)
        away = np.abs(place - start - period * number) / period
        near = np.flatnonzero(away < NEAR_PLACE)
        if len(near) < fewest:
            return None
        near = near[np.lexsort((away[near], number[near]))]
        near = near[np.diff(number[near], prepend=-np.inf) > 0]  # only the closest to each place
        run = np.concatenate([[0], np.cumsum(np.diff(number[near]) > MISSING_IN_A_ROW + 1)])
        near = near[run == np.bincount(run).argmax()]
        if len(near) < fewest:
            return None
        row = fit_row(place[near], number[near])
        period, start = row.period, row.start
        if period <= 0:
            return None
    return _without_strays(replace(row, member=near), place, fewest)


def _without_strays(row: Row, place: np.ndarray, fewest: int) -> Row:
    """`row` without the things farthest from the places that the others predict, as long as that makes it more
    regular."""
    while len(row.number) > fewest:
        off = row.number - row.number.mean()
        leverage = 1 / len(off) + off**2 / (off**2).sum()
        rest = np.delete(np.arange(len(off)), np.argmax(np.abs(row.residual) / np.maximum(1 - leverage, 1e-6)))
        if np.diff(row.number[rest]).max() > MISSING_IN_A_ROW + 1:
            break
        fewer = fit_row(place[row.member[rest]], row.number[rest], row.strays + 1)
        fewer = replace(fewer, member=row.member[rest])
        if fewer.regularity <= row.regularity:
            break
        row = fewer
    return row


def fit_row(place: np.ndarray, number: np.ndarray, strays: int = 0) -> Row:
    """The row of all things at `place` (M,) [px] with known numbers (M,), by least squares; `strays` more were left
    out."""
    k = number - number[0]
    spread = ((k - k.mean()) ** 2).sum()
    period = float(((k - k.mean()) * place).sum() / spread)
    start = float(place.mean() - period * k.mean())
    residual = place - start - period * k
    free = max(len(k) - 2, 1)
    sd = float(np.sqrt((residual**2).sum() / free / spread))
    # Student's t, since few things may happen to scatter too little. A stray that did belong to the row takes its
    # scatter with it: without the last factor, intervals of simulated rows with a stray hold the period in 30 to 60 %.
    sd *= float(stdtrit(free, 0.95)) / Z90 * (1 + strays)
    return Row(period, start, np.arange(len(k)), k, residual, sd, strays)
