"""Pictures of container yards with exact truth: rows of boxes with gaps, stacks of two heights, shadows."""

from __future__ import annotations

import cv2
import numpy as np

from support.painted import photographed

FINE = 0.05  # [m/px] coarsest resolution at which pictures are drawn
PAINTS = (
    (150, 45, 40), (40, 75, 135), (45, 105, 75), (125, 128, 130), (205, 205, 200), (200, 105, 45), (110, 60, 45),
)  # fmt: skip
WIDTH = 2.438  # [m]
LENGTHS = {20: 6.058, 40: 12.192, 45: 13.716}  # [m] by feet
STOREY = 2.591  # [m]


def yard(number, feet, rng):
    """Containers of a yard: (x, y) of the middle [m] from the yard's, storeys, paint. Blocks of three to seven side by
    side, one to three end to end."""
    length, gap, end_gap = LENGTHS[feet], rng.uniform(0.05, 0.4), rng.uniform(0.2, 0.5)
    beside, behind = rng.integers(3, 8), rng.integers(1, 4)
    boxes = []
    for i in range(behind):
        for j in range(beside):
            x = (i - (behind - 1) / 2) * (length + end_gap) + rng.normal(0, 0.03)
            y = (j - (beside - 1) / 2) * (WIDTH + gap)
            boxes.append(((x, y), int(rng.integers(1, 3)), PAINTS[rng.integers(len(PAINTS))]))
    return boxes


def yard_picture(
    boxes, feet, gsd, side=44.0, angle=0.3, *, ground=(120, 118, 114), sun=(0.5, 0.35), ribs=0.05, dirt=0.06,
    blur_px=0.6, noise=2.5, seed=0,
):  # fmt: skip
    """RGB uint8, `side` [m] wide and high. sun : length of shadows along x and y of the yard, in heights. ribs :
    relative change of brightness by corrugation. dirt : the same by patches of dirt."""
    rng = np.random.default_rng(seed)
    fine = int(np.ceil(gsd / FINE))
    count, pixel, length = round(side / gsd), gsd / fine, LENGTHS[feet]
    size = count * fine
    at = (np.arange(size) + 0.5) * pixel - side / 2
    x, y = np.meshgrid(at, at)
    c, s = np.cos(angle), np.sin(angle)
    u, v = x * c + y * s, y * c - x * s

    def patches(metres):
        coarse = rng.normal(size=2 * [max(4, int(side / metres))]).astype(np.float32)
        return cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC)

    image = np.array(ground, float) * (1 + dirt * patches(4.0)[..., None])
    image = _shaded(image, boxes, length, u, v, 0, sun)
    for storeys in (1, 2):
        for (cx, cy), height, paint in boxes:
            if height != storeys:
                continue
            roof = (np.abs(u - cx) < length / 2) & (np.abs(v - cy) < WIDTH / 2)
            rim = (np.abs(u - cx) > length / 2 - 0.06) | (np.abs(v - cy) > WIDTH / 2 - 0.06)
            wave = 1 + ribs * np.sign(np.sin(2 * np.pi * (u[roof] - cx) / 0.28)) * ~rim[roof] - 0.1 * rim[roof]
            fade = rng.uniform(0.85, 1.15)
            image[roof] = np.array(paint) * (fade * wave * (1 + dirt * patches(1.2)[roof]))[:, None]
        if storeys == 1:
            image = _shaded(image, boxes, length, u, v, 1, sun)
    return photographed(image, fine, (count, count), blur_px, noise, rng)


def _shaded(image, boxes, length, u, v, below, sun):
    """The picture with the shadows that boxes cast on what is `below` storeys high."""
    dark = np.zeros(u.shape, bool)
    for (cx, cy), storeys, _ in boxes:
        for share in np.linspace(0, 1, 12) if storeys > below else ():
            reach = share * (storeys - below) * STOREY
            dark |= (np.abs(u - cx - sun[0] * reach) < length / 2) & (np.abs(v - cy - sun[1] * reach) < WIDTH / 2)
    return np.where(dark[..., None], 0.4 * image, image)


def container_yard(number, gsd, rng):
    """A `yard_picture` with random looks, the number of containers in it, and their length [ft]."""
    feet = (40, 20, 40, 20, 45)[number % 5]
    boxes = yard(number, feet, rng)
    return yard_picture(
        boxes, feet, gsd, angle=rng.uniform(0, np.pi), sun=tuple(rng.uniform(-0.6, 0.6, 2)),
        ribs=rng.uniform(0.02, 0.08), blur_px=rng.uniform(0.5, 0.9), noise=rng.uniform(1, 3), seed=number,
    ), len(boxes), feet  # fmt: skip
