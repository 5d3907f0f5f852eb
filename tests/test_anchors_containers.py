"""Rows of containers: found by their roofs' outlines, measured to what rims are off, and nothing but such rows."""

import cv2
import numpy as np
import pytest
from support.containers import LENGTHS, PAINTS, WIDTH, yard, yard_picture
from support.markings import PAINT, picture, stroke

from orthoscale.anchors.containers import ContainerRows

SD = 0.08  # relative one sigma of what the vehicles say
SEEN = ContainerRows()


COLOURED = [paint for paint in PAINTS if np.ptp(paint) > 20]  # grey ones are as the ground is


def row(count, gap=0.2):
    """Boxes side by side, one storey high."""
    at = (np.arange(count) - (count - 1) / 2) * (WIDTH + gap)
    return [((0.0, y), 1, COLOURED[k % len(COLOURED)]) for k, y in enumerate(at)]


def found(boxes, feet, gsd, off=1.06, **looks):
    image = yard_picture(boxes, feet, gsd, 30.0, **looks)
    return SEEN.find(image, gsd * off, SD, "")


def nearest(anchor, gsd):
    """By how much the likelier scale is wrong."""
    return float(np.abs(anchor.metres_per_pixel() / gsd - 1).min())


@pytest.mark.parametrize("feet", LENGTHS)
@pytest.mark.parametrize("gsd, most", [(0.06, 0.004), (0.12, 0.006), (0.2, 0.012)])
def test_a_row_is_found_and_measured(feet, gsd, most):
    (anchor,) = found(row(5), feet, gsd)
    assert anchor.kind == "container" and anchor.count >= 4
    assert f"container of {feet} ft" in [standard.name for standard in anchor.standards]
    assert nearest(anchor, gsd) < most and 0.003 < anchor.relative_sd < 0.02
    assert np.abs(anchor.place * gsd + gsd / 2 - 15.0).max() < 1.5


@pytest.mark.parametrize(
    "looks",
    [{"angle": 1.9}, {"ribs": 0.1}, {"sun": (-0.5, 0.6)}, {"blur_px": 0.9}, {"dirt": 0.12}, {"off": 0.9}],
    ids=lambda looks: next(iter(looks)),
)
def test_it_is_found_in_other_looks(looks):
    (anchor,) = found(row(5), 40, 0.12, **looks)
    assert nearest(anchor, 0.12) < 0.01


@pytest.mark.parametrize("gap", [0.05, 0.4])
def test_gaps_of_any_width(gap):
    (anchor,) = found(row(5, gap=gap), 20, 0.1)
    assert nearest(anchor, 0.1) < 0.01


def test_stacks_of_two_heights_end_to_end():
    rng = np.random.default_rng(3)
    errors = []
    for number in range(4):
        image = yard_picture(yard(number, 40, rng), 40, 0.1, seed=number)
        errors += [nearest(anchor, 0.1) for anchor in SEEN.find(image, 0.1, SD, "")]
    assert len(errors) >= 3 and max(errors) < 0.02


def test_one_or_two_boxes_are_none():
    assert len(found(row(3), 40, 0.1)) == 1
    assert not found(row(2), 40, 0.1) and not found(row(1), 40, 0.1)


def test_boxes_with_room_between_are_none():
    """Lorries side by side, mobile homes."""
    for gap in (1.1, 3.0):
        assert not found(row(4, gap=gap), 40, 0.1, off=1.0)


def shapes(sides, gap, gsd, ground=(120, 118, 114), edge=None, angle=17.0):
    """A row of boxes of `sides` [m], several lengths if there are, with lines between if `edge` is their colour."""
    lengths, width = np.broadcast_to(sides[0], 5), sides[1]
    boxes = [(stroke(15, 6 + k * (width + gap), lengths[k], width), COLOURED[k]) for k in range(5)]
    if edge is None:  # no light falls between them
        boxes.insert(0, (stroke(15, 6 + 2 * (width + gap), min(lengths), 5 * width + 4 * gap), (35, 35, 35)))
    else:
        boxes = [(corners, ground) for corners, _ in boxes]
        boxes += [(stroke(15, 6 + (k - 0.5) * (width + gap), lengths[0] + gap, gap), edge) for k in range(6)]
        boxes += [(stroke(15 + at * (lengths[0] + gap) / 2, 6 + 2 * (width + gap), gap, 5 * (width + gap)), edge)
                  for at in (-1, 1)]  # fmt: skip
    return picture(boxes, gsd, (30, 30), angle, ground=ground if edge is None else (60, 60, 60))


@pytest.mark.parametrize("off", [0.9, 1.0, 1.1])
def test_boxes_of_another_shape_are_none(off):
    assert len(SEEN.find(shapes((12.192, WIDTH), 0.2, 0.1), 0.1, SD, "")) == 1
    for sides in ((9.0, 2.5), (12.2, 3.2), (4.4, 1.8), (8.0, 4.0)):
        assert not SEEN.find(shapes(sides, 0.2, 0.1), 0.1 * off, SD, "")


def test_boxes_of_unequal_lengths_are_none():
    lengths = 12.192 * np.array([0.92, 1.02, 0.95, 1.07, 0.98])
    assert not SEEN.find(shapes((lengths, WIDTH), 0.2, 0.1), 0.1, SD, "")


def test_painted_bays_are_none():
    """Empty ones of 2.44 x 6.06 m, closed by a line all round: what is between them is brighter."""
    assert len(SEEN.find(shapes((6.058, WIDTH), 0.12, 0.06, edge=(40, 40, 40)), 0.06, SD, "")) == 1
    assert not SEEN.find(shapes((6.058, WIDTH), 0.12, 0.06, edge=PAINT), 0.06, SD, "")


@pytest.mark.real
def test_american_trailers_in_a_yard(data):
    """A picture of exactly 0.3048 m/px: white ones of 53 ft, side by side and end to end."""
    picture = cv2.imread(str(data / "vehicles" / "chips" / "storagetanks40.jpg"))[..., ::-1]
    (anchor,) = SEEN.find(picture, 0.3048 * 0.95, SD, "US")
    assert "container or trailer of 53 ft" in [standard.name for standard in anchor.standards]
    assert nearest(anchor, 0.3048) < 0.01 and anchor.count == 6
    (other,) = SEEN.find(picture, 0.3048 * 0.95, SD, "DE")  # elsewhere there are none of 53 ft
    assert max(standard.metres for standard in other.standards) < 14


@pytest.mark.parametrize("gsd", [0.05, 0.3, 5.0])
def test_an_odd_picture_has_none(gsd):
    for image in (
        np.zeros((1, 1, 3), np.uint8),
        np.zeros((5, 900, 3), np.uint8),
        np.full((200, 200, 3), 255, np.uint8),
        np.random.default_rng(0).integers(0, 256, (250, 240, 3), np.uint8),
    ):
        assert not SEEN.find(image, gsd, 0.1, "")
