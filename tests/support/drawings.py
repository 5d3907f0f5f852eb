"""Pictures of rectangles with known truth, and a detector for them without a network; and vehicles for the networks."""

from __future__ import annotations

import cv2
import numpy as np

from orthoscale.core.boxes import Boxes
from orthoscale.core.ruler import Ruler
from orthoscale.detect.detector import VEHICLES, Card, Passes
from orthoscale.synthetic.render import ortho_view, render
from orthoscale.synthetic.scene import make_scene

RENDERED_VEHICLES = 4
CARD = Card("drawn rectangles", (12, 70), 38, 0.4, (0.8, 0.8), Ruler())


class Drawing:
    """A picture of white rectangles on grey ground, drawn at twice its resolution."""

    FINER = 2

    def __init__(self, width, height, boxes, name="drawing"):
        self.name, self.width, self.height = name, width, height
        canvas = np.full((height * self.FINER, width * self.FINER, 3), 90, np.uint8)
        for corners in boxes.mapped(self.FINER).corners:
            cv2.fillPoly(canvas, [np.round(corners - 0.5).astype(np.int32)], (250, 250, 250))
        self._pixels = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA)

    def read(self, x, y, width, height, out_width, out_height):
        assert x >= 0 and y >= 0 and x + width <= self.width and y + height <= self.height
        shrink = out_width < width
        window = self._pixels[y : y + height, x : x + width]
        how = cv2.INTER_AREA if shrink else cv2.INTER_CUBIC
        return cv2.resize(window, (out_width, out_height), interpolation=how)


class Windows:
    """A picture of `width` x `height` px of which detectors need to know only which window they were given.

    `window` is the last one that was read: its left and upper end and its width [px of the picture].
    """

    name = "windows"

    def __init__(self, width, height):
        self.width, self.height = width, height
        self.window = (0, 0, width)

    def read(self, x, y, width, height, out_width, out_height):
        self.window = (x, y, width)
        image = self.shown(x, y, width, height, out_width, out_height).view(_Window)
        image.window = self.window
        return image

    def shown(self, x, y, width, height, out_width, out_height):
        """Its pixels: black."""
        return np.zeros((out_height, out_width, 3), np.uint8)

    def window_of(self, image):
        """x, y [px of the picture] and resampling factor of the window that `image` is, or was made of when it was the
        last one read."""
        x, y, width = getattr(image, "window", self.window)
        return x, y, image.shape[1] / width


class _Window(np.ndarray):
    """The pixels of a window: several may be read before a detector sees the first."""


class WithoutNetwork:
    """A detector of vehicles only, which is called with whole images."""

    confirming, passes, takes_parts = None, Passes.FINE_FIRST, False

    def see(self, image, threshold=None):
        return {VEHICLES: self(image, threshold)}


class RectangleDetector(WithoutNetwork):
    """Finds white rectangles, like a network only in its range of sizes; its false boxes have its favourite size."""

    card = CARD
    name, sha256, sure = "rectangles", "a" * 64, 0.0

    def __init__(self, mistakes=0, seed=0):
        self.mistakes, self.rng = mistakes, np.random.default_rng(seed)

    def __call__(self, image, threshold=None):
        contours, _ = cv2.findContours((image[..., 0] > 170).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        rows = []
        for contour in contours:
            (cx, cy), (w, h), degrees = cv2.minAreaRect(contour)
            rows.append((cx + 0.5, cy + 0.5, w + 1, h + 1, np.radians(degrees)))
        found = Boxes(np.array(rows).reshape(-1, 5), np.full(len(rows), 0.8))
        low, high = CARD.usable_length
        found = found[(found.length > low) & (found.length < high) & (found.width > 3)]
        n = self.mistakes
        size = self.rng.normal([36, 16], 4, (n, 2)).clip(8)
        spots = self.rng.uniform(0, 1, (n, 2)) * image.shape[1::-1]
        wrong = Boxes(np.column_stack([spots, size, self.rng.uniform(-1.5, 1.5, n)]), np.full(n, 0.5))
        return Boxes.concatenate([found, wrong])


def car_park(length, width, height, count, seed=0):
    """Boxes of about `length` px that do not overlap, in a picture of `width` x `height` px."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(200 * count):
        own = length * np.exp(rng.normal(0, 0.08))
        spot = rng.uniform(0.6 * length, [width - 0.6 * length, height - 0.6 * length])
        if all(np.hypot(*(spot - r[:2])) > 1.3 * length for r in rows):
            rows.append(np.array([*spot, own, own / 2.4, rng.uniform(-1.5, 1.5)]))
        if len(rows) == count:
            break
    return Boxes(np.array(rows), np.ones(len(rows)))


def rendered_vehicles() -> np.ndarray:
    """RGB uint8 (82, 102, 3), RENDERED_VEHICLES side by side, 38 px long. The shipped networks find these, but not
    drawn rectangles."""
    scene = make_scene(3, None, 40, 8, "carpark")
    pixels, _ = render(scene, ortho_view(scene, 4.45 / 38), 1)
    return pixels[30:112, 220:322]
