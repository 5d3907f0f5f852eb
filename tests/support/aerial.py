"""Simulated pairs: photos of an orthophoto as a pinhole camera would take them, in another light and season."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class Shot:
    """A photo over level ground. foot : (2,) place below the camera, x and y of the orthophoto [m right and down].

    heading : of the picture's top, clockwise from the orthophoto's up [deg]. pitch, roll : as `sources.tags` [deg].
    altitude [m], focal [px], size [px].
    """

    foot: tuple[float, float]
    heading: float = 0.0
    altitude: float = 100.0
    focal: float = 600.0
    size: tuple[int, int] = (640, 480)
    pitch: float = -90.0
    roll: float = 0.0

    @property
    def axes(self) -> np.ndarray:
        """(3, 3) the camera's right, down and forward, as right and down of the orthophoto and depth."""
        pitch, roll, heading = np.radians([self.pitch, self.roll, self.heading])
        ahead = np.array([np.sin(heading), -np.cos(heading), 0.0])
        beside = np.array([np.cos(heading), np.sin(heading), 0.0])
        below = np.array([0.0, 0.0, 1.0])
        forward = np.cos(pitch) * ahead - np.sin(pitch) * below
        low = -np.sin(pitch) * -ahead + np.cos(pitch) * below
        right, down = (
            np.cos(roll) * beside + np.sin(roll) * low,
            np.cos(roll) * low - np.sin(roll) * beside,
        )
        return np.stack([right, down, forward])

    def ground(self, pixels: np.ndarray) -> np.ndarray:
        """(N, 2) metres right and down of the orthophoto, of pixels (N, 2)."""
        pixels = np.asarray(pixels, float)
        plane = (pixels - np.array(self.size) / 2) / self.focal
        rays = np.column_stack([plane, np.ones(len(plane))]) @ self.axes
        return np.array(self.foot) + rays[:, :2] * (self.altitude / rays[:, 2])[:, None]

    def of(self, ortho: np.ndarray, gsd: float) -> np.ndarray:
        """The photo of an orthophoto (H, W, 3) of `gsd` [m/px]; black beyond it."""
        width, height = self.size
        own = self.altitude / self.focal
        blurred = cv2.GaussianBlur(ortho, (0, 0), 0.5 * own / gsd) if own > gsd else ortho
        y, x = np.indices((height, width)) + 0.5
        places = self.ground(np.column_stack([x.ravel(), y.ravel()])) / gsd - 0.5
        at = places.astype(np.float32).reshape(height, width, 2)
        return cv2.remap(blurred, at[..., 0], at[..., 1], cv2.INTER_CUBIC)


