"""Crossings, bays and lane lines: what is measured of drawn ones, and that nothing else is taken for them."""

from __future__ import annotations

import numpy as np
import pytest
from support.markings import PAINT, picture, stroke

from orthoscale.anchors.bays import BAY_FALSE, ParkingBays, bay_standards
from orthoscale.anchors.crossings import ZEBRA_FALSE, ZebraCrossings
from orthoscale.anchors.dashes import LANE_LINES, LaneDashes, split_by_country
from orthoscale.anchors.periods import find_row, fit_row
from orthoscale.anchors.strokes import Strokes, near_pairs
from orthoscale.anchors.zebra_rules import ZEBRA_FREE, ZEBRA_RULES, elsewhere
from orthoscale.anchors.zebra_rules import ZEBRA_STANDARDS as CROSSINGS
from orthoscale.core.anchors import Standard, holding
from orthoscale.core.normal import Z90

FINDERS = (ZebraCrossings(), ParkingBays(), LaneDashes())


def zebra(period=1.0, stripe=0.5, count=12, length=4.0):
    return [(stroke(20 + period * k, 22, length, stripe, 90), PAINT) for k in range(count)]


def bays(pitch=2.5, count=12, slant=90.0, length=5.0):
    step = pitch / np.sin(np.radians(slant))
    return [(stroke(12 + step * k, 22, length, 0.12, slant), PAINT) for k in range(count)]


def dashes(dash=3.0, gap=6.0, count=7):
    return [(stroke(4 + (dash + gap) * k, 22, dash, 0.15), PAINT) for k in range(count)]


def one(found, standard):
    """The only anchor, which can be of `standard` metres."""
    assert len(found) == 1
    assert any(abs(each.metres - standard) < 1e-6 for each in found[0].standards)
    return found[0]


@pytest.mark.parametrize("turn", (0, 17, 63, 90))
@pytest.mark.parametrize("gsd", (0.10, 0.18))
def test_the_period_of_a_crossing(gsd, turn):
    found = ZebraCrossings().find(picture(zebra(), gsd, turn=turn), gsd * 1.06, 0.06, "DE")
    anchor = one(found, 1.0)
    assert anchor.count == 12
    assert anchor.pixels * gsd == pytest.approx(1.0, rel=0.005)
    assert len(anchor.lines) == 12


def test_a_crossing_under_a_car():
    car = (stroke(25.2, 22, 4.4, 1.8, 90), (30, 30, 34))
    anchor = one(ZebraCrossings().find(picture([*zebra(), car], 0.1, turn=30), 0.1, 0.08, "IT"), 1.0)
    assert 8 <= anchor.count <= 11
    assert anchor.pixels * 0.1 == pytest.approx(1.0, rel=0.005)


@pytest.mark.parametrize("slant", (90, 60, 45))
@pytest.mark.parametrize("gsd", (0.10, 0.2, 0.3))
def test_the_pitch_of_bays_is_taken_across_their_lines(gsd, slant):
    found = ParkingBays().find(picture(bays(slant=slant), gsd, (66, 45), turn=21), gsd * 0.95, 0.06, "DE")
    anchor = one(found, 2.5)
    assert anchor.count >= 10
    assert anchor.pixels * gsd == pytest.approx(2.5, rel=0.01)
    assert abs(anchor.pixels * gsd / 2.5 - 1) < 3 * anchor.relative_sd


def test_bays_with_vehicles_between_their_lines():
    cars = [
        (stroke(13.25 + 2.5 * k, 22, 4.5, 1.8, 90), (60 + 30 * (k % 3), 40, 40 + 50 * (k % 2))) for k in (1, 2, 5, 6)
    ]
    anchor = one(ParkingBays().find(picture([*bays(), *cars], 0.1), 0.1, 0.08, "DE"), 2.5)
    assert anchor.pixels * 0.1 == pytest.approx(2.5, rel=0.005)


