"""The training targets of a crop: boxes encoded on a grid of stride 4.

Seven maps: heat (a peak at each vehicle's centre), the centre's offset within its cell (x, y, in cells), the logarithm
of length/32 px and width/14 px, and the cosine and sine of twice the angle (a box turned by half a turn is the same).
`orthoscale.detect.decoders` reads them back.
"""

from __future__ import annotations

import cv2
import numpy as np

CROP = 256  # side of a training crop [px]
STRIDE = 4  # pixels per cell
LENGTH_UNIT, WIDTH_UNIT = 32.0, 14.0  # [px] typical vehicle, so that the logarithms start near zero
MIN_LENGTH = 10.0  # [px] shorter vehicles are neither learnt nor background
EDGE = 4.0  # [px] a vehicle whose centre is closer to the crop's edge is cut too much to be learnt


def encode(boxes: np.ndarray, is_vehicle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Boxes (N, 5) to (heat, weight of the background, values (6, n, n), weight of the vehicles), float32 (n, n).

    A vehicle's weight is proportional to its area. With equal weights, most is learnt from crops that show many small
    vehicles (three in four were below 27 px), and if the network is not sure of a size it gives theirs: at new places
    it measured vehicles of 17 px right, and those of 38 px, at which it is used, 8 to 20 % too short.
    """
    n = CROP // STRIDE
    heat = np.zeros((n, n), np.float32)
    background = np.ones((n, n), np.float32)
    values = np.zeros((6, n, n), np.float32)
    value_weight = np.zeros((n, n), np.float32)
    for (cx, cy, length, width, angle), vehicle in zip(boxes, is_vehicle, strict=True):
        if min(cx, cy) < -length or max(cx, cy) > CROP + length:
            continue
        inside = EDGE < cx < CROP - EDGE and EDGE < cy < CROP - EDGE
        if not vehicle or not inside or length < MIN_LENGTH:
            rectangle = ((cx / STRIDE - 0.5, cy / STRIDE - 0.5), (length / STRIDE, width / STRIDE), np.degrees(angle))
            cv2.fillConvexPoly(background, np.round(cv2.boxPoints(rectangle)).astype(np.int32), 0.0)
            continue
        gx, gy = cx / STRIDE - 0.5, cy / STRIDE - 0.5  # in cells, cell centres at integers
        ix, iy = round(gx), round(gy)
        if not (0 <= ix < n and 0 <= iy < n):
            continue
        _splat(heat, ix, iy, length / STRIDE, width / STRIDE, angle)
        weight = length * width / (LENGTH_UNIT * WIDTH_UNIT)
        box_values = (np.log(length / LENGTH_UNIT), np.log(width / WIDTH_UNIT), np.cos(2 * angle), np.sin(2 * angle))
        for y in range(max(0, iy - 1), min(n, iy + 2)):
            for x in range(max(0, ix - 1), min(n, ix + 2)):
                centre = x == ix and y == iy
                if centre or value_weight[y, x] == 0:
                    values[:, y, x] = (gx - x, gy - y, *box_values)
                    value_weight[y, x] = weight if centre else 0.3 * weight
    return heat, background, values, value_weight


def _splat(heat: np.ndarray, ix: int, iy: int, length: float, width: float, angle: float) -> None:
    """Draw a Gaussian peak along the box (all in cells); where peaks overlap, the larger value stays."""
    sigma_long, sigma_short = max(0.13 * length, 0.55), max(0.16 * width, 0.5)
    reach = int(3 * sigma_long + 2)
    n = len(heat)
    y0, y1, x0, x1 = max(0, iy - reach), min(n, iy + reach + 1), max(0, ix - reach), min(n, ix + reach + 1)
    y, x = np.mgrid[y0:y1, x0:x1]
    u = (x - ix) * np.cos(angle) + (y - iy) * np.sin(angle)
    v = -(x - ix) * np.sin(angle) + (y - iy) * np.cos(angle)
    peak = np.exp(-0.5 * ((u / sigma_long) ** 2 + (v / sigma_short) ** 2)).astype(np.float32)
    heat[y0:y1, x0:x1] = np.maximum(heat[y0:y1, x0:x1], peak)
