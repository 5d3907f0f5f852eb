"""Bright thin lines in a picture: how strong they are in each direction, and where long straight ones run.

A ridge is where the second derivative across is strongly negative and that along is not (Lindeberg 1998, edge and ridge
detection; steered as by Freeman and Adelson 1991). It is divided by the local mean size of second derivatives, so that
paint on grey asphalt counts as much as on green asphalt next to a white roof. Sums along all straight lines of a strip
come from the fast discrete Radon transform (Brady 1998), which takes log2(n) additions per pixel and slope.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..core.normal import ROBUST_SD

BLUR_PX = 0.9  # [px] one sigma of smoothing for the derivatives: keeps a line one pixel wide, removes most noise
DIRECTIONS = 8  # steered maps over half a turn: a line is at most 11 degrees off one and keeps 0.94 of its strength
CLEAR_RIDGE = 120  # a ridge of full strength in the maps, which are int8
SEED_PX = 32  # [px] rows of a strip: the length of a seed along rows or columns
SURROUNDINGS = 24  # [px] one sigma of the window for the local mean
FLOOR = 0.35  # [grey levels] least local mean: below it are compression and rounding
ROUNDING = 0.1  # [grey levels] of noise at least
STRONGEST = 1.6  # [local means] from which on a ridge has full strength


def lightness(image: np.ndarray) -> np.ndarray:
    """(H, W) float32 of RGB uint8 (H, W, 3): the mean of brightness and the darkest channel. White paint stands out
    from grey ground by the former, from coloured ground by the latter."""
    least = np.minimum(np.minimum(image[..., 0], image[..., 1]), image[..., 2])
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) * 0.5 + least.astype(np.float32) * 0.5


def steered(light: np.ndarray) -> np.ndarray:
    """(DIRECTIONS, H, W) int8: ridges that run at k * 180 / DIRECTIONS degrees from +x, clockwise on screen.
    CLEAR_RIDGE is a clear ridge; a dark line, or the flank of a bright one, is negative. light : (H, W) float32."""
    smooth = cv2.GaussianBlur(light, (0, 0), BLUR_PX)
    xx, xy, yy = (cv2.Sobel(smooth, cv2.CV_32F, dx, dy, ksize=3, scale=0.25) for dx, dy in ((2, 0), (1, 1), (0, 2)))
    size = cv2.sqrt(xx * xx + yy * yy + 2 * xy * xy)
    local = cv2.GaussianBlur(size, (0, 0), SURROUNDINGS / 4)
    local = np.maximum(cv2.GaussianBlur(local, (0, 0), SURROUNDINGS), np.minimum(local, 4 * FLOOR)) + FLOOR
    gain = np.float32(CLEAR_RIDGE / STRONGEST) / local
    mean, half, cross = -0.5 * (xx + yy) * gain, 0.5 * (xx - yy) * gain, xy * gain
    maps = np.empty((DIRECTIONS, *light.shape), np.int8)
    for k in range(DIRECTIONS // 2):
        turn = 2 * np.pi * k / DIRECTIONS
        bend = half * np.float32(np.cos(turn)) + cross * np.float32(np.sin(turn))
        # second derivatives across and along a line at half this angle; for a line at right angles they swap
        one, other = mean + bend, mean - bend
        for direction, across, along in ((k, one, other), (k + DIRECTIONS // 2, other, one)):
            ridge = across - 0.5 * np.maximum(along, 0)
            maps[direction] = np.clip(ridge, -CLEAR_RIDGE, CLEAR_RIDGE, out=ridge)
    return maps


def ridge_noise(response: np.ndarray) -> float:
    """One sigma [grey levels] of the `response` (any shape) of a ridge filter, most of it to nothing painted."""
    return ROBUST_SD * float(np.median(np.abs(response))) + ROUNDING


@dataclass(frozen=True)
class Segments:
    """Straight bright pieces. middle : (N, 2) [px]. angle : (N,) [rad] from +x, clockwise on screen, 0 to pi."""

    middle: np.ndarray
    angle: np.ndarray


def _sums(ridge: np.ndarray) -> np.ndarray:
    """(strips, SEED_PX, W + 2 SEED_PX) sums along lines, by strip, d and s: a line starts at column s - SEED_PX of the
    strip's first row and ends at column s - SEED_PX + d of its last. Strips begin every SEED_PX / 2 rows."""
    height, width = ridge.shape
    rows = max(-(-height // SEED_PX), 1) * SEED_PX
    now = np.zeros((rows, 1, width + 2 * SEED_PX), np.int16)
    now[:height, 0, SEED_PX : SEED_PX + width] = ridge
    while now.shape[1] < SEED_PX:
        n = now.shape[1]
        last = 2 * n == SEED_PX
        upper, lower = (now[:-1], now[1:]) if last else (now[::2], now[1::2])
        new = np.zeros((len(upper), 2 * n, now.shape[2]), np.int16)
        for d in range(n):
            for more in (0, 1):
                shift = d + more
                new[:, 2 * d + more, : now.shape[2] - shift] = lower[:, d, shift:]
                new[:, 2 * d + more] += upper[:, d]
        now = new
    return now


def segments(maps: np.ndarray, least: float) -> Segments:
    """All straight pieces of SEED_PX rows, or columns, whose mean ridge in `maps` (of `steered`) is at least `least`
    and greater than that of similar lines."""
    found: list[np.ndarray] = []
    quarter = DIRECTIONS // 8
    for turned in (False, True):
        for mirrored in (False, True):
            # between 45 and 90 degrees from +x, its mirror image, and both with x and y exchanged
            direction = {(False, False): 3, (False, True): 5, (True, False): 1, (True, True): 7}[turned, mirrored]
            ridge = maps[direction * quarter]
            ridge = ridge.T if turned else ridge
            width = ridge.shape[1]
            sums = _sums(ridge[:, ::-1] if mirrored else ridge)
            flat = sums.reshape(-1, sums.shape[2])
            strip, slope, start = np.unravel_index(
                np.flatnonzero(flat.ravel() >= least * CLEAR_RIDGE * SEED_PX), sums.shape
            )
            value = sums[strip, slope, start]
            padded = np.pad(sums, ((0, 0), (2, 2), (3, 3)))
            top = np.ones(len(value), bool)
            for i in range(-2, 3):
                for j in range(-3, 4):
                    other = padded[strip, slope + 2 + i, start + 3 + j]
                    top &= (value > other) if (i, j) > (0, 0) else (value >= other)
            strip, slope, start = strip[top], slope[top], start[top]
            x0, x1 = start - SEED_PX, start - SEED_PX + slope
            if mirrored:
                x0, x1 = width - 1 - x0, width - 1 - x1
            y0 = strip * (SEED_PX // 2)
            ends = np.stack([x0, y0, x1, y0 + SEED_PX - 1], 1).astype(float)
            ends = ends[:, [1, 0, 3, 2]] if turned else ends
            found.append(ends)
    every = np.concatenate(found)
    step = every[:, 2:] - every[:, :2]
    return Segments((every[:, :2] + every[:, 2:]) / 2, np.arctan2(step[:, 1], step[:, 0]) % np.pi)
