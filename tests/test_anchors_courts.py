"""Painted courts: found where they are, measured to what was drawn, and not where other lines are."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.courts import (
    ASPHALT,
    BLUE,
    CLAY,
    GRASS,
    GREEN,
    basketball,
    centre_circle,
    court_along_rows,
    court_picture,
    handball,
    penalty_area,
    tennis,
    volleyball,
)
from support.pictures import ODD_PICTURES

from orthoscale.anchors.court_fit import CourtFit, fit_court
from orthoscale.anchors.court_models import CENTRE_CIRCLE, HANDBALL_COURT, TENNIS_COURT
from orthoscale.anchors.courts import (
    BASKETBALL,
    FOOTBALL,
    HANDBALL,
    TENNIS,
    VOLLEYBALL,
    CourtLook,
    evidence,
    overlap,
)

SD = 0.08  # relative one sigma of what the vehicles say


def court(gsd, angle=0.4, off=1.07, seed=0, paint=None, **looks):
    """A picture of one court and what is found in it, if the vehicles are wrong by the factor `off`."""
    side = 38.0
    picture = court_picture([(paint or tennis(), (side / 2, side / 2), angle)], gsd, 2 * [round(side / gsd)],
                            seed=seed, **looks)  # fmt: skip
    return picture, TENNIS.find(picture, gsd * off, SD, "")


def error(anchor, gsd):
    return float(anchor.metres_per_pixel()[0] / gsd - 1)


@pytest.mark.parametrize("surface", [GREEN, CLAY])
@pytest.mark.parametrize("blur", [0.35, 0.9])
def test_in_coarse_pictures_its_sides_do_not_merge(surface, blur):
    """At 0.5 m/px the doubles and singles lines are 2.7 px apart, sharp or not; broad lines, so that they are seen."""
    for seed, angle in enumerate((0.1, 0.4, 0.7, 1.2)):
        looks = {"ground": GRASS, "surface": surface, "white": 240, "blur_px": blur, "noise": 1.0}
        _, (found,) = court(0.5, angle, 1.0, seed, tennis(0.08, 0.1), **looks)
        lengths = np.linalg.norm(np.diff(found.lines, axis=1)[:, 0], axis=1) * 0.5
        assert sorted(lengths)[2] == pytest.approx(10.97 - 0.08, rel=0.005)  # a base line


def test_coarse_pictures_are_measured_in_what_jpeg_keeps():
    """Colours at half the resolution, as in JPEG, beside lines of 0.1 to 0.2 pixels."""
    side, sizes = 38.0, []
    paint = [(tennis(0.08, 0.1), (side / 2, side / 2), 0.05)]
    picture = court_picture(paint, 0.5, (76, 76), ground=GRASS, surface=CLAY, white=240, noise=1.0)
    colours = cv2.cvtColor(picture, cv2.COLOR_RGB2YCrCb)
    halved = cv2.resize(cv2.resize(colours, (38, 38), interpolation=cv2.INTER_AREA), (76, 76))
    halved[..., 0] = colours[..., 0]
    for each in (colours, halved):
        (found,) = TENNIS.find(cv2.cvtColor(each, cv2.COLOR_YCrCb2RGB), 0.5, SD, "")
        sizes.append(found.pixels)
    assert sizes[1] == pytest.approx(sizes[0], rel=2e-4)


@pytest.mark.parametrize("gsd", [0.3, 0.41, 0.5])
@pytest.mark.parametrize("turned", [False, True])
def test_where_lines_along_rows_or_columns_lie_in_their_pixels_hardly_matters(gsd, turned):
    """All of such a line lies in one place of a pixel, and is seen nearer to the middle of the pixel than it is."""
    errors = []
    for seed, within in enumerate(np.random.default_rng(1).uniform(0, gsd, (6, 2))):
        looks = {"white": 230, "blur_px": 0.5, "seed": seed}
        picture = court_along_rows(tennis(0.05, 0.0625), gsd, 17 + within, 2 * [round(34 / gsd)], **looks)
        picture = np.ascontiguousarray(picture.transpose(1, 0, 2)) if turned else picture
        (found,) = TENNIS.find(picture, gsd, SD, "")
        errors.append(error(found, gsd))
    assert np.std(errors) < {0.3: 0.0005, 0.41: 0.0015, 0.5: 0.0015}[gsd]
    assert np.abs(errors).max() < 0.003


@pytest.mark.parametrize("gsd", [0.06, 0.15, 0.3, 0.5])
@pytest.mark.parametrize("angle", [0.0, 0.4, 2.3])
def test_a_court_is_found_and_measured(gsd, angle):
    _, found = court(gsd, angle, noise=2.0 if gsd > 0.4 else 2.5)  # a tenth of a pixel is paint there
    assert len(found) == 1
    assert abs(error(found[0], gsd)) < (0.003 if gsd < 0.4 else 0.006)
    middle = np.array([19.0, 19.0]) / gsd - 0.5  # pixel coordinates count from the middle of the first pixel
    assert np.abs(found[0].place - middle).max() < 0.15 / gsd
    assert found[0].false < 0.1 and 0.001 < found[0].relative_sd < 0.008
    assert np.sqrt(np.mean(found[0].residual ** 2)) * gsd < 0.15


@pytest.mark.parametrize(
    "looks",
    [
        {"surface": CLAY, "ground": GRASS},
        {"surface": BLUE, "ground": GREEN, "white": 150},
        {"wear": 0.45},
        {"shade": 0.5},
        {"trees": 4},
        {"blur_px": 1.0},
        {"noise": 7.0},
    ],
    ids=lambda looks: next(iter(looks)),
)
@pytest.mark.parametrize("gsd", [0.1, 0.3])
def test_it_is_found_in_other_looks(gsd, looks):
    _, found = court(gsd, seed=3, **looks)
    assert len(found) == 1
    assert abs(error(found[0], gsd)) < 0.006


@pytest.mark.parametrize("off", [0.86, 1.15])
def test_what_the_vehicles_say_does_not_move_it(off):
    assert abs(error(court(0.3, off=off)[1][0], 0.3)) < 0.003


@pytest.mark.parametrize("off", [0.7, 1.4])
def test_a_court_of_another_size_than_the_vehicles_allow_is_none(off):
    assert not court(0.3, off=off)[1]


def test_courts_side_by_side_are_each_found_once():
    paint = tennis()
    places = [(12.0 + 16.5 * k, 19.0) for k in range(4)]
    picture = court_picture([(paint, place, np.pi / 2) for place in places], 0.3, (127, 250))
    found = TENNIS.find(picture, 0.31, SD, "")
    assert sorted(round(float(a.place[0] * 0.3 + 0.15 - 12.0) / 16.5) for a in found) == [0, 1, 2, 3]
    assert max(abs(error(a, 0.3)) for a in found) < 0.004


def test_no_court_lies_on_another():
    """Nor one between two neighbours, with their outer lines for its own: courts 12.8 m wide to the middle of the gap
    are the nearest that the rules allow beside each other."""
    picture, _ = court(0.3, 0.0)
    (fit,) = CourtLook(picture, 0.3, SD).fits(TENNIS_COURT)
    for off, lies_on_it in ((5.5, True), (9.0, True), (10.2, True), (11.0, False), (14.6, False)):
        assert overlap(fit, fit.place + np.array([0.0, off]) / 0.3) is lies_on_it


def test_the_width_of_the_base_line_matters_little():
    errors = [error(court(0.1, paint=tennis(base=base))[1][0], 0.1) for base in (0.05, 0.1)]
    assert max(np.abs(errors)) < 0.003


LIGHT, DARK = (130, 165, 200), (60, 80, 60)


@pytest.mark.parametrize("surface, ground", [(LIGHT, DARK), (DARK, LIGHT)], ids=["lighter", "darker"])
@pytest.mark.parametrize("gsd, most", [(0.15, 0.0025), (0.3, 0.0095)])
def test_a_court_of_another_colour_than_what_is_around(surface, ground, gsd, most):
    """Its outer lines lie on a step, which moves their ridges by 0.6 and 2.0 % of a court. More than half is undone."""
    _, found = court(gsd, surface=surface, ground=ground, run_off=0.0, white=230)
    assert len(found) == 1 and abs(error(found[0], gsd)) < most


def turned(picture):
    return {
        "mirrored": picture[:, ::-1],
        "turned": np.rot90(picture),
        "upside down": picture[::-1, ::-1],
        "not contiguous": np.asfortranarray(picture),
    }


@pytest.mark.parametrize("how", ["mirrored", "turned", "upside down", "not contiguous"])
def test_the_answer_does_not_depend_on_how_the_picture_lies(how):
    picture, found = court(0.3, angle=0.3)
    other = TENNIS.find(turned(picture)[how], 0.3 * 1.07, SD, "")
    assert len(other) == 1
    assert other[0].pixels == pytest.approx(found[0].pixels, rel=1e-3)


def test_a_bare_rectangle_is_none():
    """Nor the outline of a court, nor one with its centre line."""
    outline = [tennis()[k] for k in (0, 1, 4, 5)]
    assert len(court(0.2, paint=tennis())[1]) == 1
    assert not court(0.2, paint=outline)[1]
    assert not court(0.2, paint=[*outline, tennis()[8]])[1]


def test_half_a_court_is_none():
    half = [(max(x0, 0), y0, x1, y1) for x0, y0, x1, y1 in tennis() if x1 > 0]
    assert not court(0.2, paint=half)[1]


OTHERS = [
    (VOLLEYBALL, volleyball(), "FIVB volleyball court", 18.0),
    (BASKETBALL, basketball(), "FIBA basketball court", 28.0),
    (BASKETBALL, basketball(28.651, 15.24, 3.66, 5.79), "US college basketball court", 28.651),
    (BASKETBALL, basketball(25.603, 15.24, 3.66, 5.79), "US high school basketball court", 25.603),
    (HANDBALL, handball(), "IHF handball court", 40.0),
    (FOOTBALL, penalty_area(), "IFAB penalty area", 40.32),
    (FOOTBALL, centre_circle(), "IFAB centre circle", 18.30),
]


@pytest.mark.parametrize("finder, paint, name, metres", OTHERS, ids=[row[2] for row in OTHERS])
@pytest.mark.parametrize("gsd, angle", [(0.12, 0.7), (0.3, 0.0), (0.3, 3.9)])
def test_other_courts_are_found_and_measured(finder, paint, name, metres, gsd, angle):
    side = finder.extent + 6
    picture = court_picture([(paint, (side / 2, side / 2), angle)], gsd, 2 * [round(side / gsd)], seed=1)
    found = finder.find(picture, gsd * 0.95, SD, "")
    assert [anchor.standards[0].name for anchor in found] == [name]
    assert abs(error(found[0], gsd)) < 0.003 and found[0].standards[0].metres == metres
    assert found[0].kind == finder.kind and found[0].false < 0.1


def test_the_goal_area_of_handball_is_measured_from_the_goal_lines_outer_edge():
    """IHF Rules of the Game, 1:4: 6 m from the rear edge of the goal line, which is 20 m from the middle, to the front
    edge of a line of 5 cm."""
    arcs = [stroke for stroke in HANDBALL_COURT.strokes if stroke.radius]
    assert [(abs(arc.start[0]), arc.radius) for arc in arcs] == 4 * [pytest.approx((20.0, 5.975))]
    fronts = [stroke for stroke in HANDBALL_COURT.strokes if stroke.length == 3.0]
    assert [(abs(front.start[0]), abs(front.end[0])) for front in fronts] == 2 * [pytest.approx((14.025, 14.025))]


@pytest.mark.slow
@pytest.mark.parametrize("finder", [VOLLEYBALL, BASKETBALL, HANDBALL, FOOTBALL], ids=lambda finder: finder.kind)
def test_tennis_courts_are_no_other_courts(finder):
    places = [(12.0 + 16.5 * k, 20.0) for k in range(3)]
    picture = court_picture([(tennis(), place, np.pi / 2) for place in places], 0.3, (133, 195))
    for off in (0.85, 1.0, 1.15):
        assert not finder.find(picture, 0.3 * off, SD, "")


def bays(gsd, rows=5, pitch=2.6, depth=5.0):
    boxes = []
    for row in range(rows):
        y = row * 11.0
        boxes += [(k * pitch, y, k * pitch + 0.1, y + depth) for k in range(17)] + [(0, y, 16 * pitch, y + 0.1)]
    return boxes


def pitch_lines():
    """A field of 60 x 40 m with its outline, halves and boxes; none of it is a court's."""
    boxes = [(0, 0, 60, 0.1), (0, 39.9, 60, 40), (0, 0, 0.1, 40), (59.9, 0, 60, 40), (29.95, 0, 30.05, 40)]
    return boxes + [(0, 10, 12, 10.1), (0, 30, 12, 30.1), (12, 10, 12.1, 30)]