def town(seed: int = 0, side: int = 1600) -> np.ndarray:
    """(side, side, 3) uint8: random roofs, roads and trees, without repeats."""
    draw = np.random.default_rng(seed)
    ground = cv2.resize(draw.uniform(70, 130, (side // 40, side // 40, 3)), (side, side), interpolation=cv2.INTER_CUBIC)
    for _ in range(side // 40):
        ends = draw.uniform(-0.2, 1.2, (2, 2)) * side
        cv2.line(ground, *(tuple(int(v) for v in e) for e in ends), (150, 150, 150), int(draw.uniform(18, 36)))
    for _ in range(side**2 // 4000):
        box = cv2.boxPoints((tuple(draw.uniform(0, side, 2)), tuple(draw.uniform(20, 80, 2)), draw.uniform(0, 90)))
        colour = draw.uniform(40, 240, 3)
        cv2.fillPoly(ground, [box.astype(np.int32)], colour.tolist())
        ridge = [tuple(int(v) for v in (box[k] + box[k + 1]) / 2) for k in (0, 2)]
        cv2.line(ground, *ridge, (colour * 0.7).tolist(), 3)
    for _ in range(side**2 // 3000):
        at = tuple(int(v) for v in draw.uniform(0, side, 2))
        cv2.circle(ground, at, int(draw.uniform(5, 14)), draw.uniform([30, 70, 20], [70, 120, 60]).tolist(), -1)
    noisy = ground + draw.normal(0, 4, ground.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def relit(picture: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """The picture in another light: gamma, contrast, colour cast, and shadows of clouds."""
    height, width = picture.shape[:2]
    light = np.clip(picture / 255.0, 0, 1) ** np.exp(draw.normal(0, 0.35))
    light = 0.5 + (light - 0.5) * np.exp(draw.normal(-0.1, 0.25)) + draw.normal(0, 0.08)
    clouds = cv2.resize(draw.normal(size=(4, 5)), (width, height), interpolation=cv2.INTER_CUBIC)
    light = light * (1 + 0.15 * np.tanh(clouds))[..., None] * np.exp(draw.normal(0, 0.08, 3))
    return np.clip(255 * light, 0, 255).astype(np.uint8)


def another_season(picture: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """The picture in another season: green turns brown, yellow or white, with another texture."""
    values = picture.astype(float)
    green = values[..., 1] - values[..., [0, 2]].mean(-1)
    share = np.clip(green / 20.0, 0, 1)[..., None] * draw.uniform(0.5, 0.95)
    colour = np.array([[150, 130, 90], [190, 170, 80], [225, 225, 230]])[draw.integers(3)]
    grain = cv2.GaussianBlur(draw.normal(0, 60, picture.shape[:2]), (0, 0), 1.5)[..., None]
    return np.clip(values * (1 - share) + (colour + grain) * share, 0, 255).astype(np.uint8)


def vehicles_moved(picture: np.ndarray, draw: np.random.Generator, gsd: float, per_hectare: float = 25.0) -> np.ndarray:
    """The picture with boxes of the size of cars painted over it: cars that came, and ground where others stood."""
    moved = picture.copy()
    height, width = picture.shape[:2]
    for _ in range(int(per_hectare * height * width * gsd**2 / 1e4)):
        centre = draw.uniform([0, 0], [width, height])
        size = np.array([4.5, 1.8]) / gsd
        colour = [int(c) for c in draw.choice([[240] * 3, [20] * 3, [120] * 3, [30, 30, 150], [90, 95, 90]])]
        box = cv2.boxPoints((tuple(centre), tuple(size), draw.uniform(0, 180)))
        cv2.fillPoly(moved, [np.rint(box * 16).astype(np.int32)], colour, cv2.LINE_AA, 4)
    return moved


def degraded(picture: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """Defocus, noise and JPEG."""
    soft = cv2.GaussianBlur(picture, (0, 0), draw.uniform(0.3, 1.5)).astype(float)
    noisy = np.clip(soft + draw.normal(0, draw.uniform(2, 6), picture.shape), 0, 255).astype(np.uint8)
    _, data = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, int(draw.integers(50, 90))])
    return cv2.imdecode(data, cv2.IMREAD_COLOR)


def leaning(
    picture: np.ndarray, draw: np.random.Generator, gsd: float, sd: float = 1.0, width: float = 12.0
) -> np.ndarray:
    """The picture with random shifts of one sigma `sd` [m], correlated over `width` [m]: relief and leaning roofs."""
    height, across = picture.shape[:2]
    coarse = (max(2, round(height * gsd / width)) + 1, max(2, round(across * gsd / width)) + 1)
    shifts = [
        cv2.resize(draw.normal(0, sd / gsd, coarse), (across, height), interpolation=cv2.INTER_CUBIC) for _ in "xy"
    ]
    y, x = np.indices((height, across), np.float32)
    return cv2.remap(
        picture,
        (x + shifts[0]).astype(np.float32),
        (y + shifts[1]).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REFLECT,
    )


def rebuilt(picture: np.ndarray, draw: np.random.Generator, gsd: float, share: float = 0.2) -> np.ndarray:
    """The picture with patches of 8 to 30 m, a `share` of its area, copied from other places in it."""
    new = picture.copy()
    height, width = picture.shape[:2]
    covered = 0.0
    while covered < share * height * width:
        h, w = (min(int(side), picture.shape[k] // 3) for k, side in enumerate(draw.uniform(8, 30, 2) / gsd))
        (y, v), (x, u) = draw.integers(0, height - h, 2), draw.integers(0, width - w, 2)
        new[y : y + h, x : x + w] = picture[v : v + h, u : u + w]
        covered += h * w
    return new


def other_date(picture: np.ndarray, draw: np.random.Generator, gsd: float) -> np.ndarray:
    """All of these changes: season, buildings, vehicles, lean, light, and another camera."""
    changed = vehicles_moved(rebuilt(another_season(picture, draw), draw, gsd), draw, gsd)
    return degraded(relit(leaning(changed, draw, gsd), draw), draw)
