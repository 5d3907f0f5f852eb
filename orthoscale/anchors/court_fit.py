"""The fit of a court's strokes to the centres of bright lines, in the picture's own pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from ..core.normal import ROBUST_SD
from .court_models import PARALLEL_STROKES, Court, Pieces
from .peaks import peak_shift
from .ridges import ridge_noise

WINDOWS = (0.9, 0.65, 0.5, 0.4)  # [m] about a stroke where its paint is looked for, round by round
LEAST_WINDOW = 1.3  # [px] but never closer than this
PAINT_SD = 0.05  # [m] one sigma of the ridge filter, by the width of the paint ...
LINE_SD = 0.75  # [px] ... but at least this, by the blur of a camera, where strokes are searched ...
FINE_SD, FINE_BELOW = 0.6, 3.6  # [px] ... and this where strokes closer than the second are measured
BLURRED_SD = 0.7  # [px] one sigma of a thin line as blurred by lens and pixels, typically ...
SHARPEST, BLUNTEST = 0.3, 1.2  # [px] ... and its limits
# A line of strength A on a step of height B, both blurred to variance v, has its ridge at u sqrt(v) from the line,
# where B sqrt(v) / A = (3 u - u^3) / (1 - u^2). That ridge is exp(-u^2 / 2) (1 - u^2 + u B sqrt(v) / A) times that of
# the line alone; the filter of `_kernel`, of variance s, responds to the line with 1.033 s A / (v sqrt(2 pi v)).
_LEANING = np.linspace(0, 0.9, 91)
_STEP = (3 * _LEANING - _LEANING**3) / (1 - _LEANING**2)
_STEP_SEEN = _STEP / (np.exp(-0.5 * _LEANING**2) * (1 - _LEANING**2 + _LEANING * _STEP))
LINE_SEEN = 1.033 / np.sqrt(2 * np.pi)
# A line as thin as a pixel is sampled too coarsely to locate it exactly (aliasing): one along rows or columns appears
# nearer to the centres of pixels than it is, by up to a tenth of a pixel. The shift is a sine of the position within
# the pixel. On 61 chips of 0.30, 0.41 and 0.50 m/px its amplitude is 0.039, 0.094 and 0.111 px; `_pull` gives 0.039,
# 0.089 and 0.101.
PHASES = 8  # positions of a line within a pixel from which its pull is computed
PULL_REACH = 1.5  # [px] from the line within which its ridge is searched
PULL_ROUNDS = 2
GROUND_FROM, GROUND_TO = 1.5, 2.8  # [sd of the filter] from a line: where the ground beside it is sampled
# Share of a step of the ground beside a stroke that is taken to lie under it, for each filter: the best of a few values
# on 61 chips.
UNDER_STROKE, FINE_UNDER_STROKE = 0.8, 1.0
FINE_ROUNDS = 2  # of measuring by the fine filter
FEWEST_LEANING = 4  # pieces of a stroke that show its step
BESIDE = 2.0  # [m] from a stroke within which another one may disturb it
PIECE = 1.2  # [m] length of the pieces of strokes, but at least [px]:
PIECE_PX = 5.0
FREE = 1.0  # [m] and [px] from all paint: beyond, the picture must be blank
FREE_PX = 2.2
CLOSE = 0.16  # [m] and [px]: a stroke is seen where a ridge is this close to it
CLOSE_PX = 0.6
WEIGHED = 1.5, 4.5  # [sigmas of the noise] strengths of ridges from which their weight is 0 and 1
CLEAR_NOISES = 2.5  # [sigmas of the noise] a stronger ridge is real; it is that of a stroke ...
FAINT = 0.25  # ... if it has this share of the typical stroke's strength;
MARRING = 0.5  # with this share it contradicts a blank
FEWEST_PIECES = 12  # number of pieces on ridges that a fit needs
HOPELESS = 0.45  # least share of pieces on ridges after the first round: with less the fit is given up
SAMPLES_PX = 0.8  # [px] between samples along a piece
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
    scatter : root mean square of `residual`, as a share of its limit; 0.58 for ridges at random places.
    contrast : of the paint, in units of the noise."""

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
    contrast: float

    def points(self, metres: np.ndarray) -> np.ndarray:
        """(..., 2) [px] of points (..., 2) of the court [m]."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return self.place + metres * (self.along, self.across) @ np.array([[c, s], [-s, c]])


@lru_cache(maxsize=64)
def _pieces(court: Court, length: float, free: float) -> tuple[Pieces, Pieces]:
    return court.pieces(length), court.blanks(length, free)


@dataclass(frozen=True)
class _Cut:
    """A court whose strokes are cut into pieces, for pictures of about `size` [px/m]. length : of a piece [m]. pieces :
    P pieces of the strokes, blanks : pieces where nothing is painted. rows : (P, 5) derivatives of a piece's position
    across its stroke by each part of the pose, as in `_solve`."""

    court: Court
    size: float
    length: float
    pieces: Pieces
    blanks: Pieces
    rows: np.ndarray

    @classmethod
    def of(cls, court: Court, size: float) -> _Cut:
        length = round(max(PIECE, PIECE_PX / size), 1)
        pieces, blanks = _pieces(court, length, round(max(FREE, FREE_PX / size), 1))
        u, v = pieces.middle.T
        nu, nv = -np.sin(pieces.direction), np.cos(pieces.direction)
        rows = np.stack([nu, nv, u * nv - v * nu, u * nu, v * nv], 1)
        return cls(court, size, length, pieces, blanks, rows)

    @property
    def neighbours(self) -> tuple[np.ndarray, np.ndarray]:
        """See `_neighbours`."""
        return _neighbours(self.court, self.length)


@lru_cache(maxsize=64)
def _neighbours(court: Court, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the pieces that run beside another, parallel stroke, and the distance to it, positive on the normal's
    side [m]."""
    pieces = court.pieces(length)
    along = np.stack([np.cos(pieces.direction), np.sin(pieces.direction)], -1)
    gap = pieces.middle[None] - pieces.middle[:, None]
    beside = np.abs((gap * along[:, None]).sum(-1)) <= pieces.length[:, None] / 2
    off = gap[..., 1] * along[:, None, 0] - gap[..., 0] * along[:, None, 1]
    parallel = np.abs(np.sin(pieces.direction - pieces.direction[:, None])) < PARALLEL_STROKES
    one, other = np.nonzero(beside & parallel & (np.abs(off) < BESIDE) & (pieces.stroke != pieces.stroke[:, None]))
    return one, off[one, other]


