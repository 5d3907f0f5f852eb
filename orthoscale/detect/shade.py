"""Corrects boxes of dark vehicles, which enclose their shadows where the two cannot be separated.

In coarse pictures under a low sun black paint cannot be distinguished from the shadow beside it. But the colour of a
vehicle is independent of its size: so a difference in size between the dark and the light vehicles of a scene is
attributed to shadows and subtracted. No reference is needed. Where few vehicles can be compared, what shadows usually
add is subtracted.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..core.normal import of_median

# Shares of a vehicle's length and width: what lies within the first pair is its body, what lies beyond the second its
# surroundings.
OF_BODY, AROUND_BODY = (0.7, 0.6), (1.2, 1.3)
DARKEST = 0.05  # quantile of the surroundings' grey levels that is taken for that of shadows
SHADOW_CONTRAST = 20.0  # grey levels by which shadows are darker than the ground, at least: else there are none
# Grey levels between the darkest and the lightest hundredth around the vehicles of a clear picture, at least: 64 places
# have 178 to 254. Haze reduces all contrasts alike. With half the contrast in `us_freeway_a` the shadows of a quarter
# of the dark vehicles were not recognised, and the scale was 2 % smaller.
CLEAR_RANGE = 178.0
LIGHTS = (0.01, 0.99)  # these quantiles
DARK, LIGHT = 0.35, 0.9  # lightness below which a vehicle may merge with its shadow, and above which it does not
LEAST_PAINTED = 5  # vehicles, both dark and light, that are needed to compare their sizes
ALIKE = 0.35  # log length from the median within which vehicles are compared: lorries are left out
# By how much shadows enlarge the dark vehicles of a scene on average, in length and in width [px]. At four of five
# scenes with vehicles of 16 to 24 px they add 0.6 to 0.9 px to lengths, and up to 1.5 to widths; at the fifth, and
# where vehicles have 47 px, nothing (training/measurer/README.md, "Dark vehicles and black shadows").
SHADOW_PX = 0.5
# By how much dark and light vehicles really differ in log length and width (white vans, black limousines).
OF_PAINT_SD = 0.02


def shadow_contrast(windows: Sequence[np.ndarray]) -> float:
    """Grey levels by which shadows are at least darker than the ground in pictures with these `windows`
    (`windows_about`): SHADOW_CONTRAST, or less in haze."""
    if not windows:
        return SHADOW_CONTRAST
    darkest, lightest = np.quantile(np.concatenate([window.ravel() for window in windows]), LIGHTS)
    return SHADOW_CONTRAST * min(1.0, float(lightest - darkest) / CLEAR_RANGE)


def lightness(crop: np.ndarray, size: np.ndarray, contrast: float = SHADOW_CONTRAST) -> float:
    """How light the vehicle in the middle of `crop` (H, W, 3), which lies along the crop, is: 0 as dark as its darkest
    surroundings, 1 as light as the ground. NaN if no surroundings are darker than the ground by `contrast`.

    size : (2,) the vehicle's length and width [crop px]. contrast : of shadows, at least [grey levels].
    """
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
    """The log sizes of the dark (K, 2) and of the light (L, 2) ones of N vehicles, lorries left out.

    log_size : (N, 2) of length and width, light : (N,) of `lightness`.
    """
    near = np.abs(log_size[:, 0] - np.median(log_size[:, 0])) < ALIKE if len(log_size) else np.empty(0, bool)
    return log_size[near & (light < DARK)], log_size[near & (light > LIGHT)]


def larger(dark: np.ndarray, bright: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(2,) by how much the median of log sizes `dark` (K, 2) exceeds that of `bright` (L, 2), and its variance (2,)."""
    variance = of_median(len(dark)) * dark.var(0, ddof=1) + of_median(len(bright)) * bright.var(0, ddof=1)
    return np.median(dark, 0) - np.median(bright, 0), variance


def shadows(log_size: np.ndarray, light: np.ndarray, pixel: float = 1.0) -> np.ndarray:
    """(2,) by how much the dark ones of N vehicles are too large because of their shadows, in log length and width.

    log_size, light : as in `dark_and_light`. pixel : size of the picture's detail, as sizes are measured [px].

    Shadows only enlarge, so the prior is an exponential distribution with the mean SHADOW_PX. With the difference of
    medians, which is uncertain and includes how far dark and light vehicles really differ, it becomes a truncated
    normal distribution, whose mean is returned (Johnson, Kotz and Balakrishnan 1994, 13.10); the prior's mean if too
    few can be compared, and 0 if none are dark.
    """
    from scipy.special import log_ndtr

    if not (light < DARK).any():
        return np.zeros(2)
    usual = SHADOW_PX * pixel / np.exp(np.median(log_size, axis=0))
    dark, bright = dark_and_light(log_size, light)
    if min(len(dark), len(bright)) < LEAST_PAINTED:
        return usual
    apart, variance = larger(dark, bright)
    variance = variance + OF_PAINT_SD**2
    sd, middle = np.sqrt(variance), apart - variance / usual
    return middle + sd * np.exp(-0.5 * (middle / sd) ** 2 - log_ndtr(middle / sd)) / np.sqrt(2 * np.pi)