@pytest.mark.parametrize("gsd, apart", ((0.10, 0.4), (0.10, 0.6), (0.15, 0.6)))
def test_double_lines_between_bays(gsd, apart):
    """A left line at one end and a right one at the other would make the pitch 1.3 % longer, or shorter."""
    lines = [(stroke(12 + 2.5 * k + side * apart / 2, 22, 5, 0.1, 90), PAINT) for k in range(12) for side in (-1, 1)]
    for turn in (10, 130):
        anchor = one(ParkingBays().find(picture(lines, gsd, (66, 45), turn=turn), gsd * 1.05, 0.06, "DE"), 2.5)
        assert anchor.count >= 10
        assert anchor.pixels * gsd == pytest.approx(2.5, rel=0.003)


@pytest.mark.parametrize("turn", (10, 70, 130))
def test_double_lines_that_are_hardly_resolved_say_nothing_wrong(turn):
    lines = [(stroke(12 + 2.5 * k + side * 0.2, 22, 5, 0.1, 90), PAINT) for k in range(12) for side in (-1, 1)]
    for gsd in (0.15, 0.2):
        for anchor in ParkingBays().find(picture(lines, gsd, (66, 45), turn=turn), gsd, 0.06, "DE"):
            assert anchor.pixels * gsd == pytest.approx(2.5, rel=0.005)


@pytest.mark.parametrize("turn", (0, 33, 90))
@pytest.mark.parametrize("gsd", (0.10, 0.3))
def test_the_period_of_a_lane_line(gsd, turn):
    found = LaneDashes().find(picture(dashes(), gsd, (70, 70), turn=turn), gsd * 1.05, 0.06, "DE")
    anchor = one(found, 9.0)
    assert anchor.count >= 6
    assert anchor.pixels * gsd == pytest.approx(9.0, rel=0.005)


def test_a_lane_line_is_known_by_its_share_of_paint():
    """12 m are 4.5 + 7.5 m in Italy, 6 m are 3 + 3 m."""
    drawn = [(stroke(4 + 12 * k, 22, 4.5, 0.15), PAINT) for k in range(6)]
    assert one(LaneDashes().find(picture(drawn, 0.15, (80, 45)), 0.15, 0.08, "IT"), 12.0)
    half = [(stroke(4 + 12 * k, 22, 6.0, 0.15), PAINT) for k in range(6)]
    assert not LaneDashes().find(picture(half, 0.15, (80, 45)), 0.15, 0.08, "IT")


def test_a_lane_line_of_an_unknown_country_tells_where_it_may_lie():
    """Ten feet of forty are a quarter of paint, as in Russia; China paints two fifths, Germany at least a third."""
    drawn = [(stroke(4 + 12.192 * k, 22, 3.048, 0.15), PAINT) for k in range(6)]
    (line,) = LaneDashes().find(picture(drawn, 0.15, (80, 45)), 0.15, 0.06, "")
    named = {code for standard in line.standards for code in standard.countries}
    assert {"US", "RU", "AU"} <= named and {"CN", "DE", "JP"} <= set(line.unlike)
    assert not named & set(line.unlike) and "NP" not in named | set(line.unlike), "of Nepal's lines nothing is known"
    assert LaneDashes().find(picture(drawn, 0.15, (80, 45)), 0.15, 0.06, "NP") == []
    assert LaneDashes().find(picture(drawn, 0.15, (80, 45)), 0.15, 0.06, "US")[0].unlike == ()


def test_bays_of_an_unknown_country_may_be_of_any():
    """Also of one whose own are out of reach: else it would be held for one of which nothing is known."""
    (row,) = ParkingBays().find(picture(bays(pitch=2.9), 0.1), 0.1, 0.04, "")
    assert row.standards == bay_standards() and row.false > BAY_FALSE


def test_rules_of_a_country_share_its_lines():
    each = split_by_country([standard for _, standard in LANE_LINES])
    for country in {code for standard in each for code in standard.countries}:
        assert sum(standard.prior for standard in each if country in standard.countries) == pytest.approx(1)


