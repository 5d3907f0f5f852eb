"""Simulates the way of light into a file: optics, sensor, resampling, haze, tone, sharpening, noise, JPEG.

A window around one vehicle is cut from a fine picture at any size and rotation and goes through these steps, each by
chance. They work on the picture's own grid, which has any position relative to the vehicle, before a crop is cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from training.augment import leaves
from training.geometry import shrunk_by, transform_boxes

from .rendered import BRIGHTEST

LENGTHS = (8.0, 120.0)  # of a vehicle in the finished picture [px]
RESAMPLED = (0.5, 3.0)  # finished pixels per sensor pixel
SOFT = 0.25  # share of the pictures that are blurred after they were taken: enlarged elsewhere, hazy, video frames
SOFTEST = (0.5, 3.0)  # one sigma of that blur [px]
SHARPEST = 126.0  # a vehicle's length on the sensor, at most [px]: that in the rendered pictures
REACH = 2.9  # side of a window in vehicle lengths: a crop 1.35 times too large lies inside at any rotation
GLARE = 0.45  # share of the lenses that scatter light widely, so that overexposed things grow
OVEREXPOSED = 0.3  # share of the pictures whose exposure suits the shade
# Share of the pictures whose contrast was stretched until shadows are black, as in orthophotos; dark paint in or beside
# them is black then, too. And the quantiles of a window's light that become black.
STRETCHED = 0.35
DARKEST = (0.01, 0.2)
# One sigma of a random change of the ratio of length to width (log) before a camera sees the vehicle. For blurred
# vehicles of 12 to 18 px a network gives more or less the usual shape; less so, the more varied the shapes were that it
# has seen.
SHAPES_SD = 0.07
COVERED = 0.3  # share of the vehicles of which an edge, a corner or more may be hidden by something opaque
CROWNS = 0.6  # share of these covers that show other ground, as trees do; the others are black shade
REACHES = (0.2, 1.45)  # distance of a cover from a vehicle's middle: 1 is at the edge, 1.41 at the corner
RAGGED = (0.05, 0.4)  # one sigma of how far a cover's outline deviates from a line, in the same unit
STRIP = 0.1  # depth of the strip inside an edge that decides whether it is hidden, as a share of length or width
HIDDEN = 0.4  # share of that strip under the cover from which the edge is hidden


def pyramid(picture: np.ndarray, levels: int = 5) -> list[np.ndarray]:
    """The picture (H, W, 3) uint8 and its halves, quarters, ... by area."""
    out = [picture]
    while len(out) < levels and min(out[-1].shape[:2]) >= 32:
        size = out[-1].shape[1] // 2, out[-1].shape[0] // 2
        out.append(cv2.resize(out[-1], size, interpolation=cv2.INTER_AREA))
    return out


def window(
    levels: Sequence[np.ndarray], box: np.ndarray, scale: float, rng: np.random.Generator, fine: int
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels around `box` (5,) at `scale`, randomly rotated and changed in shape, (fine n, fine n, 3) uint8; and the
    box on the grid of n x n."""
    longer = np.exp(np.clip(rng.normal(0, SHAPES_SD / 2), -SHAPES_SD, SHAPES_SD))
    n = int(np.ceil(REACH * max(longer * box[2], 2 * box[3] / longer) * scale)) + 6
    along, turn = _rotation(box[4]), _rotation(rng.uniform(0, 2 * np.pi))
    linear = scale * turn @ along @ np.diag([longer, 1 / longer]) @ along.T
    shift = n / 2 + rng.uniform(-0.5, 0.5, 2) - linear @ box[:2]
    octave = int(np.clip(np.floor(np.log2(1 / (fine * scale))), 0, len(levels) - 1))
    # OpenCV puts a pixel's centre at its integer index.
    a = fine * linear * shrunk_by(levels[0], levels[octave])
    t = fine * shift + a @ (0.5, 0.5) - 0.5
    pixels = cv2.warpAffine(
        levels[octave], np.c_[a, t], (fine * n, fine * n), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101
    )
    return pixels, transform_boxes(box[None], linear, shift)[0]


def _rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@dataclass(frozen=True)
class Shot:
    """A vehicle as one camera took it.

    pixels : (n, n, 3), light 0..1, or uint8 when finished. box : (5,) of the vehicle in them. shown : (5,) box of its
    visible part, including blur. hidden : (4,) bool, which edges are not visible: rear, front, left, right.
    """

    pixels: np.ndarray
    box: np.ndarray
    shown: np.ndarray
    hidden: np.ndarray