@dataclass(frozen=True)
class _Sight:
    """The ridge filter, and how the picture shows strokes. narrowest : least one sigma of the filter [px]. under :
    share of a step beside a stroke that is taken to lie under it. blurred : one sigma of a thin line as blurred by lens
    and pixels [px]."""

    narrowest: float
    under: float
    blurred: float = BLURRED_SD

    def width(self, size: float) -> float:
        """One sigma of the ridge filter [px], where a metre has `size` pixels."""
        return max(self.narrowest, PAINT_SD * size)

    def pull(self, size: float) -> float:
        """Largest shift [px] of ridges towards the centres of pixels, where a metre has `size` pixels; see `_pull`."""
        return _pull(round(self.width(size), 2), round(self.blurred, 2))


WIDE_SIGHT = _Sight(LINE_SD, UNDER_STROKE)
FINE_SIGHT = _Sight(FINE_SD, FINE_UNDER_STROKE)


def _pushed(cut: _Cut, size: float, sight: _Sight) -> np.ndarray:
    """(P,) shift [px] of the ridge of each piece by a stroke beside it: the peak of the sum of two second derivatives
    of Gaussians, to first order. It matters only where strokes are a few pixels apart."""
    one, off = cut.neighbours
    variance = sight.width(size) ** 2 + sight.blurred**2
    r = off * size
    slope = (r**3 / variance**2 - 3 * r / variance) * np.exp(-0.5 * r**2 / variance)
    return np.bincount(one, -slope * variance / 3, len(cut.pieces.length))