def test_a_bend_is_measured_along_the_lane():
    """Six of nine metres on a bend of 300 m."""
    angle = np.arange(8) * 9.0 / 300
    drawn = [(stroke(5 + 300 * np.sin(a), 5 + 300 * (1 - np.cos(a)), 3.0, 0.15, np.degrees(a)), PAINT) for a in angle]
    anchor = one(LaneDashes().find(picture(drawn, 0.1, (80, 30)), 0.1, 0.08, "DE"), 9.0)
    assert anchor.pixels * 0.1 == pytest.approx(9.0, rel=0.005)


def test_a_lane_line_under_vehicles():
    cars = [(stroke(4 + 9.0 * k, 22, 5, 1.9), (40, 40, 60)) for k in (2, 5)]
    anchor = one(LaneDashes().find(picture([*dashes(), *cars], 0.1, (70, 45)), 0.1, 0.08, "DE"), 9.0)
    assert anchor.count == 5
    assert anchor.pixels * 0.1 == pytest.approx(9.0, rel=0.005)


def ribs(pitch, width, colour, ground):
    """A roof of metal sheet or a field: strokes from edge to edge of a patch, on other ground than about it."""
    patch = (stroke(30, 22, 30, 12), ground)
    return [patch, *((stroke(15.2 + pitch * k, 22, 12, width, 90), colour) for k in range(int(29.6 / pitch) + 1))]


LOOKALIKES = {
    "roof of metal sheet": ribs(1.0, 0.5, (205, 205, 205), (120, 120, 124)),
    "red tiles": ribs(1.0, 0.5, (200, 110, 90), (150, 84, 66)),
    "seams of a roof": ribs(2.5, 0.12, (215, 215, 215), (150, 150, 154)),
    "ploughed field": ribs(0.9, 0.4, (140, 118, 84), (104, 84, 58)),
    "planted rows": ribs(2.5, 0.5, (60, 120, 50), (120, 100, 70)),
    "shadows of a railing": [(stroke(16 + 0.3 * k, 22, 3.0, 0.12, 90), (190, 190, 190)) for k in range(80)],
    "windows": [(stroke(15 + 3.0 * k, 16 + 3 * r, 1.4, 1.2), (40, 44, 60)) for k in range(9) for r in range(4)],
    "fence posts": [(stroke(6 + 2.5 * k, 22, 0.3, 0.3), PAINT) for k in range(20)],
    "kerb stones": [(stroke(4 + 1.0 * k, 22, 0.9, 0.15), PAINT) for k in range(50)],
}


@pytest.mark.parametrize("name", LOOKALIKES)
def test_nothing_else_is_taken_for_paint(name):
    for gsd in (0.1, 0.2):
        image = picture(LOOKALIKES[name], gsd, turn=12)
        for finder in FINDERS:
            assert not finder.find(image, gsd, 0.08, "DE"), f"{finder.kind} in {name} at {gsd} m/px"


def test_pictures_without_anything():
    rng = np.random.default_rng(1)
    for image in (
        rng.integers(0, 255, (300, 400, 3), np.uint8),
        np.zeros((200, 200, 3), np.uint8),
        np.full((1, 1, 3), 255, np.uint8),
        np.zeros((0, 0, 3), np.uint8),
        rng.integers(0, 255, (5, 900, 3), np.uint8),
    ):
        for finder in FINDERS:
            assert list(finder.find(image, 0.15, 0.08, "")) == []


def test_a_row_with_things_missing_and_others_between():
    rng = np.random.default_rng(2)
    place = np.concatenate([10 + 25.0 * np.array([0, 1, 2, 4, 5, 7, 8, 9]), rng.uniform(0, 300, 4)])
    row = find_row(place + rng.normal(0, 0.3, len(place)), 20, 30, 5)
    assert row is not None
    assert row.period == pytest.approx(25.0, abs=3 * row.sd)
    assert row.number[-1] == 9
    assert row.regularity > 8


