"""The fit of a court's strokes to the centres of bright lines, in the picture's own pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..core.normal import ROBUST_SD
from .court_models import Court
from .court_ridges import BESIDE, BLURRED_SD, FINE_SD, FINE_SIGHT, LINE_SD, WIDE_SIGHT, Cut, Sight, measure, moved

WINDOWS = (0.9, 0.65, 0.5, 0.4)  # [m] about a stroke where its paint is looked for, round by round
LEAST_WINDOW = 1.3  # [px] but never closer than this
FINE_BELOW = 3.6  # [px] strokes that are closer are measured by the finer filter
SHARPEST, BLUNTEST = 0.3, 1.2  # [px] limits of one sigma of a thin line as blurred by lens and pixels
FINE_ROUNDS = 2  # of measuring by the fine filter
CLOSE = 0.16  # [m] and [px]: a stroke is seen where a ridge is this close to it
CLOSE_PX = 0.6
WEIGHED = 1.5, 4.5  # [sigmas of the noise] strengths of ridges from which their weight is 0 and 1
CLEAR_NOISES = 2.5  # [sigmas of the noise] a stronger ridge is real; it is that of a stroke ...
FAINT = 0.25  # ... if it has this share of the typical stroke's strength;
MARRING = 0.5  # with this share it contradicts a blank
FEWEST_PIECES = 12  # number of pieces on ridges that a fit needs
HOPELESS = 0.45  # least share of pieces on ridges after the first round: with less the fit is given up
FEWEST_HITS = 9  # number of pieces on ridges from which a fit's scatter is known
LEAST_SD = 0.01  # [m] least scatter of the ridges about a fit
# Parts of a pose: place along and across [m], angle [rad], pixels per metre along and across [ln].
PRIOR_SD = np.array([5, 5, 0.5, 0.1, 0.1])  # one sigma by which a round may change them ...
MOST_CHANGE = np.array([1, 1, 0.1, 0.2, 0.2])  # ... and the most
RIDGE_SD = 0.05  # [m] one sigma of a ridge about its stroke, against which that prior is weighed
NOT_ASTRAY = 0.02  # [m] least one sigma about a fit by which its outliers are judged
OTHER_SIZE = 0.25  # [ln] by which a fitted size may differ from the one that was searched for
CUT_OUT, CUT_OUT_PX = 0.6, 8  # [extents of the court] and [px] from its centre: beyond, the picture is not needed


@dataclass(frozen=True)
class CourtFit:
    """court : what was fitted. place : (2,) its centre [px]. angle : of its length [rad] from +x, clockwise on screen.
    along, across : pixels per metre. along_sd, across_sd : their relative one sigma, by the scatter about the fit
    alone.
    residual : (M,) distances of the ridges found from their strokes, across these [px]. lit : share of the painted
    length that lies on ridges. seen : (S,) that share of each stroke. marred : share of the blank places that ridges
    cross.
    scatter : root mean square of `residual`, as a share of its limit; 0.58 for ridges at random places."""

    court: Court
    place: np.ndarray
    angle: float
    along: float
    across: float
    along_sd: float
    across_sd: float
    residual: np.ndarray
    lit: float
    seen: np.ndarray
    marred: float
    scatter: float

    def points(self, metres: np.ndarray) -> np.ndarray:
        """(..., 2) [px] of points (..., 2) of the court [m]."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return self.place + metres * (self.along, self.across) @ np.array([[c, s], [-s, c]])