def _leaned(cut: _Cut, bands: _Bands, strength: np.ndarray, size: float, sight: _Sight) -> np.ndarray:
    """(P,) shift [px] of the ridge of each piece by a step of the ground under its stroke, as where a court has another
    colour than its surroundings: the peak of the sum of the second derivatives of line and step. Both are measured over
    the whole stroke, without pieces that have another stroke too near; 0 if too few are left."""
    sd = sight.width(size)
    blur = float(np.hypot(sd, sight.blurred))
    near = np.zeros(len(strength), bool)
    one, off = cut.neighbours
    near[one[np.abs(off) * size < (GROUND_TO + 1) * sd]] = True
    moved = np.zeros(len(strength))
    for number in range(len(cut.court.strokes)):
        of_stroke = cut.pieces.stroke == number
        own = of_stroke & (strength > 0) & bands.inside & ~near
        if own.sum() >= FEWEST_LEANING:
            ratio = float(np.median(bands.lean[own]) / np.median(strength[own]))
            step = sight.under * ratio * LINE_SEEN * (sd / blur) ** 2
            moved[of_stroke] = np.sign(step) * blur * np.interp(abs(step), _STEP_SEEN, _LEANING)
    return moved


@lru_cache(maxsize=64)
def _kernel(count: int, step: float, sd: float, core: int) -> np.ndarray:
    """(count, 2 core + 1): negated second derivative of a Gaussian about each of the middle offsets of a band; absolute
    values sum to 1."""
    offset = (np.arange(count) - count // 2) * step
    r = (offset[:, None] - offset[None, count // 2 - core : count // 2 + core + 1]) / sd
    kernel = (1 - r**2) * np.exp(-0.5 * r**2)
    kernel -= kernel.mean(0)
    return kernel / np.abs(kernel).sum(0)


@lru_cache(maxsize=64)
def _offsets(window: float, sd: float) -> tuple[np.ndarray, int]:
    """Offsets (O,) [px] of a band, and the number of them on either side of 0 where a filter of `sd` [px] gives
    ridges."""
    step = sd / 3
    core = int(np.ceil(window / step)) + 1
    reach = core + int(np.ceil(3.5 * sd / step))
    return np.arange(-reach, reach + 1) * step, core


@lru_cache(maxsize=64)
def _pull(sd: float, blurred: float) -> float:
    """Largest shift [px] of the ridge of a line towards the centre of a pixel (the pull): that of a line a quarter of a
    pixel beside the centre. sd : one sigma of the ridge filter, blurred : of the line [px]. Drawn lines at several
    positions within a pixel are measured as lines in pictures are."""
    phase = np.arange(PHASES) / PHASES
    pixel = np.arange(4 * PHASES)
    line = np.exp(-0.5 * ((pixel - 2 * PHASES - phase[:, None]) / blurred) ** 2)
    apart = np.repeat(line, PHASES, axis=0).astype(np.float32)  # rows enough that no line sees the next
    place = np.column_stack([np.full(PHASES, 2.0 * PHASES), (np.arange(PHASES) + 0.5) * PHASES - 0.5])
    still = np.zeros(PHASES)
    upright = Pieces(place, still + np.pi / 2, still + 1, still + 1, still.astype(int))
    bands = _measure(apart, np.array([0.0, 0.0, 0.0, 1.0, 1.0]), upright, PULL_REACH, _Sight(sd, 0.0, blurred))
    seen = -bands.peaks(PULL_REACH)[0]  # the normal points to the left
    return float(2 * np.mean((phase - seen) * np.sin(2 * np.pi * phase)))


@dataclass
class _Bands:
    """Ridge responses (P, O) across pieces at offsets (O,) [px]; inside (P,) whether the whole piece lies in the
    picture; lean (P,) by how much the ground is brighter on the normal's side [grey levels]; middle (P, I, 2) points
    along the pieces [px], normal (P, 2) to them."""

    response: np.ndarray
    offset: np.ndarray
    inside: np.ndarray
    lean: np.ndarray
    middle: np.ndarray
    normal: np.ndarray

    def noise(self) -> float:
        """One sigma of the response where nothing is painted."""
        return ridge_noise(self.response)

    def peaks(self, window: float) -> tuple[np.ndarray, np.ndarray]:
        """Offset [px] and strength (P,) of the strongest ridge within `window` [px]; strength 0 where there is none."""
        core = np.abs(self.offset) <= window
        inner = self.response[:, core]
        best = inner.argmax(1) + np.argmax(core)
        row = np.arange(len(best))
        last = len(self.offset) - 1
        left, middle, right = (self.response[row, np.clip(best + d, 0, last)] for d in (-1, 0, 1))
        peak = (middle >= left) & (middle >= right) & (best > 0) & (best < last) & self.inside
        step = self.offset[1] - self.offset[0]
        return self.offset[best] + peak_shift(left, middle, right) * step, np.where(peak, np.maximum(middle, 0), 0)

    def pulled(self, offset: np.ndarray, pull: float) -> np.ndarray:
        """(P,) shift [px] of ridges at `offset` (P,) towards the centres of pixels. It concerns only lines along rows
        or columns: along others it changes sign within a few pixels."""
        row, steepest = np.arange(len(offset)), np.abs(self.normal).argmax(1)
        middle, normal = self.middle[row, :, steepest], self.normal[row, steepest]
        moved = np.zeros(len(offset))
        for _ in range(PULL_ROUNDS):
            wave = np.sin(2 * np.pi * (middle + ((offset - moved) * normal)[:, None])).mean(1)
            moved = -pull * wave * np.sign(normal)
        return moved


def _measure(light: np.ndarray, pose: np.ndarray, pieces: Pieces, window: float, sight: _Sight) -> _Bands:
    x, y, angle, along, across = pose
    size = float(np.sqrt(along * across))
    sd = sight.width(size)
    offset, core = _offsets(window, sd)
    step, reach = offset[1] - offset[0], len(offset) // 2
    inner = int(np.clip(np.ceil(pieces.length.max() * size / SAMPLES_PX), 3, 12))
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s], [-s, c]]) * [[along], [across]]
    middle = np.array([x, y]) + pieces.middle @ turn
    step_along = np.stack([np.cos(pieces.direction), np.sin(pieces.direction)], -1) @ turn
    unit = step_along / np.hypot(*step_along.T)[:, None]
    part = (np.arange(inner) + 0.5) / inner - 0.5
    base = middle[:, None] + (pieces.length[:, None] * part)[..., None] * step_along[:, None]
    normal = np.stack([-unit[:, 1], unit[:, 0]], -1)
    grid = base[:, :, None] + offset[:, None] * normal[:, None, None]
    grid = grid.reshape(-1, len(offset), 2).astype(np.float32)
    band = cv2.remap(light, grid[..., 0], grid[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    profile = band.reshape(len(middle), inner, -1).mean(1)
    height, width = light.shape
    edge = window / 2
    inside = (
        (base[..., 0] >= edge) & (base[..., 0] <= width - 1 - edge)
        & (base[..., 1] >= edge) & (base[..., 1] <= height - 1 - edge)
    ).all(1)  # fmt: skip
    response = profile @ _kernel(len(offset), round(step, 6), round(sd, 6), core)
    beside = (np.abs(offset) >= GROUND_FROM * sd) & (np.abs(offset) <= GROUND_TO * sd)
    lean = profile[:, beside & (offset > 0)].mean(1) - profile[:, beside & (offset < 0)].mean(1)
    return _Bands(response, offset[reach - core : reach + core + 1], inside, lean, base, normal)


def _moved(
    cut: _Cut, bands: _Bands, offset: np.ndarray, strength: np.ndarray, sizes: tuple[float, float], sight: _Sight
) -> np.ndarray:
    """(P,) distance [px] of the ridges at `offset` from the true lines: pushed by other strokes and by a step of the
    ground, and pulled towards the centres of pixels. sizes : [px/m] for the pushes, and for the pull."""
    pushed, pulled = sizes
    leaned = _leaned(cut, bands, strength, pushed, sight)
    return _pushed(cut, pushed, sight) + leaned + bands.pulled(offset, sight.pull(pulled))


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
    cut = _Cut.of(court, size)
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
            noise = _measure(light, pose, cut.blanks, CLOSE_PX, WIDE_SIGHT).noise()
        bands = _measure(light, pose, cut.pieces, window_px, WIDE_SIGHT)
        offset, strength = bands.peaks(window_px)
        weight = _weights(strength, noise)
        if (weight > 0).sum() < FEWEST_PIECES or (
            window < WINDOWS[0] and (strength > CLEAR_NOISES * noise).mean() < HOPELESS
        ):
            return None
        offset = offset - _moved(cut, bands, offset, strength, (size, now), WIDE_SIGHT)
        pose = _changed(pose, _solve(cut.rows, offset / now, weight, window_px / now))
        if not (np.abs(np.log(pose[3:] / size)) < OTHER_SIZE).all():
            return None
    sight = WIDE_SIGHT
    if np.abs(cut.neighbours[1]).min(initial=BESIDE) * now < FINE_BELOW:
        pose, sight = _finer(grey, cut, pose)
    return _judged(light, cut, pose, corner, sight)


def _finer(grey: np.ndarray, cut: _Cut, pose: np.ndarray) -> tuple[np.ndarray, _Sight]:
    """The pose by a narrower filter, which neighbouring strokes disturb less but noise more, and the `_Sight` it
    has."""
    window = max(WINDOWS[-1] * cut.size, LEAST_WINDOW)
    _, coarse = _measure(grey, pose, cut.pieces, window, WIDE_SIGHT).peaks(window)
    for _ in range(FINE_ROUNDS):
        noise = _measure(grey, pose, cut.blanks, CLOSE_PX, FINE_SIGHT).noise()
        bands = _measure(grey, pose, cut.pieces, window, FINE_SIGHT)
        offset, strength = bands.peaks(window)
        weight = _weights(strength, noise)
        sight = replace(FINE_SIGHT, blurred=_blurred(cut, coarse, strength, weight))
        now = float(np.sqrt(pose[3] * pose[4]))
        offset = offset - _moved(cut, bands, offset, strength, (cut.size, now), sight)
        pose = _changed(pose, _solve(cut.rows, offset / now, weight, window / now))
    return pose, sight


def _blurred(cut: _Cut, coarse: np.ndarray, fine: np.ndarray, weight: np.ndarray) -> float:
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


def _judged(light: np.ndarray, cut: _Cut, pose: np.ndarray, corner: np.ndarray, sight: _Sight) -> CourtFit:
    """How much of the court is seen at its fitted `pose` in `light`, whose upper left pixel is `corner` in the
    picture."""
    court, pieces = cut.court, cut.pieces
    size = float(np.sqrt(pose[3] * pose[4]))
    close = max(CLOSE * size, CLOSE_PX)
    empty = _measure(light, pose, cut.blanks, close, sight)
    noise = empty.noise()
    bands = _measure(light, pose, pieces, max(2 * close, LEAST_WINDOW), sight)
    offset, strength = bands.peaks(max(2 * close, LEAST_WINDOW))
    offset = offset - _moved(cut, bands, offset, strength, (size, size), sight)
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
    if hit.sum() > 8:
        left = offset[hit] / size
        by = cut.rows[hit]
        covariance = np.linalg.pinv(by.T @ by) * max(float((left**2).mean()), LEAST_SD**2)
        sds = np.sqrt(np.maximum(np.diag(covariance)[3:], 0))  # nearly 0 in a direction that no stroke measures
        scatter = float(np.sqrt((offset[hit] ** 2).mean())) / close
    return CourtFit(
        court,
        corner + pose[:2], float(pose[2]), float(pose[3]), float(pose[4]), float(sds[0]), float(sds[1]),
        offset[hit], float(np.average(hit, weights=pieces.weight)), seen, marred, scatter, typical / noise,
    )  # fmt: skip