def test_one_thing_beside_its_place_does_not_make_a_row_irregular():
    place = 10 + 25.0 * np.arange(6) + np.random.default_rng(4).normal(0, 0.1, 6)
    for stray in (0, 3, 5):
        row = find_row(place + 2.6 * (np.arange(6) == stray), 20, 30, 5)
        assert row is not None and row.strays == 1 and stray not in row.member
        assert row.period == pytest.approx(25.0, abs=0.1)
        assert row.regularity > 5
    assert find_row(place, 20, 30, 5).strays == 0


@pytest.mark.parametrize("count", (5, 6, 8, 12))
def test_the_interval_of_a_short_row_holds_the_period_as_often_as_it_says(count):
    rng, number = np.random.default_rng(6), np.arange(count)
    rows = [fit_row(20.0 * number + rng.normal(0, 0.3, count), number) for _ in range(4000)]
    assert 0.88 < np.mean([abs(row.period - 20) < Z90 * row.sd for row in rows]) < 0.92


@pytest.mark.slow
@pytest.mark.parametrize("count", (6, 12))
def test_it_does_so_where_some_of_its_own_are_taken_for_strays(count):
    rng = np.random.default_rng(8)
    rows = [find_row(20.0 * np.arange(count) + rng.normal(0, 0.3, count), 17, 23, 5) for _ in range(2000)]
    assert 0.88 < np.mean([abs(row.period - 20) < Z90 * row.sd for row in rows if row is not None]) < 0.92


def test_a_stray_makes_a_row_less_certain():
    """It may have been the row's own."""
    place, number = 20.0 * np.arange(8) + np.random.default_rng(7).normal(0, 0.3, 8), np.arange(8)
    assert fit_row(place, number, 1).sd > 1.5 * fit_row(place, number).sd


def test_what_is_evenly_astray_is_not_sifted_until_it_is_regular():
    place = 10 + 25.0 * np.arange(12) + np.random.default_rng(5).uniform(-2.5, 2.5, 12)
    row = find_row(place, 20, 30, 5)
    assert row is not None and row.strays <= 1 and row.regularity < 4


def test_chance_is_not_regular():
    rng = np.random.default_rng(3)
    rows = [find_row(np.sort(rng.uniform(0, 400, 14)), 20, 30, 5) for _ in range(200)]
    assert sum(row is not None and row.regularity > 4.5 for row in rows) <= 4


def test_standards_have_sources_and_follow_the_country():
    tables = (CROSSINGS, bay_standards(), [standard for _, standard in LANE_LINES])
    for table in tables:
        assert all(each.source and each.relative_sd > 0 and each.prior > 0 for each in table)
        assert holding(table, "")
        assert holding(table, "ZZ") == holding(table, "")
    assert {each.metres for each in holding([s for _, s in LANE_LINES], "CN")} == {15.0, 9.0, 6.0}
    assert all(dash < standard.metres for dash, standard in LANE_LINES)


def test_an_own_standard_takes_the_place_of_the_rules():
    own = (Standard("ours", 2.2, 0.005, "plan"),)
    image = picture(bays(pitch=2.2), 0.1)
    assert one(ParkingBays(own).find(image, 0.1, 0.08, "US"), 2.2).standards == own
    assert one(ParkingBays(own).find(image, 0.1, 0.08, ""), 2.2).false == BAY_FALSE, "wherever that is"
    assert one(
        ZebraCrossings((Standard("ours", 1.3, 0.005, "plan"),)).find(picture(zebra(1.3), 0.1), 0.1, 0.05, "US"), 1.3
    )
    drawn = [(stroke(4 + 8 * k, 22, 2.4, 0.15), PAINT) for k in range(7)]
    assert one(LaneDashes((Standard("ours", 8.0, 0.005, "plan"),)).find(picture(drawn, 0.1), 0.1, 0.05, "US"), 8.0)


def test_lane_lines_where_no_rule_is_known_say_nothing():
    image = picture(dashes(), 0.1, (70, 45))
    assert LaneDashes().find(image, 0.1, 0.08, "DE")
    assert not LaneDashes().find(image, 0.1, 0.08, "NP")
    for free in ("US", "BR"):
        assert not ZebraCrossings().find(picture(zebra(), 0.1), 0.1, 0.08, free)


