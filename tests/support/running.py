"""Pictures of running tracks with exact truth: lines at a constant spacing around two straights and two bends."""

from __future__ import annotations

import cv2
import numpy as np

from support.painted import photographed

RED, LAWN, LINES = (150, 78, 66), (84, 112, 62), (224, 222, 216)
FINE = 0.1  # [m/px] coarsest resolution at which pictures are drawn
STRAIGHT, RADIUS = 84.39, 36.5  # [m] World Athletics' standard track, to the inner edge


def running_track(gsd, side, middle=(0.0, 0.0), turn=0.3, lane=1.22, lanes=8, line=0.05, surface=RED, white=LINES,
                  blur_px=0.6, noise=3.0, drawn_at=FINE, seed=0):  # fmt: skip
    """RGB uint8 of a square of `side` [m] whose middle is at `middle` [m] of the track's frame, turned by `turn`."""
    rng = np.random.default_rng(seed)
    pixels, fine = round(side / gsd), int(np.ceil(gsd / drawn_at))
    step = gsd / fine
    x, y = np.meshgrid(*2 * [((np.arange(pixels * fine) + 0.5) * step - side / 2).astype(np.float32)])
    c, s = np.cos(turn), np.sin(turn)
    u, v = x * c + y * s + middle[0], y * c - x * s + middle[1]
    # distance from the inner edge, positive outwards
    out = np.hypot(np.maximum(np.abs(u) - STRAIGHT / 2, 0), v) - RADIUS
    texture = cv2.resize(rng.normal(size=2 * (max(4, int(side / 2)),)).astype(np.float32), x.shape[::-1])

    def share(low, high):
        return np.clip((np.minimum(high, out + step / 2) - np.maximum(low, out - step / 2)) / step, 0, 1)[..., None]

    image = np.array(LAWN, np.float32) + 6 * texture[..., None]
    on = share(-line, lane * lanes + 0.2)
    image = image * (1 - on) + on * (np.array(surface, np.float32) + 4 * texture[..., None])
    for k in range(lanes + 1):
        image += share(lane * k - line, lane * k) * (np.array(white, np.float32) - image)
    return photographed(image, fine, (pixels, pixels), blur_px, noise, rng)