def lanes():
    """A road with the spacing of a court's long lines: sides and singles are there, what crosses them is not."""
    return [(-30, at - 0.05, 30, at + 0.05) for at in (-5.46, -4.09, 0, 4.09, 5.46)]


def net():
    return [(k * 3.0, 0, k * 3.0 + 0.1, 36) for k in range(15)] + [(0, k * 3.0, 42, k * 3.0 + 0.1) for k in range(13)]


@pytest.mark.slow
@pytest.mark.parametrize("paint", [bays(0.3), pitch_lines(), lanes(), net()], ids=["bays", "pitch", "lanes", "net"])
@pytest.mark.parametrize("gsd", [0.12, 0.3])
@pytest.mark.parametrize("finder", [TENNIS, VOLLEYBALL, FOOTBALL], ids=lambda finder: finder.kind)
def test_other_lines_are_no_court(finder, paint, gsd):
    low, high = np.min(paint, 0)[:2], np.max(paint, 0)[2:]
    middle = np.array([35.0, 35.0])
    centred = [tuple(np.subtract(box, np.tile((low + high) / 2, 2))) for box in paint]
    picture = court_picture([(centred, middle, 0.2)], gsd, 2 * [round(70 / gsd)], surface=ASPHALT)
    assert not finder.find(picture, gsd, 0.12, "")