def test_where_no_rule_is_known_a_crossing_is_what_the_known_rules_make_likely():
    rules = (
        Standard("one metre", 1.0, 0.015, "law", countries=("AA", "BB")),
        Standard("first of two", 1.0, 0.015, "law", 0.6, ("CC",)),
        Standard("second of two", 1.2, 0.05, "law", 0.4, ("CC",)),
        Standard("two, evenly", 0.9, 0.015, "law", 1.0, ("DD",)),
        Standard("two, evenly", 1.2, 0.05, "law", 1.0, ("DD",)),
    )
    expected = {each.metres: each for each in elsewhere(rules)}
    assert {metres: each.prior for metres, each in expected.items()} == pytest.approx(
        {0.9: 0.125, 1.0: 0.65, 1.2: 0.225}
    )
    assert [expected[metres].relative_sd for metres in (0.9, 1.0, 1.2)] == pytest.approx([0.03, 0.03, 0.05])
    assert not any(each.countries for each in expected.values())


def test_the_shares_of_crossings_elsewhere_follow_the_table():
    ruled = {country for each in ZEBRA_RULES for country in each.countries}
    shares = dict.fromkeys((each.metres for each in ZEBRA_RULES), 0.0)
    for country in ruled:
        own = holding(CROSSINGS, country)
        for each in own:
            shares[each.metres] += each.prior / sum(other.prior for other in own) / len(ruled)
    assert {each.metres: each.prior for each in holding(CROSSINGS, "ZZ")} == pytest.approx(shares)
    assert sum(shares.values()) == pytest.approx(1)
    assert not ruled & set(ZEBRA_FREE)


def test_a_crossing_elsewhere_may_be_of_no_rule_as_often_as_rules_leave_it_free():
    image = picture(zebra(), 0.1)
    ruled = {country for each in ZEBRA_RULES for country in each.countries}
    (here,), (there,) = (ZebraCrossings().find(image, 0.1, 0.05, country) for country in ("DE", "ZZ"))
    assert here.false == ZEBRA_FALSE
    assert 1 - there.false == pytest.approx((1 - ZEBRA_FALSE) * len(ruled) / (len(ruled) + len(ZEBRA_FREE)))


@pytest.mark.parametrize("astray", (np.radians(4), np.pi / 2))
@pytest.mark.parametrize("turn", (np.radians(5), np.radians(8)))
def test_no_near_pair_of_strokes_is_missed(turn, astray):
    """Of strokes that head anywhere, along the limits of the directions that are looked at in turn too."""
    rng = np.random.default_rng(5)
    n, reach = 1200, 90.0
    heading = np.where(np.arange(n) % 4, rng.uniform(-np.pi, np.pi, n), rng.integers(-36, 36, n) * np.pi / 36)
    along = np.stack([np.cos(heading), np.sin(heading)], -1)
    strokes = Strokes(rng.uniform(0, 300, (n, 2)), along, np.ones(n))
    apart = strokes.centre[None] - strokes.centre[:, None]
    distance = np.linalg.norm(apart, axis=-1)
    off = np.abs(apart[..., 0] * along[:, None, 1] - apart[..., 1] * along[:, None, 0])
    ahead = np.sin(astray) * distance * (1 + 1e-9)
    wanted = (distance <= reach) & (np.abs(along @ along.T) > np.cos(turn)) & (np.maximum(off, off.T) <= ahead)
    i, j = (np.concatenate(each) for each in zip(*near_pairs(strokes, reach, turn, astray), strict=True))
    assert (i < j).all() and (distance[i, j] <= reach * (1 + 1e-9)).all()
    found = np.zeros((n, n), bool)
    found[i, j] = True
    assert found.sum() == len(i), "each once"
    assert wanted.sum() > n and not (np.triu(wanted, 1) & ~found).any()
