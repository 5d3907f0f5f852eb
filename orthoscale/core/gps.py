"""The scale of a reconstruction by the GPS positions of its frames: a similarity transform from camera centres to
metres.

Only horizontal positions count: a drone's heights come from a barometer. The errors of one receiver are not independent
of one another: they wander within seconds to tens of minutes, and a slow part of them stretches a flight without
showing in the residuals. So every position has a white error and a wandering one (Gauss-Markov: covariance is variance
times exp(-time / memory), alike in east and north), and all likely sizes and memories of the two are weighted by the
likelihood of the residuals. The scale is that of least squares, which does not depend on them; its sigma is the
weighted root mean square of what those errors do to it, and more where the residuals are larger than a receiver's
(RECEIVERS).

A model may be bent: a bowl or a dome, which self-calibration makes of a flat block. Then its cameras are closer
together or further apart than on a flat one, and their scale is not that of the ground below them. How far the tracks
leave that open is known (`sources.focal`), and the altitudes of a drone, compared with the heights of its cameras, show
it.
"""

from __future__ import annotations

import numpy as np

from .control import LEVEL_SD
from .evidence import BY_GPS, Evidence

FEWEST_POSITIONS = 6  # fewest that must fit: the four parameters of a similarity from twelve numbers; a judgement
# Residuals along one axis that a receiver may cause [m]: drones hover by GPS within that (DJI's specifications, from
# Phantom 4 on). Larger ones have another cause, and may not average out: positions of `weedon` lag behind its pictures,
# the more the faster it flies.
RECEIVERS = 1.5
# One sigma of the wandering error, along one axis [m]. The least is a judgement: it keeps the intervals of the shortest
# flights honest.
WANDERS = (0.3, 0.6, 1.2, 2.4, 4.8)
# Its memories [s]: positions of single-frequency receivers are correlated in time as in an Ornstein-Uhlenbeck process
# (doi:10.3390/s20216050), GPS errors over some 20 min (El-Rabbany and Kleusberg 2003); the shorter ones are those of
# filters, and of positions that lag behind.
MEMORIES = (10.0, 60.0, 300.0, 1200.0)
WHITES = (0.02, 0.1, 0.3, 1.0, 3.0, 10.0)  # one sigma of the white error [m]: from RTK to rounded degrees
ODD = 6.0  # robust sigmas along one axis from which a position is a mistake ...
ORDINARY = 10.0  # ... if it is at least so far off [m]: those of `weedon` lag by up to 7 m, and are no mistakes
MOST_ODD = 0.25  # share of mistakes above which none of the positions is believed
REWEIGHTED = 20  # iterations of the robust fit; it settles in fewer
MEDIAN_OF_TWO = float(np.sqrt(2 * np.log(2)))  # median length of a 2D normal error, in sigmas of one axis (Rayleigh)
MOST_SD = 0.1  # relative one sigma of the scale from which positions say nothing: they may be of another flight
# Root mean square distance of the positions from their middle, below which they say nothing [m]: several RECEIVERS, and
# the decimetres between antenna and camera, which no residual shows. A judgement.
LEAST_EXTENT = 10.0
BY_ROUNDING = 1e-6  # relative size of what differs by rounding only
# Altitudes are mirrored if with the other sign, from some height down, they vary less against the cameras' heights than
# this share of how they do as told. A judgement: errors alone do so in one flight at one height of 3,000 with twelve
# frames, of 30 with six.
MIRRORED = 0.25
UNFIT = "they do not fit its cameras"


def by_positions(units: np.ndarray, metres: np.ndarray, seconds: np.ndarray) -> tuple[Evidence | None, str]:
    """The scale of the similarity transform between camera centres (N, 2) [units] and their positions (N, 2) [m], both
    horizontal, east or x first; or None, and the reason ('' where there are too few to speak of).

    seconds : (N,) when each frame was taken. Positions that several frames share are stale or rounded, and are left
    out. Where some are mistakes, their share is the probability that the evidence is false.
    """
    fresh = _fresh(metres)
    units, metres, seconds = units[fresh], metres[fresh], seconds[fresh]
    if len(units) < FEWEST_POSITIONS:
        return None, ""
    a, b = (np.asarray(p, float) @ (1, 1j) for p in (units, metres))
    if np.std(b) < LEAST_EXTENT:
        return None, f"they lie within {2 * np.std(b):.0f} m"
    fits = _fitting(a, b)
    mistakes = float((~fits).mean())
    if mistakes > MOST_ODD or fits.sum() < FEWEST_POSITIONS:
        return None, UNFIT
    value, sd = _scale(a[fits], b[fits], seconds[fits])
    sd = float(np.hypot(sd, LEVEL_SD))
    if not sd < MOST_SD:
        return None, UNFIT
    says = f"GPS positions of {int(fits.sum())} frames"
    return Evidence(BY_GPS, value, sd, says, doubt=mistakes), ""


def _fresh(metres: np.ndarray) -> np.ndarray:
    """(N,) bool: which of the positions only one frame has."""
    _, which, count = np.unique(metres, axis=0, return_inverse=True, return_counts=True)
    return count[which.ravel()] == 1


