"""Pictures of painted courts with exact truth, drawn by the dimensions in the rules."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.special import ndtr

from support.painted import covered, photographed

FINE = 0.11  # [m/px] coarsest resolution at which pictures are drawn
GREEN, BLUE, CLAY, ASPHALT, GRASS = (70, 110, 85), (60, 95, 150), (150, 85, 60), (105, 105, 108), (85, 105, 60)


def tennis(line=0.05, base=0.075):
    """Painted rectangles (x0, y0, x1, y1) [m] about the middle of a court, 23.77 x 10.97 m to the outside of its
    lines."""
    x, y, single, service = 23.77 / 2, 10.97 / 2, 8.23 / 2, 6.40
    along = [(-x, s * e - line if s > 0 else -e, x, e if s > 0 else -e + line) for e in (y, single) for s in (-1, 1)]
    across = [(s * x - (base if s > 0 else 0), -y, s * x + (0 if s > 0 else base), y) for s in (-1, 1)]
    boxes = [(s * service - (line if s > 0 else 0), -single, s * service + (0 if s > 0 else line), single)
             for s in (-1, 1)]  # fmt: skip
    return [*along, *across, *boxes, (-service, -line / 2, service, line / 2)]


def outline(x, y, line=0.05):
    """Four lines inside a rectangle of 2 x by 2 y [m]."""
    return [(-x, -y, x, -y + line), (-x, y - line, x, y), (-x, -y, -x + line, y), (x - line, -y, x, y)]


def volleyball():
    """18 x 9 m to the outside, attack lines 3 m from the middle to their rear edges."""
    return [*outline(9, 4.5), (-0.025, -4.5, 0.025, 4.5), (-3, -4.5, -2.95, 4.5), (2.95, -4.5, 3, 4.5)]


def basketball(length=28.0, width=15.0, key=4.9, depth=5.8):
    """To the inside of the lines; keys to their outside, with their circles."""
    x, y, k = length / 2, width / 2, key / 2
    boxes = [*outline(x + 0.05, y + 0.05), (-0.025, -y, 0.025, y), (0, 0, 1.75, 1.8, 0, 0)]
    for side in (-1, 1):
        free = x - depth  # the far edge of the free-throw line is there
        boxes += [tuple(sorted((side * free, side * (free + 0.05))))]
        boxes[-1] = (boxes[-1][0], -k, boxes[-1][1], k)
        low, high = sorted((side * free, side * x))
        boxes += [(low, k - 0.05, high, k), (low, -k, high, -k + 0.05), (side * free, 0, 1.75, 1.8, -side, 0)]
    return boxes


def handball():
    """40 x 20 m to the outside; goal areas of 6 m about the posts of a goal of 3 m."""
    boxes = [*outline(20, 10), (-0.025, -10, 0.025, 10)]
    for side in (-1, 1):
        low, high = sorted((side * 14, side * 14.05))
        boxes += [(low, -1.5, high, 1.5)]
        boxes += [(side * 20, to * 1.5, 5.95, 6.0, -side, to) for to in (-1, 1)]
    return boxes


def penalty_area(line=0.10):
    """16.5 x 40.32 m and 5.5 x 18.32 m to the outside of the lines; the goal line runs on for 10 m."""
    boxes = [(8.25 - line, -30, 8.25, 30), (-8.25, -20.16, -8.25 + line, 20.16), (2.75, -9.16, 2.75 + line, 9.16)]
    for low, at in ((-8.25, 20.16), (2.75, 9.16)):
        boxes += [(low, at - line, 8.25, at), (low, -at, 8.25, -at + line)]
    return boxes


def centre_circle(line=0.10):
    """A circle of 9.15 m to the outside of its line, on a halfway line of 64 m."""
    return [(-32, -line / 2, 32, line / 2), (0, 0, 9.15 - line, 9.15, 0, 0)]


def court_picture(
    courts, gsd, shape, *, ground=ASPHALT, surface=GREEN, run_off=3.0, white=200, wear=0.0, blur_px=0.6, noise=2.5,
    shade=0.0, trees=0, seed=0,
):  # fmt: skip
    """RGB uint8 of `shape` (H, W) [px]. courts : (painted rectangles, (x, y) of the middle [m] from the outer corner of
    the upper left pixel, angle [rad]). wear : share of the paint that is gone, in patches. shade : how dark half of the
    picture is, with an oblique edge. trees : blobs of 2 to 4 m on the courts."""
    rng = np.random.default_rng(seed)
    fine = int(np.ceil(gsd / FINE))  # a lens blurs before pixels sum up: else a thin line anywhere in one looks alike
    height, width, gsd = shape[0] * fine, shape[1] * fine, gsd / fine
    x, y = np.meshgrid((np.arange(width) + 0.5) * gsd, (np.arange(height) + 0.5) * gsd)
    x, y = x.astype(np.float32), y.astype(np.float32)

    def patches(size):
        coarse = rng.normal(size=(max(4, int(height * gsd / size)), max(4, int(width * gsd / size)))).astype(np.float32)
        return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)

    picture = np.array(ground, np.float32) + 6 * patches(3.0)[..., None]
    for boxes, (cx, cy), angle in courts:
        c, s = np.cos(angle), np.sin(angle)
        u, v = (x - cx) * c + (y - cy) * s, (y - cy) * c - (x - cx) * s
        straight = [box for box in boxes if len(box) == 4]
        low, high = np.min(straight, 0)[:2] - run_off, np.max(straight, 0)[2:] + run_off
        flat = covered(u, v, gsd, (*low, *high))[..., None]
        picture = picture * (1 - flat) + flat * (np.array(surface, np.float32) + 3 * patches(2.0)[..., None])
        paint = np.zeros((height, width), np.float32)
        for box in boxes:
            edge = box if len(box) == 4 else (*np.subtract(box[:2], box[3]), *np.add(box[:2], box[3]))
            corners = np.array([(bx, by) for bx in edge[::2] for by in edge[1::2]]) @ [[c, s], [-s, c]] + (cx, cy)
            left, top = np.clip(np.floor(corners.min(0) / gsd - 1), 0, (width, height)).astype(int)
            right, bottom = np.clip(np.ceil(corners.max(0) / gsd + 1), 0, (width, height)).astype(int)
            part = np.s_[top:bottom, left:right]
            paint[part] = np.maximum(paint[part], covered(u[part], v[part], gsd, box))
        paint = paint * (1 - np.clip(wear + 0.5 * wear * patches(0.8), 0, 1))
        picture = picture + paint[..., None] * (white - picture)
        for _ in range(trees):
            at = rng.uniform(low, high)
            gap = np.hypot(u - at[0], v - at[1]) / rng.uniform(1.0, 2.0) + 0.25 * patches(0.6)
            picture = np.where((gap < 1)[..., None], np.array([40, 60, 35]) + 12 * patches(0.4)[..., None], picture)
    if shade:
        dark = (x * 0.8 + y * 0.6 > (width * 0.8 + height * 0.6) * gsd * 0.55).astype(np.float32)
        picture = picture * (1 - shade * dark[..., None])
    return photographed(picture.astype(np.float32), fine, shape, blur_px, noise, rng)


def court_along_rows(boxes, gsd, place, shape, *, ground=100, white=200, blur_px=0.6, noise=1.0, seed=0):
    """RGB uint8 of `shape` (H, W) [px], a court along the rows: paint is blurred, then integrated over each pixel, both
    exactly. `court_picture` draws with cells as wide as a line, which is less exact. Arguments as there.
    """
    blur = blur_px * gsd

    def within(edge, count):  # integral of the normal distribution about `edge`, over pixels [m]
        from_edge = (np.arange(count + 1) * gsd - edge) / blur
        below = blur * (from_edge * ndtr(from_edge) + np.exp(-0.5 * from_edge**2) / np.sqrt(2 * np.pi))
        return np.diff(below)

    bare = np.ones(shape)
    for x0, y0, x1, y1 in boxes:
        x, y = (
            (within(low + middle, count) - within(high + middle, count)) / gsd
            for low, high, middle, count in ((x0, x1, place[0], shape[1]), (y0, y1, place[1], shape[0]))
        )
        bare *= 1 - y[:, None] * x
    picture = np.repeat((ground + (white - ground) * (1 - bare))[..., None], 3, axis=2)
    picture += np.random.default_rng(seed).normal(0, noise, picture.shape)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)
