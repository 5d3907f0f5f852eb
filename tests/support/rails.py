"""Pictures of railway tracks with exact truth: sleepers on ballast, rusty rails with bright heads."""

from __future__ import annotations

import cv2
import numpy as np

from support.painted import covered, photographed

BALLAST, RUST, BRIGHT, TIMBER, SLAB = (120, 114, 106), (78, 62, 52), (205, 205, 205), (150, 146, 140), (140, 138, 132)
FINE = 0.03  # [m/px] coarsest resolution at which pictures are drawn


def track(y=0.0, gauge=1.435, head=0.072, sleeper=0.6, length=120.0, bright=BRIGHT, rng=None):
    """Boxes (x0, y0, x1, y1) [m] with colours: one track along x, with `gauge` between the inner sides of its rail
    heads."""
    rng = rng or np.random.default_rng(0)
    boxes = []
    if sleeper:
        for s in np.arange(-length / 2, length / 2, sleeper):
            at, level = s + rng.normal(0, 0.01), rng.normal(0, 6)
            boxes.append(((at - 0.13, y - 0.9 * gauge, at + 0.13, y + 0.9 * gauge), tuple(level + np.array(TIMBER))))
    for side in (-1, 1):
        at = y + side * (gauge + head) / 2
        boxes.append(((-length / 2, at - 0.075, length / 2, at + 0.075), RUST))
        boxes.append(((-length / 2, at - head / 2, length / 2, at + head / 2), bright))
    return boxes


def railway(boxes, gsd, side=60.0, turn=0.4, ground=BALLAST, blur_px=0.6, noise=4.0, bend=0.0, seed=0):
    """RGB uint8 of a square of `side` [m]: `boxes` with colours, turned by `turn` [rad] about its middle. `bend` :
    curvature [1/m] of the tracks."""
    rng = np.random.default_rng(seed)
    pixels, fine = round(side / gsd), int(np.ceil(gsd / FINE))
    step = gsd / fine
    x, y = np.meshgrid(*2 * [((np.arange(pixels * fine) + 0.5) * step - side / 2).astype(np.float32)])
    c, s = np.cos(turn), np.sin(turn)
    u, v = x * c + y * s, y * c - x * s
    v = v - 0.5 * bend * u**2
    small = rng.normal(size=(max(4, int(side / 0.3)),) * 2).astype(np.float32)
    texture = cv2.resize(small, x.shape[::-1], interpolation=cv2.INTER_LINEAR)
    image = np.array(ground, np.float32) + 5 * texture[..., None]
    for box, colour in boxes:
        whole = bool(bend) and box[2] - box[0] > 1
        sag = 0.5 * bend * ((box[0] + box[2]) / 2) ** 2
        reach = np.array([(a, b + sag) for a in np.clip(box[::2], -side, side) for b in box[1::2]])
        corners = reach @ np.array([[c, s], [-s, c]]) + side / 2
        low = np.clip(np.floor(corners.min(0) / step - 4), 0, pixels * fine).astype(int)
        high = np.clip(np.ceil(corners.max(0) / step + 4), 0, pixels * fine).astype(int)
        part = np.s_[:, :] if whole else np.s_[low[1] : high[1], low[0] : high[0]]
        if not image[part].size:
            continue
        share = covered(u[part], v[part], step, box)[..., None]
        image[part] += share * (np.array(colour, np.float32) - image[part])
    return photographed(image, fine, (pixels, pixels), blur_px, noise, rng)