def test_a_long_line_alone_speaks_for_no_centre_circle():
    """The spine of two rows of bays, whose strokes lie on some of a circle: as in a real car park."""
    seen = np.array([1.0, 0.4])
    lit = float(np.average(seen, weights=[stroke.length for stroke in CENTRE_CIRCLE.strokes]))
    fit = CourtFit(CENTRE_CIRCLE, np.zeros(2), 0.0, 3.0, 3.0, 0.01, 0.01, np.zeros(20), lit, seen, 0.0, 0.2)
    assert lit > 0.6 and evidence(fit) < FOOTBALL.even
    assert evidence(replace(fit, seen=np.array([1.0, 0.9]), lit=0.95)) > FOOTBALL.even


def test_a_circle_without_a_halfway_line_is_none():
    """A roundabout, a tank: also with a line that only touches it."""
    line, ring = centre_circle()
    for paint in ([ring, (-32, 9.1, 32, 9.2)], [ring, (9.15, -0.05, 32, 0.05)]):
        picture = court_picture([(paint, (35, 35), 0.4)], 0.25, (280, 280), ground=GRASS)
        assert not FOOTBALL.find(picture, 0.25, SD, "")
    assert FOOTBALL.find(court_picture([([line, ring], (35, 35), 0.4)], 0.25, (280, 280), ground=GRASS), 0.25, SD, "")


