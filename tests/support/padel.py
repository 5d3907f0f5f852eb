"""Pictures of padel courts with exact truth: turf within walls, lines, net, and the walls' shadows."""

from __future__ import annotations

import cv2
import numpy as np

from support.painted import covered, photographed

FINE = 0.11  # [m/px] coarsest resolution at which pictures are drawn
BLUE_TURF, GREEN_TURF, TERRACOTTA = (45, 85, 150), (55, 105, 75), (150, 85, 60)
CONCRETE, ASPHALT, LAWN = (150, 148, 142), (100, 100, 103), (88, 108, 62)
HALF_LENGTH, HALF_WIDTH, SERVICE = 10.0, 5.0, 6.95  # [m]


def padel_lines(line=0.05):
    """Painted rectangles (x0, y0, x1, y1) [m] about the middle of a court, whose service lines' middles are 6.95 m from
    the net."""
    half = line / 2
    boxes = [(side * SERVICE - half, -HALF_WIDTH, side * SERVICE + half, HALF_WIDTH) for side in (-1, 1)]
    return [*boxes, (-SERVICE - 0.2, -half, SERVICE + 0.2, half)]


def padel_picture(
    courts, gsd, shape, *, ground=CONCRETE, turf=BLUE_TURF, paint=None, white=215, wall=(40, 42, 45), wear=0.0,
    sand=0.1, shadow=0.0, shade=0.0, blur_px=0.6, noise=2.5, seed=0,
):  # fmt: skip
    """RGB uint8 of `shape` (H, W) [px]. courts : ((x, y) of the middle [m] from the outer corner of the upper left
    pixel, angle [rad]). paint : rectangles [m] in place of the lines. wall : colour of its frame of 10 cm, None for
    none. wear : share of the paint that is gone. sand : how much lighter patches of turf are. shadow : [m] that two
    walls throw. shade : how dark part of the picture is."""
    rng = np.random.default_rng(seed)
    fine = int(np.ceil(gsd / FINE))
    height, width, pixel = shape[0] * fine, shape[1] * fine, gsd / fine
    x, y = np.meshgrid((np.arange(width) + 0.5) * pixel, (np.arange(height) + 0.5) * pixel)

    def patches(size):
        coarse = rng.normal(size=[max(4, int(side * pixel / size)) for side in (height, width)]).astype(np.float32)
        return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)[..., None]

    image = np.array(ground, float) + 6 * patches(3.0)
    for (cx, cy), angle in courts:
        c, s = np.cos(angle), np.sin(angle)
        u, v = (x - cx) * c + (y - cy) * s, (y - cy) * c - (x - cx) * s

        def painted(image, box, colour, share=1.0, u=u, v=v):
            cover = covered(u, v, pixel, box)[..., None] * share
            return image * (1 - cover) + cover * np.asarray(colour, float)

        if wall is not None:
            image = painted(image, (-HALF_LENGTH - 0.1, -HALF_WIDTH - 0.1, HALF_LENGTH + 0.1, HALF_WIDTH + 0.1), wall)
        inside = (-HALF_LENGTH, -HALF_WIDTH, HALF_LENGTH, HALF_WIDTH)
        image = painted(image, inside, np.array(turf) * (1 + sand * np.clip(patches(1.5), -1, 2)))
        left = 1 - np.clip(wear + 0.5 * wear * patches(0.8), 0, 1)
        for box in padel_lines() if paint is None else paint:
            image = painted(image, box, 3 * [white], left)
        image = painted(image, (-0.03, -HALF_WIDTH, 0.03, HALF_WIDTH), (225, 225, 225))  # the net's band
        if shadow:
            side = (-HALF_LENGTH, -HALF_WIDTH, HALF_LENGTH, -HALF_WIDTH + shadow)
            back = (-HALF_LENGTH, -HALF_WIDTH, -HALF_LENGTH + shadow, HALF_WIDTH)
            image *= 1 - 0.35 * np.maximum(covered(u, v, pixel, side), covered(u, v, pixel, back))[..., None]
    if shade:
        dark = (x * 0.8 + y * 0.6 > (shape[1] * 0.8 + shape[0] * 0.6) * gsd * 0.55)[..., None]
        image *= 1 - shade * dark
    return photographed(image, fine, shape, blur_px, noise, rng)


def padel_club(number, gsd, rng):
    """A `padel_picture` with random looks, and its courts: one, or three side by side."""
    count, gap, angle = (1, 1, 3)[number % 3], rng.choice([0.2, 1.0, 2.5]), rng.uniform(0, np.pi)
    side = max(count * (10 + gap) + 24, 34)
    shift = (np.arange(count) - (count - 1) / 2) * (10 + gap)
    places = side / 2 + np.outer(shift, [-np.sin(angle), np.cos(angle)]) + rng.uniform(-0.5, 0.5, 2)
    courts = [(place, angle) for place in places]
    return courts, padel_picture(
        courts, gsd, 2 * [round(side / gsd)],
        ground=(CONCRETE, ASPHALT, LAWN)[number // 3 % 3], turf=(BLUE_TURF, GREEN_TURF, TERRACOTTA)[number % 3],
        wall=(None, (40, 42, 45), (60, 110, 70))[rng.integers(3)], white=int(rng.uniform(180, 235)),
        wear=rng.uniform(0, 0.4), sand=rng.uniform(0, 0.2), shadow=rng.choice([0, 0.7, 2.5]),
        shade=rng.choice([0, 0.35]), blur_px=rng.uniform(0.5, 0.9), noise=rng.uniform(1, 3), seed=number,
    )  # fmt: skip
