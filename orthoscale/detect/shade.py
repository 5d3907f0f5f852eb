"""Corrects boxes of dark vehicles, which enclose their shadows where the two cannot be separated.

In coarse pictures under a low sun black paint cannot be distinguished from the shadow beside it. But paint is
independent of size: a difference between the dark and the light vehicles of a scene is attributed to shadows, and taken
off. No truth is needed, and where dark vehicles measure as light ones do, nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

# Of a vehicle's length and width: what lies within the first two is its body, what lies beyond the others its
# surroundings.
OF_BODY, AROUND_BODY = (0.7, 0.6), (1.2, 1.3)
DARKEST = 0.05  # quantile of the surroundings' light that tells how dark shadows are
SHADOW_CONTRAST = 20.0  # grey levels by which shadows are darker than the ground, at least: else there are none
# Grey levels between the darkest and the lightest hundredth about the vehicles of a clear picture, at least: 178 to 254
# at 64 places. Haze leaves fewer of all contrasts alike: of half of them in `us_freeway_a` shadows of a quarter of the
# dark vehicles were not seen, and the scale was 2 % smaller.
CLEAR_RANGE = 178.0
LIGHTS = (0.01, 0.99)  # these quantiles
DARK, LIGHT = 0.35, 0.9  # lightness up to which a vehicle may be taken for its shadow, and from which it is not
LEAST_PAINTED = 5  # dark and light ones from which their sizes are compared
ALIKE = 0.35  # log length from the median's within which vehicles are compared: lorries are left out
# One sigma, of log length and width: by how much shadows enlarge the dark vehicles of a scene, and by how much dark and
# light ones differ of themselves (white vans, black limousines).
SHADOW_SD = np.array([0.04, 0.09])
OF_PAINT_SD = 0.02


def shadow_contrast(windows: Sequence[np.ndarray]) -> float:
    """Grey levels by which shadows are darker than the ground, at least, in pictures with these `windows`
    (`windows_about`): SHADOW_CONTRAST, less in haze."""
    if not windows:
        return SHADOW_CONTRAST
    darkest, lightest = np.quantile(np.concatenate([window.ravel() for window in windows]), LIGHTS)
    return SHADOW_CONTRAST * min(1.0, float(lightest - darkest) / CLEAR_RANGE)


def lightness(crop: np.ndarray, size: np.ndarray, contrast: float = SHADOW_CONTRAST) -> float:
    """How light the vehicle in the middle of `crop` (H, W, 3) is, of `size` (2,) length and width [crop px], along the
    crop: 0 as its darkest surroundings, 1 as the ground. NaN where no shadows of such a `contrast` are about."""
    grey = cv2.cvtColor(crop, cv2.COLOR_RGB2GRAY)
    along = np.abs(np.arange(grey.shape[1]) + 0.5 - grey.shape[1] / 2) / (size[0] / 2)
    across = np.abs(np.arange(grey.shape[0]) + 0.5 - grey.shape[0] / 2)[:, None] / (size[1] / 2)
    body = grey[(along < OF_BODY[0]) & (across < OF_BODY[1])]
    around = grey[(along > AROUND_BODY[0]) | (across > AROUND_BODY[1])]
    if not body.size or not around.size:
        return np.nan
    ground, shadow = np.median(around), np.quantile(around, DARKEST)
    return float((np.median(body) - shadow) / (ground - shadow)) if ground - shadow > contrast else np.nan


def dark_and_light(log_size: np.ndarray, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The log sizes (K, 2) of the dark and of the light ones of N vehicles, lorries left out.

    log_size : (N, 2) of length and width, light : (N,) of `lightness`.
    """
    near = np.abs(log_size[:, 0] - np.median(log_size[:, 0])) < ALIKE if len(log_size) else np.empty(0, bool)
    return log_size[near & (light < DARK)], log_size[near & (light > LIGHT)]


def larger(dark: np.ndarray, bright: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(2,) by how much the median of log sizes `dark` (K, 2) exceeds that of `bright` (L, 2), and its variance (2,)."""
    # Of a median: pi / 2 times a mean's.
    variance = np.pi / 2 * (dark.var(0, ddof=1) / len(dark) + bright.var(0, ddof=1) / len(bright))
    return np.median(dark, 0) - np.median(bright, 0), variance


def shadows(log_size: np.ndarray, light: np.ndarray) -> np.ndarray:
    """(2,) by how much the dark of N vehicles are too large for their shadows, of log length and width.

    log_size, light : of `dark_and_light`. The difference of medians is believed as far as its own uncertainty and what
    paint may have to do with size allow (a normal prior of SHADOW_SD); 0 where too few can be compared, and where dark
    ones are the smaller, for shadows only add.
    """
    groups = dark_and_light(log_size, light)
    if min(map(len, groups)) < LEAST_PAINTED:
        return np.zeros(2)
    apart, variance = larger(*groups)
    return SHADOW_SD**2 / (SHADOW_SD**2 + variance + OF_PAINT_SD**2) * np.maximum(apart, 0.0)