def _solve(rows: np.ndarray, offset: np.ndarray, weight: np.ndarray, width: float) -> np.ndarray:
    """The change (5,) of the pose that solves offset [m] = rows @ change by robust least squares (Tukey's weights)."""
    held = np.diag((RIDGE_SD / PRIOR_SD) ** 2)
    change = np.zeros(rows.shape[1])
    scale = width / 2
    robust = weight
    for _ in range(8):
        left = offset - rows @ change
        robust = np.clip(1 - (left / (3 * scale)) ** 2, 0, None) ** 2 * weight
        by = rows * robust[:, None]
        change = np.linalg.solve(by.T @ rows + held, by.T @ offset)
        left = np.abs(offset - rows @ change)
        # Under these weights the mean of a normal distribution's residuals gives a scale of 0.91 sigma: the weights end
        # at 2.7 sigma. A factor of 1.563 would give one sigma; it changed 252 courts on chips by 0.01 % (rms).
        scale = float(np.clip(ROBUST_SD * np.average(left, weights=robust + 1e-9), NOT_ASTRAY, width / 2))
    return change


def fit_court(
    light: np.ndarray, grey: np.ndarray, court: Court, place: np.ndarray, angle: float, size: float
) -> CourtFit | None:
    """The court fitted near `place` [px], `angle` [rad] and `size` [px/m]; None where too little of it is seen for a
    fit, or the fitted size differs too much from `size`. There are two pictures, (H, W) float32 [grey levels]: the
    court is found in `light`, in which paint stands out. Where its strokes are a few pixels apart it is then measured
    in `grey`, plain brightness, which JPEG keeps at full resolution, unlike colours."""
    cut = Cut.of(court, size)
    reach = court.extent * size * CUT_OUT + CUT_OUT_PX
    corner = np.maximum(np.floor(place - reach), 0).astype(int)
    upper = np.maximum(np.ceil(place + reach), 0).astype(int)
    light, grey = (np.ascontiguousarray(each[corner[1] : upper[1], corner[0] : upper[0]]) for each in (light, grey))
    if not light.size:  # OpenCV would sample memory beyond it
        return None
    pose = np.array([*(place - corner), angle, size, size])
    for window in WINDOWS:
        now = float(np.sqrt(pose[3] * pose[4]))
        window_px = max(window * now, LEAST_WINDOW)
        if window in WINDOWS[:2]:
            noise = measure(light, pose, cut.blanks, CLOSE_PX, WIDE_SIGHT).noise()
        bands = measure(light, pose, cut.pieces, window_px, WIDE_SIGHT)
        offset, strength = bands.peaks(window_px)
        weight = _weights(strength, noise)
        if (weight > 0).sum() < FEWEST_PIECES or (
            window < WINDOWS[0] and (strength > CLEAR_NOISES * noise).mean() < HOPELESS
        ):
            return None
        offset = offset - moved(cut, bands, offset, strength, (size, now), WIDE_SIGHT)
        pose = _changed(pose, _solve(cut.rows, offset / now, weight, window_px / now))
        if not (np.abs(np.log(pose[3:] / size)) < OTHER_SIZE).all():
            return None
    sight = WIDE_SIGHT
    if np.abs(cut.neighbours[1]).min(initial=BESIDE) * now < FINE_BELOW:
        pose, sight = _finer(grey, cut, pose)
    return _judged(light, cut, pose, corner, sight)


def _finer(grey: np.ndarray, cut: Cut, pose: np.ndarray) -> tuple[np.ndarray, Sight]:
    """The pose by a narrower filter, which neighbouring strokes disturb less but noise more, and the `Sight` it
    has."""
    window = max(WINDOWS[-1] * cut.size, LEAST_WINDOW)
    _, coarse = measure(grey, pose, cut.pieces, window, WIDE_SIGHT).peaks(window)
    for _ in range(FINE_ROUNDS):
        noise = measure(grey, pose, cut.blanks, CLOSE_PX, FINE_SIGHT).noise()
        bands = measure(grey, pose, cut.pieces, window, FINE_SIGHT)
        offset, strength = bands.peaks(window)
        weight = _weights(strength, noise)
        sight = replace(FINE_SIGHT, blurred=_blurred(cut, coarse, strength, weight))
        now = float(np.sqrt(pose[3] * pose[4]))
        offset = offset - moved(cut, bands, offset, strength, (cut.size, now), sight)
        pose = _changed(pose, _solve(cut.rows, offset / now, weight, window / now))
    return pose, sight


