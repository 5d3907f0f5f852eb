"""A picture with more pixels than it shows is measured in the size that it has in truth."""

from fractions import Fraction

import cv2
import numpy as np
import pytest

from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import UNKNOWN_RULER, Detections
from orthoscale.core.ruler import Ruler
from orthoscale.detect.effort import Effort
from orthoscale.detect.enlarged import enlargement
from orthoscale.detect.measurer import Measured, Measurer, MeasurerCard, _window
from orthoscale.detect.remeasure import remeasured
from orthoscale.detect.windows import windows_about
from orthoscale.sources.picture_file import resized


class Pixels:
    """An array as a picture."""

    def __init__(self, pixels):
        self.name, self.pixels = "pixels", pixels
        self.height, self.width = pixels.shape[:2]

    def read(self, x, y, width, height, out_width, out_height):
        return resized(self.pixels[y : y + height, x : x + width], out_width, out_height)


LENGTH = 24.0


def car_park(blur=0.6):
    """Cars of LENGTH x 10 px with windscreens and rear windows on noisy asphalt, and their boxes."""
    rng = np.random.default_rng(5)
    fine = 8
    canvas = np.full((300 * fine, 300 * fine, 3), 90, np.uint8)
    rows = []
    for x in range(40, 280, 44):
        for y in range(30, 280, 22):
            cx, cy = x + rng.uniform(-1, 1), y + rng.uniform(-1, 1)
            tone = int(rng.choice([30, 140, 180, 230]))
            for a, b, w, shade in ((0, LENGTH, 10, tone), (4, 3, 8.4, 40), (-6.5, 2, 8.0, 50)):
                low = (np.array([cx + a - b / 2, cy - w / 2]) * fine).round().astype(int)
                high = (np.array([cx + a + b / 2, cy + w / 2]) * fine).round().astype(int)
                canvas[low[1] : high[1], low[0] : high[0]] = shade
            rows.append([cx, cy, LENGTH, 10, 0.0])
    small = cv2.resize(cv2.GaussianBlur(canvas, (0, 0), blur * fine), (300, 300), interpolation=cv2.INTER_AREA)
    noisy = small + rng.normal(0, 3, small.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8), Boxes(np.array(rows), np.ones(len(rows)))


def times(pixels, boxes, factor):
    size = (round(pixels.shape[1] * factor), round(pixels.shape[0] * factor))
    return cv2.resize(pixels, size, interpolation=cv2.INTER_CUBIC), boxes.mapped(factor)


def about(pixels, boxes):
    return windows_about({"pixels": Pixels(pixels)}, {"pixels": boxes})


@pytest.mark.parametrize("factor", [1, 2, 3, 4])
def test_by_how_much_a_picture_is_enlarged_is_seen(factor):
    """Never more than it is, so that nothing is lost."""
    pixels, boxes = times(*car_park(), factor)
    assert factor / 1.5 <= enlargement(about(pixels, boxes)) <= factor
    assert enlargement(about(pixels[::factor, ::factor], boxes.mapped(1 / factor))) == 1


def test_where_nothing_was_found_nothing_is_reduced():
    assert enlargement(windows_about({}, {})) == 1
    assert enlargement(about(np.zeros((9, 9, 3), np.uint8), Boxes.empty())) == 1


@pytest.mark.parametrize("enlarged", [Fraction(1), Fraction(5, 4), Fraction(3, 2), Fraction(3)])
def test_a_window_holds_whole_pixels_of_the_reduced_picture(enlarged):
    reads = []

    class Asked(Pixels):
        def read(self, x, y, width, height, out_width, out_height):
            reads.append((width / out_width, height / out_height))
            return super().read(x, y, width, height, out_width, out_height)

    picture = Asked(np.zeros((211, 307, 3), np.uint8))
    for box in ([150.3, 100.2, 40, 17, 0.4], [4.0, 3.0, 40, 17, 0.4], [305.0, 209.0, 40, 17, 2.0]):
        _window(picture, np.array(box, float), enlarged)
    assert np.array(reads) == pytest.approx(float(enlarged))


@pytest.mark.slow
def test_a_vehicle_is_as_long_in_an_enlarged_picture():
    measurer = Measurer()
    pixels, boxes = car_park()
    some = boxes[::6]
    before = measurer(Pixels(pixels), some).boxes.xylwa
    large, there = times(pixels, some, 4)
    as_shown = measurer(Pixels(large), there, enlarged=Fraction(4)).boxes.xylwa
    assert np.median(as_shown[:, 2:4] / before[:, 2:4], axis=0) == pytest.approx(4, rel=0.02)
    assert as_shown[:, :2] == pytest.approx(4 * before[:, :2], abs=2.0)


class Knows:
    """A measurer that says the boxes it is given."""

    card, sha256 = MeasurerCard("a measurer", Ruler(margin_sd=(0.2, 0.1)), (2.0, 3.0), (0.8, 0.8), "cuboid"), "measurer"

    def __call__(self, picture, boxes, enlarged, contrast):
        n = len(boxes)
        kind = np.repeat([[0.7, 0.1, 0.1, 0.1, 0.0]], n, 0)
        return Measured(boxes, np.full((n, 4), 0.3), np.ones((n, 4)), kind, np.full(n, np.nan))


def test_where_pixels_show_less_than_they_are_edges_are_less_sure():
    """Nothing tells what blurred them."""
    margins = []
    for factor in (1, 4):
        pixels, boxes = times(*car_park(), factor)
        found = Detections({"pixels": boxes}, 1.0, UNKNOWN_RULER, (0.7, 0.5), "a detector", "detector")
        got = remeasured([Pixels(pixels)], found, Knows(), Effort(workers=1, cache=False))
        of_fine = float(enlargement(about(pixels, boxes)))
        margins.append(np.array(got.ruler.margin_sd) / of_fine)  # in pixels of what it shows
    assert margins[0] == pytest.approx((0.2, 0.1))
    assert (margins[1] > [0.9, 0.6]).all() and (margins[1] < [1.5, 1.0]).all()
