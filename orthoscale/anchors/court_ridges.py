"""Ridges of a picture across the strokes of a court, and how far they lie off the centres of the paint."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from ..core.angles import quarter_turn, unit_vector
from .court_models import PARALLEL_STROKES, Court, Pieces
from .peaks import peak_shift
from .ridges import ridge_noise

PAINT_SD = 0.05  # [m] one sigma of the ridge filter, by the width of the paint ...
LINE_SD = 0.75  # [px] ... but at least this, by the blur of a camera, where strokes are searched ...
FINE_SD = 0.6  # [px] ... and this where close strokes are measured
BLURRED_SD = 0.7  # [px] one sigma of a thin line as blurred by lens and pixels, typically
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
FEWEST_LEANING = 4  # pieces of a stroke that show its step
BESIDE = 2.0  # [m] from a stroke within which another one may disturb it
PIECE = 1.2  # [m] length of the pieces of strokes, but at least [px]:
PIECE_PX = 5.0
FREE = 1.0  # [m] and [px] from all paint: beyond, the picture must be blank
FREE_PX = 2.2
SAMPLES_PX = 0.8  # [px] between samples along a piece


@lru_cache(maxsize=64)
def _pieces(court: Court, length: float, free: float) -> tuple[Pieces, Pieces]:
    return court.pieces(length), court.blanks(length, free)


@dataclass(frozen=True)
class Cut:
    """A court whose strokes are cut into pieces, for pictures of about `size` [px/m]. length : of a piece [m]. pieces :
    P pieces of the strokes, blanks : pieces where nothing is painted. rows : (P, 5) derivatives of a piece's position
    across its stroke by each part of the pose, as in `court_fit.MOST_CHANGE`."""

    court: Court
    size: float
    length: float
    pieces: Pieces
    blanks: Pieces
    rows: np.ndarray

    @classmethod
    def of(cls, court: Court, size: float) -> Cut:
        """`court`, cut for pictures of about `size` [px/m]."""
        length = round(max(PIECE, PIECE_PX / size), 1)
        pieces, blanks = _pieces(court, length, round(max(FREE, FREE_PX / size), 1))
        u, v = pieces.middle.T
        nu, nv = -np.sin(pieces.direction), np.cos(pieces.direction)
        rows = np.stack([nu, nv, u * nv - v * nu, u * nu, v * nv], 1)
        return cls(court, size, length, pieces, blanks, rows)

    @property
    def neighbours(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices (N,) of the pieces that run beside another, parallel stroke, and the distance (N,) to it, positive on
        the normal's side [m]."""
        return _neighbours(self.court, self.length)


@lru_cache(maxsize=64)
def _neighbours(court: Court, length: float) -> tuple[np.ndarray, np.ndarray]:
    """See `Cut.neighbours`."""
    pieces = court.pieces(length)
    along = unit_vector(pieces.direction)
    gap = pieces.middle[None] - pieces.middle[:, None]
    beside = np.abs((gap * along[:, None]).sum(-1)) <= pieces.length[:, None] / 2
    off = gap[..., 1] * along[:, None, 0] - gap[..., 0] * along[:, None, 1]
    parallel = np.abs(np.sin(pieces.direction - pieces.direction[:, None])) < PARALLEL_STROKES
    one, other = np.nonzero(beside & parallel & (np.abs(off) < BESIDE) & (pieces.stroke != pieces.stroke[:, None]))
    return one, off[one, other]


@dataclass(frozen=True)
class Sight:
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


WIDE_SIGHT = Sight(LINE_SD, UNDER_STROKE)
FINE_SIGHT = Sight(FINE_SD, FINE_UNDER_STROKE)


def _pushed(cut: Cut, size: float, sight: Sight) -> np.ndarray:
    """(P,) shift [px] of the ridge of each piece by a stroke beside it: the peak of the sum of two second derivatives
    of Gaussians, to first order. It matters only where strokes are a few pixels apart."""
    one, off = cut.neighbours
    variance = sight.width(size) ** 2 + sight.blurred**2
    r = off * size
    slope = (r**3 / variance**2 - 3 * r / variance) * np.exp(-0.5 * r**2 / variance)
    return np.bincount(one, -slope * variance / 3, len(cut.pieces.length))


def _leaned(cut: Cut, bands: Bands, strength: np.ndarray, size: float, sight: Sight) -> np.ndarray:
    """(P,) shift [px] of the ridge of each piece by a step of the ground under its stroke, as where a court has another
    colour than its surroundings: the peak of the sum of the second derivatives of line and step. Both are measured over
    the whole stroke, without pieces that have another stroke too near; 0 if too few are left."""
    sd = sight.width(size)
    blur = float(np.hypot(sd, sight.blurred))
    near = np.zeros(len(strength), bool)
    one, off = cut.neighbours
    near[one[np.abs(off) * size < (GROUND_TO + 1) * sd]] = True
    leaned = np.zeros(len(strength))
    for number in range(len(cut.court.strokes)):
        of_stroke = cut.pieces.stroke == number
        own = of_stroke & (strength > 0) & bands.inside & ~near
        if own.sum() >= FEWEST_LEANING:
            ratio = float(np.median(bands.lean[own]) / np.median(strength[own]))
            step = sight.under * ratio * LINE_SEEN * (sd / blur) ** 2
            leaned[of_stroke] = np.sign(step) * blur * np.interp(abs(step), _STEP_SEEN, _LEANING)
    return leaned


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
    bands = measure(apart, np.array([0.0, 0.0, 0.0, 1.0, 1.0]), upright, PULL_REACH, Sight(sd, 0.0, blurred))
    seen = -bands.peaks(PULL_REACH)[0]  # the normal points to the left
    return float(2 * np.mean((phase - seen) * np.sin(2 * np.pi * phase)))


@dataclass
class Bands:
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


def measure(light: np.ndarray, pose: np.ndarray, pieces: Pieces, window: float, sight: Sight) -> Bands:
    """The ridges of `light` (H, W) float32 across `pieces` of a court, within `window` [px] of them. pose : (5,) place
    of the court x, y [px], its angle [rad], pixels per metre along and across."""
    x, y, angle, along, across = pose
    size = float(np.sqrt(along * across))
    sd = sight.width(size)
    offset, core = _offsets(window, sd)
    step, reach = offset[1] - offset[0], len(offset) // 2
    inner = int(np.clip(np.ceil(pieces.length.max() * size / SAMPLES_PX), 3, 12))
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s], [-s, c]]) * [[along], [across]]
    middle = np.array([x, y]) + pieces.middle @ turn
    step_along = unit_vector(pieces.direction) @ turn
    unit = step_along / np.hypot(*step_along.T)[:, None]
    part = (np.arange(inner) + 0.5) / inner - 0.5
    base = middle[:, None] + (pieces.length[:, None] * part)[..., None] * step_along[:, None]
    normal = quarter_turn(unit)
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
    return Bands(response, offset[reach - core : reach + core + 1], inside, lean, base, normal)


def moved(
    cut: Cut, bands: Bands, offset: np.ndarray, strength: np.ndarray, sizes: tuple[float, float], sight: Sight
) -> np.ndarray:
    """(P,) distance [px] of the ridges at `offset` from the true lines: pushed by other strokes and by a step of the
    ground, and pulled towards the centres of pixels. sizes : [px/m] for the pushes, and for the pull."""
    pushed, pulled = sizes
    leaned = _leaned(cut, bands, strength, pushed, sight)
    return _pushed(cut, pushed, sight) + leaned + bands.pulled(offset, sight.pull(pulled))