@pytest.mark.parametrize("picture", ODD_PICTURES.values(), ids=ODD_PICTURES)
@pytest.mark.parametrize("gsd", [0.05, 0.3, 0.55, 5.0])
def test_an_odd_picture_has_no_court(picture, gsd):
    assert list(TENNIS.find(picture, gsd, 0.1, "US")) == []


@pytest.mark.parametrize("place", [(-90.0, 60.0), (60.0, 230.0)])
def test_a_court_beyond_the_picture_is_none(place, monkeypatch):
    """And nothing is sampled there: of an empty picture OpenCV returns whatever lies in memory."""
    monkeypatch.setattr("orthoscale.anchors.court_fit.measure", lambda *_: pytest.fail("sampled"))
    grey = np.full((120, 120), 90, np.float32)
    assert fit_court(grey, grey, TENNIS_COURT, np.array(place), 0.0, 1 / 0.3) is None


@pytest.mark.real
def test_courts_of_american_cities(data):
    """Of five pictures of exactly 0.3048 m/px with 15 whole courts by eye at least 14 are found, to half a percent."""
    found = []
    for number, _whole in (("23", 6), ("30", 2), ("42", 3), ("52", 4)):
        picture = cv2.imread(str(data / "vehicles" / "chips" / f"tenniscourt{number}.jpg"))
        found.append(TENNIS.find(picture[..., ::-1], 0.3048 * 0.94, SD, "US"))
    assert sum(map(len, found)) in (14, 15)
    places = [np.median([error(a, 0.3048) for a in anchors]) for anchors in found]
    assert max(np.abs(places)) < 0.005


@pytest.mark.real
def test_coarse_courts_of_american_cities(data):
    """At 0.5 m/px: six courts, one of them cut off by the picture's edge; three in a row, and none between them."""
    for number, whole in (("95", 6), ("10", 3)):
        picture = cv2.imread(str(data / "vehicles" / "chips" / f"tenniscourt{number}.jpg"))[..., ::-1]
        small = cv2.resize(picture, (156, 156), interpolation=cv2.INTER_AREA)
        gsd = 0.3048 * picture.shape[0] / 156
        found = TENNIS.find(small, gsd, SD, "US")
        assert len(found) == whole and max(abs(error(anchor, gsd)) for anchor in found) < 0.01


@pytest.mark.real
def test_no_court_in_a_car_park(data):
    for number in ("00", "01", "02"):
        picture = cv2.imread(str(data / "vehicles" / "chips" / f"parkinglot{number}.jpg"))
        assert not TENNIS.find(picture[..., ::-1], 0.3048, 0.1, "US")


@pytest.mark.real
def test_a_volleyball_court_of_tartu(data):
    """Faint lines on a schoolyard, next to a larger court whose lines cross it; its middle line is not painted."""
    picture = cv2.imread(str(data / "places" / "tartu_b.jpg"))[840:1090, 1160:1420, ::-1]
    found = VOLLEYBALL.find(picture, 0.2 * 1.05, SD, "EE")
    assert len(found) == 1 and abs(error(found[0], 0.2)) < 0.008