def _fitting(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N,) bool: which of the positions `b`, complex, fit the places `a`, by the similarity transform with the least
    sum of distances, found by reweighting (Weiszfeld 1937)."""
    weight = np.ones(len(a))
    for _ in range(REWEIGHTED):
        x, y = a - np.average(a, weights=weight), b - np.average(b, weights=weight)
        factor = np.vdot(x, weight * y) / max(np.vdot(x, weight * x).real, np.finfo(float).tiny)
        off = np.abs(y - factor * x)
        typical = max(float(np.median(off)) / MEDIAN_OF_TWO, WHITES[0])
        weight = 1 / np.maximum(off, typical)
    return off < max(ODD * typical, ORDINARY)


def mirrored(places: np.ndarray, heights: np.ndarray, altitudes: np.ndarray) -> bool:
    """Whether the `altitudes` of all cameras, or of the lowest ones, rise where the `heights` fall: some programs lose
    the sign of altitudes below the sea.

    places, heights, altitudes : as in `bend`; the upward axis may be tilted.
    """
    level = np.column_stack([np.ones(len(places)), places])
    number = np.argsort(np.argsort(heights))[:, None]  # of each camera, from the lowest
    signed = np.where(number < np.arange(len(heights) + 1), -1, 1) * altitudes[:, None]  # below the sea: 0, 1 ... all
    off = heights[:, None] - signed
    varies = np.linalg.norm(off - level @ (np.linalg.pinv(level) @ off), axis=0)
    return bool(varies.min() < MIRRORED * varies[0])


def bend(
    places: np.ndarray,
    heights: np.ndarray,
    altitudes: np.ndarray | None,
    seconds: np.ndarray,
    above: float,
    open_sd: float,
) -> tuple[float, float]:
    """By how much the scale at the cameras of a bent model exceeds that on the ground, relatively; and its one sigma.

    It is the curvature of the surface that cameras at one altitude lie on in the model, times their height `above` the
    ground [m]: positive in a bowl. places : (N, 2) cameras from above [m]. heights : (N,) along the model's upward axis
    [m]. altitudes : (N,) as the drone tells them, from any level [m], or None; equal ones tell nothing. open_sd : its
    one sigma by the tracks alone, about 0.
    """
    if altitudes is None or not np.ptp(altitudes) > 0 or not open_sd > 0:
        return 0.0, open_sd
    axes, size, _ = np.linalg.svd(places - places.mean(0), full_matrices=False)
    level = np.column_stack([np.ones(len(places)), axes[:, size > BY_ROUNDING * size[0]]])
    bowl = ((places - places.mean(0)) ** 2).sum(1) / 2
    bowl_alone = bowl - level @ (np.linalg.pinv(level) @ bowl)
    if not np.linalg.norm(bowl_alone) > BY_ROUNDING * np.linalg.norm(bowl):  # a circle shows no bowl
        return 0.0, open_sd
    curvature, variance = _first(np.column_stack([bowl_alone, level]), heights - altitudes, seconds)
    sd = above * float(np.sqrt(variance))
    weight = open_sd**2 / (open_sd**2 + sd**2)
    return float(weight * above * curvature.real), float(np.sqrt(weight) * sd)


def _scale(a: np.ndarray, b: np.ndarray, seconds: np.ndarray) -> tuple[float, float]:
    """The scale of the least-squares similarity from `a` to `b`, complex; and its relative one sigma."""
    factor, variance = _first(np.stack([a - a.mean(), np.ones(len(a))], 1), b, seconds)
    scale = float(abs(factor))
    return scale, float(np.sqrt(variance)) / scale


def _first(design: np.ndarray, b: np.ndarray, seconds: np.ndarray) -> tuple[complex, float]:
    """The first coefficient of the least-squares fit of `design` (N, K) to `b` (N,); and its variance, averaged over
    all likely errors. Complex numbers have two axes with errors alike, real ones have one."""
    inverse_design, axes_of_b = np.linalg.pinv(design), 2 if np.iscomplexobj(b) else 1
    take = inverse_design[0]  # weight of each value in the coefficient
    apart = np.abs(seconds[:, None] - seconds)
    found = []
    for memory in MEMORIES:
        size, axes = np.linalg.eigh(np.exp(-apart / memory))
        x, y, share = axes.T @ design, axes.T @ b, np.abs(take @ axes) ** 2
        for wander in WANDERS:
            for white in WHITES:
                variance = np.maximum(wander**2 * size, 0) + white**2
                whitened = x / variance[:, None]
                inverse = np.linalg.inv(x.conj().T @ whitened)
                off = y - x @ (inverse @ (whitened.conj().T @ y))
                # Log likelihood of the residuals (restricted maximum likelihood).
                log = axes_of_b * (np.linalg.slogdet(inverse)[1] - np.log(variance).sum())
                found.append(((log - (np.abs(off) ** 2 / variance).sum()) / 2, share @ variance))
    log, variance = np.array(found).T
    weight = np.exp(log - log.max())
    rest = float((np.abs(b - design @ (inverse_design @ b)) ** 2).mean()) / axes_of_b
    strange = max(rest - RECEIVERS**2, 0.0) * len(b) * float((np.abs(take) ** 2).sum())
    return complex(take @ b), float(weight @ variance / weight.sum() + strange)