def _blurred(cut: Cut, coarse: np.ndarray, fine: np.ndarray, weight: np.ndarray) -> float:
    """One sigma [px] of a thin line as blurred by lens and pixels, from the ratio of its ridges' strengths (P,) in the
    coarse filter and in the fine one: see LINE_SEEN. Pieces beside other strokes are left out."""
    alone = np.ones(len(fine), bool)
    alone[cut.neighbours[0]] = False
    clear = alone & (weight > 0.5) & (coarse > 0)
    if clear.sum() < FEWEST_PIECES:
        return BLURRED_SD
    share = (float(np.median(coarse[clear] / fine[clear])) * (FINE_SD / LINE_SD) ** 2) ** (2 / 3)
    variance = (FINE_SD**2 - share * LINE_SD**2) / (share - 1) if share < 1 else BLUNTEST**2
    return float(np.sqrt(np.clip(variance, SHARPEST**2, BLUNTEST**2)))


def _weights(strength: np.ndarray, noise: float) -> np.ndarray:
    """(P,) weights of ridges, from 0 to 1, see WEIGHED."""
    low, high = WEIGHED
    return np.clip((strength / noise - low) / (high - low), 0, 1)


def _changed(pose: np.ndarray, change: np.ndarray) -> np.ndarray:
    """The pose after a `change` of `_solve`, which is limited to MOST_CHANGE."""
    change = np.clip(change, -MOST_CHANGE, MOST_CHANGE)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    place = pose[:2] + change[0] * pose[3] * np.array([c, s]) + change[1] * pose[4] * np.array([-s, c])
    return np.array([*place, pose[2] + change[2], *(pose[3:] * np.exp(change[3:]))])


def _judged(light: np.ndarray, cut: Cut, pose: np.ndarray, corner: np.ndarray, sight: Sight) -> CourtFit:
    """How much of the court is seen at its fitted `pose` in `light`, whose upper left pixel is `corner` in the
    picture."""
    court, pieces = cut.court, cut.pieces
    size = float(np.sqrt(pose[3] * pose[4]))
    close = max(CLOSE * size, CLOSE_PX)
    empty = measure(light, pose, cut.blanks, close, sight)
    noise = empty.noise()
    bands = measure(light, pose, pieces, max(2 * close, LEAST_WINDOW), sight)
    offset, strength = bands.peaks(max(2 * close, LEAST_WINDOW))
    offset = offset - moved(cut, bands, offset, strength, (size, size), sight)
    strong = strength[(strength > CLEAR_NOISES * noise) & (np.abs(offset) <= close)]
    typical = float(np.median(strong)) if len(strong) else 0.0
    limit = max(CLEAR_NOISES * noise, FAINT * typical)
    hit = (strength > limit) & (np.abs(offset) <= close)
    count = np.bincount(pieces.stroke, minlength=len(court.strokes))
    seen = np.bincount(pieces.stroke, hit, len(court.strokes)) / count
    across = empty.response[:, np.abs(empty.offset) <= close].max(1)
    marring = max(CLEAR_NOISES * noise, MARRING * typical)
    marred = float((across > marring)[empty.inside].mean()) if empty.inside.any() else 1.0
    sds, scatter = np.ones(2), 1.0
    if hit.sum() >= FEWEST_HITS:
        left = offset[hit] / size
        by = cut.rows[hit]
        covariance = np.linalg.pinv(by.T @ by) * max(float((left**2).mean()), LEAST_SD**2)
        sds = np.sqrt(np.maximum(np.diag(covariance)[3:], 0))  # nearly 0 in a direction that no stroke measures
        scatter = float(np.sqrt((offset[hit] ** 2).mean())) / close
    return CourtFit(
        court,
        corner + pose[:2], float(pose[2]), float(pose[3]), float(pose[4]), float(sds[0]), float(sds[1]),
        offset[hit], float(np.average(hit, weights=pieces.weight)), seen, marred, scatter,
    )  # fmt: skip