def covered(x: np.ndarray, box: np.ndarray, others: np.ndarray, rng: np.random.Generator) -> Shot:
    """The window `x` (n, n, 3) 0..1 with part of the vehicle in `box` (5,) under a tree or in black shade.

    others : (m, m, 3) uint8, ground without vehicles."""
    n = x.shape[0]
    rows, columns = np.mgrid[:n, :n].astype(np.float32) + np.float32(0.5)
    cos, sin = np.cos(box[4]), np.sin(box[4])
    along = ((columns - box[0]) * cos + (rows - box[1]) * sin) / (box[2] / 2)
    across = ((rows - box[1]) * cos - (columns - box[0]) * sin) / (box[3] / 2)
    mask = _cover(along, across, box, rng)
    if rng.random() < CROWNS:
        light = np.float32(rng.uniform(0.4, 1.1) / 255)
        cover = light * cv2.resize(others, (n, n), interpolation=cv2.INTER_AREA).astype(np.float32)
    else:
        cover = np.float32(rng.uniform(0.0, 0.2)) * x + np.float32(rng.uniform(0, 0.1))
    hidden = _hidden(along, across, box, mask)
    return Shot(x + mask[..., None] * (cover - x), box, _shown(along, across, box, mask, hidden), hidden)


def _cover(along: np.ndarray, across: np.ndarray, box: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(n, n) 0..1, opacity of a cover with a ragged edge that begins somewhere over the vehicle in `box` (5,).

    along, across : (n, n) positions in half lengths and half widths from the vehicle's middle.
    """
    way = rng.uniform(0, 2 * np.pi)
    stray = rng.normal(0, 1, along.shape).astype(np.float32)
    stray = cv2.GaussianBlur(stray, (0, 0), box[2] * rng.uniform(0.05, 0.25), borderType=cv2.BORDER_REFLECT)
    beyond = along * np.cos(way) + across * np.sin(way) - rng.uniform(*REACHES)
    beyond += rng.uniform(*RAGGED) * stray / max(float(stray.std()), 1e-6)
    return np.clip(0.5 + beyond * box[3] / 2 / rng.uniform(0.5, 2.0), 0, 1).astype(np.float32)


def _hidden(along: np.ndarray, across: np.ndarray, box: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(4,) bool, see `Shot`: edges inside which most of a strip lies under the `mask`."""
    ends, sides = np.abs(across) < 0.7, np.abs(along) < 0.7  # corners are round
    hidden = []
    for middle, depth, size in (
        (ends, 1 + along, box[2]), (ends, 1 - along, box[2]), (sides, 1 + across, box[3]), (sides, 1 - across, box[3])
    ):  # fmt: skip
        strip = middle & (depth > 0) & (depth < max(2 * STRIP, 3 / size))
        hidden.append(strip.any() and mask[strip].mean() > HIDDEN)
    return np.array(hidden)


def _shown(along: np.ndarray, across: np.ndarray, box: np.ndarray, mask: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """(5,) the box of the part that the `mask` leaves visible. Visible edges stay; covered corners do not move them."""
    clear = (np.maximum(np.abs(along), np.abs(across)) < 1) & (mask < 0.5)
    if not clear.any():
        return box
    ends = np.stack([np.quantile(u[clear], (0.02, 0.98)) for u in (along, across)])
    ends = np.where(hidden.reshape(2, 2), ends, [-1, 1])
    x, y = ends.mean(1) * box[2:4] / 2
    cos, sin = np.cos(box[4]), np.sin(box[4])
    size = np.maximum(np.diff(ends)[:, 0] / 2 * box[2:4], 2)
    return np.array([box[0] + cos * x - sin * y, box[1] + sin * x + cos * y, *size, box[4]])


def optics(x: np.ndarray, fine: int, rng: np.random.Generator, sharp: float = 0.25) -> np.ndarray:
    """Blur of lens, focus or motion; `x` has `fine` samples per pixel each way. sharp : share that is not blurred."""
    kind = rng.choice(4, p=[sharp, *(np.array([0.5, 0.2, 0.3]) * (1 - sharp))])
    if kind == 1:
        sigma = fine * rng.uniform(0.2, 1.0) * np.exp(rng.normal(0, 0.1, 2))
        return cv2.GaussianBlur(x, (0, 0), sigmaX=sigma[0], sigmaY=sigma[1])
    reach = 2 * fine + 1
    y, x0 = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    if kind == 2:  # out of focus: a disc
        kernel = np.clip(fine * rng.uniform(0.4, 1.3) + 0.5 - np.hypot(y, x0), 0, 1)
    elif kind == 3:  # motion: a line
        length, angle = fine * rng.uniform(0.5, 3.0), rng.uniform(0, np.pi)
        along, across = x0 * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x0 * np.sin(angle)
        kernel = np.clip((length + 1) / 2 - np.abs(along), 0, 1) * np.clip(1 - np.abs(across), 0, 1)
    else:
        return x
    return cv2.filter2D(x, -1, (kernel / kernel.sum()).astype(np.float32), borderType=cv2.BORDER_REFLECT_101)


def glare(x: np.ndarray, fine: int, rng: np.random.Generator) -> np.ndarray:
    """Scatters a small share of the light over some pixels, as dirty, cheap or wet lenses and saturated sensors do."""
    share = np.float32(rng.uniform(0.03, 0.2))
    return (1 - share) * x + share * cv2.GaussianBlur(x, (0, 0), fine * rng.uniform(1.2, 4.0))


def resample(x: np.ndarray, factor: float, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """`x` at about `factor` times the size, with one of the usual filters; and the exact factor."""
    size = max(8, round(x.shape[0] * factor))
    ways = [cv2.INTER_AREA, cv2.INTER_LINEAR, cv2.INTER_CUBIC, cv2.INTER_LANCZOS4, cv2.INTER_NEAREST_EXACT]
    way = ways[rng.choice(5, p=[0.38, 0.19, 0.24, 0.14, 0.05] if factor < 1 else [0.05, 0.38, 0.33, 0.19, 0.05])]
    return cv2.resize(x, (size, size), interpolation=way), size / x.shape[0]


def jpeg(x: np.ndarray, quality: int) -> np.ndarray:
    """`x` (H, W, 3) 0..1 after compression."""
    coded = cv2.imencode(".jpg", _bytes(x[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return cv2.imdecode(coded, cv2.IMREAD_COLOR)[..., ::-1].astype(np.float32) / 255


def sharpen(x: np.ndarray, amount: float, radius: float) -> np.ndarray:
    """Unsharp masking, with its halos."""
    return x + amount * (x - cv2.GaussianBlur(x, (0, 0), radius))


@lru_cache(maxsize=1)
def _grain() -> np.ndarray:
    """A field of noise to cut from, (1024, 1024, 3) float32: luminance and, half as strong, colour."""
    rng = np.random.default_rng(0)
    return rng.standard_normal((1024, 1024, 1), np.float32) + 0.5 * rng.standard_normal((1024, 1024, 3), np.float32)


@lru_cache(maxsize=1)
def _leaves() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [leaves(rng) for _ in range(100)]


def noise(x: np.ndarray, sd: float, rng: np.random.Generator) -> np.ndarray:
    height, width = x.shape[:2]
    top, left = rng.integers(0, 1024 - height), rng.integers(0, 1024 - width)
    return x + np.float32(sd) * _grain()[top : top + height, left : left + width]


def tone(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Gamma, brightness, contrast, saturation, balance; grey by chance."""
    x = cv2.pow(np.clip(x, 0, 1), float(np.exp(rng.normal(0, 0.25))))
    grey = cv2.cvtColor(x, cv2.COLOR_RGB2GRAY)[..., None]
    x = grey + np.float32(rng.uniform(0.5, 1.7) if rng.random() > 0.1 else 0.0) * (x - grey)
    gain, shift = rng.uniform(0.6, 1.5), 0.45 + rng.normal(0, 0.08)
    gain = (gain * np.exp(rng.normal(0, 0.05, 3))).astype(np.float32)
    return x * gain + (np.float32(shift) - np.float32(0.45) * gain)


def stretch(x: np.ndarray, darkest: float, share: float = 1.0) -> np.ndarray:
    """`x` with contrast stretched: `share` times its `darkest` quantile becomes black."""
    black = np.float32(share * np.quantile(cv2.cvtColor(x, cv2.COLOR_RGB2GRAY), darkest))
    return (x - black) / max(np.float32(1) - black, np.float32(0.2))


def develop(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Linear light to display values, 0..1: exposure, haze, a shoulder of random softness, gamma."""
    veil = rng.uniform(0.02, 0.5) if rng.random() < 0.25 else 0.0
    sky = np.float32(veil * rng.uniform(0.3, 0.8)) * np.array([0.92, 0.98, 1.06], np.float32)
    exposure = rng.normal(0.45, 0.45) + (rng.uniform(0.4, 1.2) if rng.random() < OVEREXPOSED else 0.0)
    x = light * np.float32(np.exp(exposure) * (1 - veil)) + sky
    white, soft = np.float32(rng.uniform(1.0, 4.0)), np.float32(rng.uniform(0.0, 1.0))
    x = x * (1 + x / white**2) / (1 + x * soft)  # Reinhard's curve, or part of it
    return cv2.pow(np.clip(x, 0, 1), float(rng.uniform(0.42, 0.6)))


def finish(x: np.ndarray, rng: np.random.Generator, strength: float) -> np.ndarray:
    """Processing of a picture after it was taken. strength : factor on the probabilities of all steps but JPEG."""
    if rng.random() < STRETCHED * strength:
        x = stretch(x, rng.uniform(*DARKEST), rng.uniform(0.6, 1.1))
    if rng.random() < 0.6 * strength:
        x = tone(x, rng)
    if rng.random() < 0.35 * strength:
        x = sharpen(x, rng.uniform(0.3, 2.5), rng.uniform(0.6, 2.0))
    if rng.random() < 0.4 * strength:
        x = noise(x, rng.uniform(0.002, 0.03), rng)
    x = np.clip(x, 0, 1)
    return jpeg(x, int(rng.integers(40, 96))) if rng.random() < 0.65 else x


def photograph(
    levels: Sequence[np.ndarray],
    box: np.ndarray,
    rng: np.random.Generator,
    linear: bool,
    others: np.ndarray | None = None,
    cover: float = COVERED,
) -> Shot:
    """A finished window around `box` (5,), RGB.

    levels : `pyramid` of a rendered picture (`linear`), or of a real one, which a camera has taken already, so that it
    is only changed a little more. others : (m, m, 3) uint8, ground that partly covers a share `cover` of the vehicles.
    """
    length = np.exp(rng.uniform(*np.log(LENGTHS)))
    factor = np.exp(rng.uniform(*np.log(RESAMPLED))) if rng.random() < (0.45 if linear else 0.3) else 1.0
    if not linear:
        length = min(length, box[2] * rng.uniform(0.8, 1.0) * min(1.0, factor))
    on_sensor = np.clip(length / factor, LENGTHS[0] * 0.75, SHARPEST if linear else 1.2 * box[2])
    fine = 2 if on_sensor < (0.5 if linear else 0.7) * box[2] else 1
    x, box = window(levels, box, on_sensor / box[2], rng, fine)
    x, shown, hidden = x.astype(np.float32) / 255, box, np.zeros(4, bool)
    if others is not None and rng.random() < cover:
        samples = np.array([fine, fine, fine, fine, 1])
        part = covered(x, box * samples, others, rng)
        x, shown, hidden = part.pixels, part.shown / samples, part.hidden
    if rng.random() < (0.15 if linear else 0.1):
        shade = cv2.resize(_leaves()[rng.integers(100)], x.shape[:2], interpolation=cv2.INTER_LINEAR)
        x = x * (1 + (np.float32(rng.uniform(0.4, 0.85)) - 1) * shade[..., None])
    if linear:
        x = optics(np.float32(BRIGHTEST) * x * x, fine, rng)
        if rng.random() < GLARE:
            x = glare(x, fine, rng)
    elif fine == 2 and rng.random() < 0.5:
        x = optics(x, fine, rng)
    if fine == 2:
        x = cv2.resize(x, (x.shape[1] // 2, x.shape[0] // 2), interpolation=cv2.INTER_AREA)
    if linear:
        x = develop(x, rng)
        if rng.random() < 0.5:
            x = noise(x, rng.uniform(0.001, 0.02), rng)
        if rng.random() < 0.25:
            x = sharpen(x, rng.uniform(0.2, 1.2), rng.uniform(0.5, 1.2))
        x = np.clip(x, 0, 1)
        if factor != 1 and rng.random() < 0.4:
            x = jpeg(x, int(rng.integers(60, 96)))
    if factor != 1:
        x, factor = resample(x, factor, rng)
        box, shown = (b * [factor, factor, factor, factor, 1] for b in (box, shown))
    if rng.random() < SOFT:
        sigma = rng.uniform(*SOFTEST)
        x = cv2.GaussianBlur(x, (0, 0), sigma)
        shown = shown + np.array([0, 0, 1, 1, 0]) * (sigma * rng.uniform(0, 2))  # detectors box the blur, too
    return Shot(_bytes(finish(x, rng, 1.0 if linear else 0.6)), box, shown, hidden)


def _bytes(x: np.ndarray) -> np.ndarray:
    return cv2.convertScaleAbs(x, alpha=255.0)
