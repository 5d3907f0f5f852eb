"""The ruler, found from views of vehicles without any metres: what was put in comes back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import simulate
from support.ruler_flights import UNIT, find, fly
from support.simulate import DENSEUAV, Body, found_ruler

from orthoscale.core.boxes import Boxes
from orthoscale.core.projection import self_calibration
from orthoscale.core.projection.exact import BODIES, Hull
from orthoscale.core.projection.own_ruler import CORNER, HIGHEST, UNDERCUT, OwnRuler, SeenBoxes
from orthoscale.core.projection.self_calibration import self_calibrated, trends
from orthoscale.core.projection.view import Views
from orthoscale.fleets import load_fleet

CARD = OwnRuler.of_card((0.7, 0.5), (1.0, 1.0), (0.25, 0.25), (1.0, 1.0))


@pytest.fixture(scope="module")
def flight():
    return fly(np.random.default_rng(1), load_fleet("DE"), 1.1, 3.0, vehicles=40, frames=20)


@pytest.mark.slow
@pytest.mark.parametrize("height, margin", [(0.5, 0.0), (1.4, 4.0)])
def test_height_and_margin_come_back_and_the_scale_is_unbiased(height, margin):
    ruler, error = find(fly(np.random.default_rng(0), load_fleet("DE"), height, margin))
    # Above the belt a car grows narrower, so that lengths hardly tell how high a box reaches there.
    assert ruler.height == pytest.approx([height] * 2, abs=0.15 if height < 0.85 else 0.3)
    assert ruler.margin == pytest.approx([margin] * 2, abs=0.5)
    # Bodies have no undercut here, but noise shows some, and never less than none.
    assert abs(error.mean()) < 0.01 and np.abs(error).max() < 0.015


@pytest.mark.slow
@pytest.mark.parametrize("undercut, height", [(0.15, 0.8), (0.3, 0.9)])
def test_a_body_that_recedes_below_does_not_bias_the_scale(undercut, height):
    """Without an undercut, a straight line through the flat views takes 8 % off all widths."""
    body = fly(np.random.default_rng(1), load_fleet("DE"), height, 1.0, undercut=undercut)
    ruler, error = find(body)
    assert ruler.undercut[1] == pytest.approx(undercut, abs=0.05)
    assert ruler.height[1] == pytest.approx(height, abs=0.15), "in lengths leaning ends make up for a part"
    assert np.abs(error).max() < 0.015


def test_odd_boxes_do_not_steer(flight):
    odd = flight.boxes.xylwa.copy()
    odd[::25, 2:4] *= 1.5
    ruler, _ = find(replace(flight, boxes=type(flight.boxes)(odd, flight.boxes.score)))
    assert ruler.height[1] == pytest.approx(1.1, abs=0.2) and ruler.margin == pytest.approx([3.0] * 2, abs=0.8)
    assert ruler.height[0] == pytest.approx(1.1, abs=0.5), "ends that lean in hardly show how high they are"


@pytest.mark.slow
def test_a_trend_is_gone_once_the_ruler_is_found(flight):
    ruler, _ = find(flight)
    shown = [r.size(flight.seen()) for r in (CARD, ruler)]
    elevation, pixel = np.degrees(flight.views.elevation), flight.views.unit_per_pixel
    changes = trends(*shown, elevation, pixel, flight.members)
    assert changes["after"].keys() == changes["before"].keys() and len(changes["after"]) > 1
    for name, (slope, sd) in changes["after"].items():
        assert abs(slope) < 4 * sd, name
    before = changes["before"]["percent_per_pixel_doubling"]
    assert abs(before[0]) > 4 * before[1]


def test_from_one_altitude_the_margin_stays_as_shipped(flight):
    level = fly(np.random.default_rng(3), load_fleet("DE"), 1.1, 3.0, vehicles=40, frames=20, altitude=(90, 90))
    ruler = self_calibrated(level.seen(), level.members, CARD)
    assert (ruler.margin == CARD.margin).all() and ruler.height[1] != CARD.height[1]


def test_what_the_views_do_not_tell_stays_as_shipped(flight):
    single = [np.array([k]) for k in range(len(flight.boxes))]
    assert self_calibrated(flight.seen(), single, CARD) is CARD
    size = np.ones((len(flight.boxes), 2))
    assert trends(size, size, size[:, 0], size[:, 0], single) is None


def test_what_is_unknown_of_height_and_margin_adds_up(flight):
    size, slopes = (f(flight.seen()) for f in (CARD.size, CARD.slopes))
    good = np.isfinite(slopes).all((1, 2))
    shares = np.median(slopes[good] / size[good, :, None], axis=0)
    alone = CARD.relative_sd(size[good], slopes[good])
    assert (alone**2).sum(1) == pytest.approx(np.einsum("ki,kij,kj->k", shares, CARD.covariance, shares))
    assert (alone[:, :UNDERCUT] > 0).all() and not alone[:, UNDERCUT].any()  # a card knows no undercut


def test_what_a_fitted_height_has_taken_up_of_a_leaning_body_is_not_claimed_again(monkeypatch):
    monkeypatch.setattr(self_calibration, "SHAPES", ())  # the height alone is fitted
    upright = Hull(height=0.8, corner=0.13, end_lean=0.0)
    monkeypatch.setitem(BODIES, "upright", upright)
    body = Body.of("car", replace(upright, end_lean=0.1, side_lean=0.1))
    seen = [simulate.fly(np.random.default_rng(k), 40, DENSEUAV, p, body) for k, p in enumerate((-80, -70))]
    boxes, views = Boxes.concatenate([s.boxes for s in seen]), Views.concatenate([s.views(unit=UNIT) for s in seen])
    every = SeenBoxes(boxes, views, 1.0, UNIT)
    card = OwnRuler.of_card((0.8, 0.8), (0.0, 0.0), (0.6, 0.6), (1e-3, 1e-3), upright)
    own = found_ruler(seen, "upright")
    card_off, own_off = (np.log(np.nanmedian(r.size(every)[:, 0]) * UNIT / 4.4) for r in (card, own))
    assert own.height[0] < 0.65 and abs(own_off) < 0.5 * abs(card_off), "lengths: the height makes up for the lean"
    size, slopes = own.size(every), own.slopes(every)
    good = np.isfinite(slopes).all((1, 2))
    together = np.sqrt((own.relative_sd(size[good], slopes[good])[0] ** 2).sum())
    shares = np.median(slopes[good, 0] / size[good, :1], axis=0)
    apart = np.sqrt(((shares * own.sd[0]) ** 2).sum())
    assert together < 0.8 * apart
    assert 0.5 < abs(own_off) / together < 2, "and what is left is claimed"


def test_a_body_as_high_as_any_is_tried_with_an_undercut_too():
    """The search for one starts from a higher body, which may be none that there is."""
    van = Body.of("", Hull(2.0, belt=1.1, roof=2.0, front_inset=0.18, rear_inset=0.02, side_inset=0.06), (5.3, 2.0))
    seen = [simulate.fly(np.random.default_rng(-p), 60, DENSEUAV, p, van) for p in simulate.PITCHES]
    ruler = found_ruler(seen, "car")
    assert np.isfinite(ruler.value).all() and (ruler.height <= HIGHEST).all()
    higher = OwnRuler.of_card((3.0, 3.0), (0.0, 0.0), (0.25, 0.25), (1.0, 1.0))  # as a file of boxes may say
    high = SeenBoxes(seen[-1].boxes, seen[-1].views(unit=UNIT), 1.0, UNIT)
    assert np.isfinite(higher.slopes(high)[np.isfinite(higher.size(high)).all(1)]).any()


def test_slopes_do_not_leave_what_bodies_can_be(flight):
    sharp = OwnRuler.of_card((0.7, 0.5), (1.0, 1.0), (0.25, 0.25), (1.0, 1.0), Hull(corner=0.0))
    slopes = sharp.slopes(flight.seen(), [CORNER])[..., CORNER]
    size = sharp.size(flight.seen())
    share = np.nanmedian(np.abs(slopes / size), axis=0)
    assert share[1] < 0.1, "a corner takes nothing off the width; one cut off outwards would add to it"
