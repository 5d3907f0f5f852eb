"""Things of one size that stand together do not count for vehicles; vehicles do, however tidily they are parked."""

from dataclasses import replace

import numpy as np
import pytest
from support.drawings import Drawing, RectangleDetector

from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import UNCONFIRMED, ZoomChoice
from orthoscale.core.equal_sizes import all_alike, more_of_the_same
from orthoscale.core.measuring.in_view import pictures_with_boxes
from orthoscale.detect import zoom
from orthoscale.detect.effort import Effort
from orthoscale.detect.find import WHY_EQUAL, find_vehicles


def rows(rng, columns, lines, length, scatter, at=(0.0, 0.0), gap=1.3):
    """Boxes side by side in lines, `gap` widths apart, with a width of 0.4 of the length."""
    x, y = np.meshgrid(np.arange(columns) * gap * 0.4 * length, np.arange(lines) * 1.15 * length)
    n = x.size
    sides = length * np.exp(rng.normal(0, scatter, (n, 2))) * [1, 0.4]
    return Boxes(np.column_stack([x.ravel() + at[0], y.ravel() + at[1], sides, np.full(n, np.pi / 2)]), np.ones(n))


@pytest.mark.parametrize("scatter", [0.012, 0.02])
@pytest.mark.parametrize("columns, lines", [(40, 1), (12, 10)])
def test_panels_do_not_count(scatter, columns, lines):
    assert all_alike(rows(np.random.default_rng(0), columns, lines, 23.0, scatter, gap=1.05)).all()


@pytest.mark.parametrize("columns, lines", [(8, 1), (40, 1), (50, 20)])
def test_parked_vehicles_count(columns, lines):
    """Fleets scatter by 0.07 to 0.10, shrunk by a third by the detector, with its own noise on top."""
    taken = [all_alike(rows(np.random.default_rng(k), columns, lines, 16.0, 0.06)).any() for k in range(200)]
    assert np.mean(taken) <= 0.01


def test_a_few_vehicles_that_happen_to_be_alike_count():
    rng = np.random.default_rng(1)
    taken = [all_alike(rows(rng, 4, 1, 50.0, 0.03)).any() for _ in range(300)]
    assert np.mean(taken) < 0.02


def test_only_the_equal_things_are_left_out_among_vehicles():
    rng = np.random.default_rng(2)
    panels, cars = rows(rng, 20, 8, 22.0, 0.02), rows(rng, 20, 2, 55.0, 0.06, at=(0, 900))
    alike = all_alike(Boxes.concatenate([panels, cars]))
    assert alike[: len(panels)].all() and not alike[len(panels) :].any()
    assert not all_alike(Boxes.empty()).any() and not all_alike(cars[:1]).any()


def test_a_smaller_group_beside_equal_things_of_its_length_is_more_of_them():
    """Scatter that would not do by itself; the same group of another length counts, and so do vehicles."""
    rng = np.random.default_rng(4)
    roof, cars = rows(rng, 12, 4, 27.0, 0.02), rows(rng, 10, 2, 27.0, 0.06, at=(900, 0))
    share = {}
    for length in (28.5, 55.0):
        taken = []
        for _ in range(60):
            next_roof = rows(rng, 14, 1, length, 0.023, at=(0, 900))
            alike = all_alike(Boxes.concatenate([roof, next_roof, cars]))
            assert alike[: len(roof)].all() and not alike[-len(cars) :].any()
            taken.append(alike[len(roof) : -len(cars)].all())
        share[length] = np.mean(taken)
    assert share[28.5] > 0.7 and share[55.0] < 0.4
    assert not all_alike(Boxes.concatenate([roof, cars]))[len(roof) :].any()


def test_what_is_as_long_as_most_equal_things_and_fewer_is_probably_one_of_them():
    rng = np.random.default_rng(5)
    panels, stray = rows(rng, 12, 4, 27.0, 0.02), rows(rng, 20, 1, 28.0, 0.1, at=(0, 900), gap=9.0)
    cars = rows(rng, 20, 1, 55.0, 0.06, at=(0, 2000))
    boxes = Boxes.concatenate([panels, stray, cars])
    more = more_of_the_same(boxes, np.arange(len(boxes)) < len(panels))
    assert more[len(panels) : -len(cars)].all() and not more[: len(panels)].any() and not more[-len(cars) :].any()
    few = more_of_the_same(boxes, np.arange(len(boxes)) < 8)
    assert not few.any(), "eight among seventy others"


def test_equal_things_that_both_passes_find_are_not_counted_as_found_by_one():
    rng = np.random.default_rng(6)
    panels, cars = rows(rng, 20, 4, 30.0, 0.012, at=(40, 40)), rows(rng, 12, 2, 45.0, 0.06, at=(60, 500), gap=1.5)
    picture = Drawing(700, 800, Boxes.concatenate([panels, cars]))
    found = find_vehicles([picture], RectangleDetector(), 1.0, effort=Effort(workers=1, cache=False))
    assert len(found) == len(cars) and found.unconfirmed == 0
    assert len(found.set_aside[WHY_EQUAL]["drawing"]) == len(panels)
    assert found.notes == (f"{len(panels)} boxes do not count: {WHY_EQUAL}",)
    assert found.uncounted == {UNCONFIRMED: 0, WHY_EQUAL: len(panels)} and pictures_with_boxes(replace(found, boxes={}))


@pytest.mark.parametrize("given", [1.0, None])
def test_what_is_found_says_whether_the_user_gave_the_zoom(given):
    cars = rows(np.random.default_rng(6), 12, 2, 45.0, 0.06, at=(60, 60), gap=1.5)
    picture = Drawing(700, 300, cars)
    found = find_vehicles([picture], RectangleDetector(), given, effort=Effort(workers=1, cache=False))
    choice = found.swept.zoom_choice
    assert (found.zoom_given, choice is None) == (given is not None, given is not None)
    assert found.zoom == (given or choice.zoom)


def test_equal_things_do_not_vote_for_a_size_and_neither_do_stragglers_among_them():
    rng = np.random.default_rng(3)
    panels, cars = rows(rng, 20, 8, 22.0, 0.02), rows(rng, 10, 2, 55.0, 0.06, at=(0, 900))
    straggler = Boxes(np.array([[5000.0, 5000, 22.3, 9, 0]]), np.ones(1))
    left = zoom._unlike(Boxes.concatenate([panels, straggler, cars]), 1.0)
    assert sorted(left.length) == pytest.approx(sorted(cars.length))


@pytest.mark.parametrize("rival, one, other", [(0.3, True, None), (0.6, True, 31.0), (0.6, False, None)])
def test_two_sizes_about_as_likely_are_asked_about_where_there_is_one_scale(rival, one, other):
    """In frames from nearer and farther, vehicles have several sizes."""
    assert ZoomChoice(1.0, 55.0, 100.0, 31.0, rival, [], one).as_likely == other
    assert ZoomChoice(1.0, 55.0, 100.0, 9.0, 0.6, [], False).as_likely == 9.0


def test_things_that_point_every_way_are_no_group_however_alike():
    i, j = (k.ravel() for k in np.indices((8, 8)))
    rows = np.column_stack([60 * i, 60 * j, np.full(64, 50.0), np.full(64, 21.0), 0.5 * ((i + 2 * j) % 4)])
    assert not all_alike(Boxes(rows, np.ones(64))).any()
    assert all_alike(Boxes(rows * [1, 1, 1, 1, 0], np.ones(64))).all()
