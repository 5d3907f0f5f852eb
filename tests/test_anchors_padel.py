"""Padel courts: found by their lines within their walls, and by nothing less."""

import numpy as np
import pytest
from support.courts import court_picture, tennis
from support.padel import (
    ASPHALT,
    BLUE_TURF,
    CONCRETE,
    GREEN_TURF,
    HALF_LENGTH,
    HALF_WIDTH,
    LAWN,
    SERVICE,
    TERRACOTTA,
    padel_lines,
    padel_picture,
)

from orthoscale.anchors.courts import TENNIS
from orthoscale.anchors.padel import PadelCourts

SD = 0.08  # relative one sigma of what the vehicles say
SIDE = 34.0  # [m] of a picture
PADEL = PadelCourts()


def court(gsd=0.12, angle=0.4, off=1.06, count=1, gap=1.0, **looks):
    """Middles [px] of `count` courts side by side, and what is found if the vehicles are wrong by the factor `off`."""
    side = SIDE + (count - 1) * (10 + gap)
    shift = (np.arange(count) - (count - 1) / 2) * (10 + gap)
    places = side / 2 + np.outer(shift, [-np.sin(angle), np.cos(angle)])
    picture = padel_picture([(place, angle) for place in places], gsd, 2 * [round(side / gsd)], **looks)
    return places / gsd - 0.5, PADEL.find(picture, gsd * off, SD, "")


def error(anchor, gsd):
    return float(anchor.metres_per_pixel()[0] / gsd - 1)


@pytest.mark.parametrize("gsd, most", [(0.06, 0.001), (0.12, 0.001), (0.2, 0.004)])
@pytest.mark.parametrize("turf", [BLUE_TURF, GREEN_TURF, TERRACOTTA])
def test_a_court_is_found_and_measured(gsd, most, turf):
    (middle,), (found,) = court(gsd, turf=turf)
    assert abs(error(found, gsd)) < most
    assert np.abs(found.place - middle).max() < 0.1 / gsd
    assert found.kind == "padel court" and found.false < 0.1 and 0.001 < found.relative_sd < 0.01


@pytest.mark.parametrize(
    "looks",
    [
        {"wear": 0.4},
        {"shade": 0.4},
        {"shadow": 2.5},
        {"wall": None},
        {"ground": LAWN, "turf": GREEN_TURF},
        {"sand": 0.25},
        {"off": 0.88},
        {"angle": 2.8},
    ],
    ids=lambda looks: next(iter(looks)),
)
def test_it_is_found_in_other_looks(looks):
    _, (found,) = court(**looks)
    assert abs(error(found, 0.12)) < 0.002


@pytest.mark.parametrize("gap", [0.2, 1.0, 2.5])
def test_courts_side_by_side_are_each_found_once(gap):
    """The lines of neighbours make the same figure, turned by a quarter."""
    middles, found = court(0.1, count=3, gap=gap)
    gaps = np.linalg.norm(middles[:, None] - [anchor.place for anchor in found], axis=2)
    assert len(found) == 3 and gaps.min(1).max() < 1.0


def test_its_lines_alone_are_none():
    """On ground that does not end at walls, or ends elsewhere, or that is grey."""
    paint = padel_lines()
    assert len(court()[1]) == 1
    for run_off in (3.0, 6.0, 20.0):
        image = court_picture([(paint, (17, 17), 0.4)], 0.12, (283, 283), surface=BLUE_TURF, run_off=run_off)
        assert not PADEL.find(image, 0.12, SD, "")
    assert not court(turf=(125, 120, 115), ground=LAWN)[1]
    assert not court(turf=GREEN_TURF, ground=(62, 110, 74), wall=None, noise=0.3)[1]


def test_walls_elsewhere_are_none():
    """All of a court a fifteenth smaller than its walls: as another game's would be."""
    smaller = [tuple(np.array(box) / 1.07) for box in padel_lines()]
    assert not court(paint=smaller)[1]


def test_walls_that_are_not_straight_are_none():
    """Ground that reaches into the turf at half of each wall."""
    image = padel_picture([((17, 17), 0.0)], 0.12, (283, 283))
    for k in (0, 1, 2, 3):
        turned = np.rot90(image, k)
        length, wall = (41, 83) if k % 2 else (83, 41)
        turned[141 - wall : 141 - wall + 9, 141 - length + 4 : 141 - 10] = CONCRETE
    assert not PADEL.find(image, 0.12, SD, "")


def test_two_walls_are_not_enough():
    """Turf that goes on beyond both ends."""
    long = padel_picture([((17, 17), 0.0)], 0.12, (283, 283), wall=None)
    assert len(PADEL.find(long, 0.12, SD, "")) == 1
    for rows, fewest in ((np.s_[1:], 1), (np.s_[:], 0)):  # one end, and both
        image = long.copy()
        for low, high in [(10, 60), (223, 273)][rows]:
            image[98:185, low:high] = BLUE_TURF
        assert len(PADEL.find(image, 0.12, SD, "")) == fewest


def test_turf_of_many_colours_is_none():
    """Other fields between the lines, none of them at a wall."""
    image = padel_picture([((17, 17), 0.0)], 0.12, (283, 283))
    assert len(PADEL.find(image, 0.12, SD, "")) == 1
    for x in (-6.4, 1.0):
        for y in (-3.4, 0.6):
            (left, top), (right, bottom) = (
                np.round((np.array(at) + 17) / 0.12).astype(int) for at in ((x, y), (x + 5.4, y + 2.8))
            )
            image[top:bottom, left:right] = image[top:bottom, left:right, ::-1]
    assert not PADEL.find(image, 0.12, SD, "")


def test_walls_without_its_lines_are_none():
    """None, the halfway line and sides, and two lines of three."""
    outline = [(-HALF_LENGTH, at - 0.05, HALF_LENGTH, at + 0.05) for at in (-HALF_WIDTH + 0.5, HALF_WIDTH - 0.5)]
    for paint in ([], outline, padel_lines()[:2], padel_lines()[1:]):
        assert not court(paint=paint)[1]
    assert not court(paint=[(-SERVICE, -0.025, SERVICE, 0.025), *padel_lines()[:1]])[1]
    assert not court(paint=[(-SERVICE, -0.025, -2.5, 0.025), *padel_lines()[:2]])[1]


def test_its_lines_among_others_are_none():
    more = [(-SERVICE, at - 0.03, SERVICE, at + 0.03) for at in (-1.7, -1.3, 1.3, 1.7)]
    more += [(at - 0.03, -HALF_WIDTH, at + 0.03, HALF_WIDTH) for at in (-8.65, 8.65)]
    assert not court(paint=[*padel_lines(), *more])[1]


def test_tennis_courts_are_no_padel_courts_nor_these_those():
    for off in (0.85, 1.0, 1.15):
        image = court_picture([(tennis(), (18, 18), 0.4)], 0.15, (240, 240), ground=ASPHALT, run_off=0.1)
        assert not PADEL.find(image, 0.15 * off, SD, "")
        assert not TENNIS.find(padel_picture([((17, 17), 0.4)], 0.15, (227, 227)), 0.15 * off, SD, "")


@pytest.mark.parametrize("gsd", [0.05, 0.3, 5.0])
def test_an_odd_picture_has_no_court(gsd):
    for picture in (
        np.zeros((1, 1, 3), np.uint8),
        np.zeros((5, 900, 3), np.uint8),
        np.random.default_rng(0).integers(0, 256, (250, 240, 3), np.uint8),
    ):
        assert not PADEL.find(picture, gsd, 0.1, "")
