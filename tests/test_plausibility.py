"""Boxes that can be no vehicles, because they stand in one another or in no order, or that hardly anything speaks
for."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.drawings import car_park

from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import UNKNOWN_HEIGHT, UNKNOWN_RULER, Detections
from orthoscale.core.measuring.judgement import judgements
from orthoscale.core.measuring.plausibility import alignment, if_confirmed, standing_in_another
from orthoscale.core.measuring.ways import measure_source
from orthoscale.core.remarks import CAUTION, REFUSAL
from orthoscale.core.verdicts import UNUSABLE, one_step_below
from orthoscale.fleets import load_fleet
from orthoscale.formats.detections.own import load_detections, save_detections

DE = load_fleet("DE")


def test_whose_middle_lies_in_another():
    rows = [
        [100, 100, 45, 19, 0.0],  # two side by side, in bays of 25 px
        [100, 125, 45, 19, 0.0],
        [300, 100, 45, 19, 0.3],  # two across one another
        [305, 104, 45, 19, 1.6],
        [500, 100, 90, 30, 0.0],  # a small one at the end of a long one
        [540, 105, 20, 10, 0.0],
        [700, 100, 45, 19, np.pi / 4],  # beside it, though within its upright frame
        [716, 86, 45, 19, np.pi / 4],
    ]
    inside = standing_in_another(Boxes(np.array(rows, float), np.ones(len(rows))))
    assert inside.tolist() == [False, False, True, True, True, True, False, False]
    assert standing_in_another(Boxes.empty()).tolist() == []


def random_boxes(count, side=8000, seed=0):
    """Of the size and shape of cars, anywhere."""
    rng = np.random.default_rng(seed)
    length = 45 * np.exp(rng.normal(0, 0.1, count))
    rows = [*rng.uniform(50, side - 50, (2, count)), length, length / 2.4, rng.uniform(0, np.pi, count)]
    return Boxes(np.column_stack(rows), np.full(count, 0.9))


@pytest.mark.parametrize("count, least, most", [(5_000, 0.05, 0.12), (100_000, 0.75, 0.95)])
def test_random_boxes_do(count, least, most):
    assert least < standing_in_another(random_boxes(count)).mean() < most


def test_thousands_in_one_place_take_no_time():
    assert standing_in_another(random_boxes(20_000, side=101)).mean() > 0.99


@pytest.mark.parametrize(
    "count, scatter, refused", [(15, 0.012, True), (36, 0.02, True), (15, 0.06, False), (5, 0.01, False)]
)
def test_a_scale_of_boxes_of_one_size_is_refused(count, scatter, refused):
    """Roof machines far apart, which no group gives away; not vehicles, and not five that happen to be alike."""
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.arange(100, 1900, 280), np.arange(100, 1900, 280))
    sides = 45 * np.exp(rng.normal(0, scatter, (count, 1))) * [1, 0.42]
    rows = np.column_stack([x.ravel()[:count], y.ravel()[:count], sides, np.zeros(count)])
    plan = SimpleNamespace(name="plan", width=2000, height=2000, unit="m/px", claimed=SimpleNamespace(aspect=1.0))
    plan.plan, plan.posed = plan, None
    found = Detections({"plan": Boxes(rows, np.full(count, 0.9))}, 1.0, UNKNOWN_RULER, UNKNOWN_HEIGHT, "a file")
    measured = measure_source(plan, found, DE)
    said = [remark.severity for remark in measured.remarks if "equally long" in remark.text]
    assert said == ([REFUSAL] if refused else [])
    assert (measured.scale.verdict == UNUSABLE) >= refused


@pytest.mark.parametrize("boxes", [random_boxes(2000, 1500), car_park(45, 2000, 2000, 150)], ids=["random", "apart"])
def test_a_scale_of_such_boxes_is_refused(boxes):
    """Both are of the sizes of vehicles, and would give a scale."""
    plan = SimpleNamespace(name="plan", width=2000, height=2000, unit="m/px", claimed=SimpleNamespace(aspect=1.0))
    plan.plan, plan.posed = plan, None
    found = Detections({"plan": boxes}, 1.0, UNKNOWN_RULER, UNKNOWN_HEIGHT, "a file")
    measured = measure_source(plan, found, DE)
    said = [remark for remark in measured.remarks if "overlap each other" in remark.text]
    if len(boxes) == 2000:
        assert measured.scale.verdict == UNUSABLE and [remark.severity for remark in said] == [REFUSAL]
        assert any(check.severity == REFUSAL and check.detail == said[0].text for check in judgements(measured))
    else:
        assert measured.scale.verdict != UNUSABLE and not said


def street(count, side=4000, seed=0, jitter=0.15):
    """Rows of boxes of the size of cars in pairs, every second pair at right angles; all turned by 0.7."""
    rng = np.random.default_rng(seed)
    length = 45 * np.exp(rng.normal(0, 0.1, count))
    middle = np.repeat(rng.uniform(100, side - 100, (count // 2, 2)), 2, axis=0)
    angle = 0.7 + np.pi / 2 * (np.arange(count) // 2 % 2) + rng.normal(0, jitter, count)
    beside = np.where(np.arange(count) % 2, 30, -30)[:, None] * [-np.sin(0.7), np.cos(0.7)]
    return Boxes(np.column_stack([middle + beside, length, length / 2.4, angle]), np.full(count, 0.9))


def test_neighbours_are_parallel_or_across():
    pairs, agreement = alignment(street(200))
    assert pairs > 90 and agreement > 0.6
    pairs, agreement = alignment(random_boxes(200, 1500))
    assert pairs > 60 and abs(agreement) < 0.35
    assert alignment(random_boxes(1)) == alignment(Boxes.empty()) == (0, 0.0)
    assert alignment(Boxes(np.array([[0, 0, 45, 19, 0.0], [999, 0, 45, 19, 0.0]]), np.ones(2))) == (0, 0.0)  # too far


@pytest.mark.parametrize("boxes, doubted", [(random_boxes(5000), True), (random_boxes(400, 20_000, 1), False),
                                            (random_boxes(40, 1500), False), (street(400), False)],
                         ids=["anywhere", "far apart", "few", "in order"])  # fmt: skip
def test_boxes_in_no_order_are_poor_at_best(boxes, doubted):
    """5,000 random boxes of the size of cars were fair once. Where few have a neighbour, nothing can be said."""
    plan = SimpleNamespace(name="plan", width=20_000, height=20_000, unit="m/px", claimed=SimpleNamespace(aspect=1.0))
    plan.plan, plan.posed = plan, None
    measured = measure_source(plan, Detections({"plan": boxes}, 1.0, UNKNOWN_RULER, UNKNOWN_HEIGHT, "a file"), DE)
    said = [remark.severity for remark in measured.remarks if "pairs of neighbours" in remark.text]
    assert measured.scale.verdict == "poor" or not doubted
    assert said == [CAUTION] * doubted


@pytest.mark.parametrize(
    "believed, doubtful, lowered", [(38, 127, True), (60, 30, False), (8, 9, False), (5, 14, False)]
)
def test_what_two_looks_seldom_agree_on_is_believed_less(believed, doubtful, lowered):
    """38 of 165: a rendered roof of panels, without any vehicle."""
    plan = SimpleNamespace(name="plan", width=2000, height=2000, unit="m/px", claimed=SimpleNamespace(aspect=1.0))
    plan.plan, plan.posed = plan, None
    boxes = car_park(45, 2000, 2000, max(believed, 5))
    given = {"plan": random_boxes(doubtful, 1900)}
    sure, unsure, aside = (
        measure_source(plan, Detections({"plan": boxes}, 1.0, UNKNOWN_RULER, UNKNOWN_HEIGHT, "a detector", **more), DE)
        for more in ({}, {"doubtful": given}, {"set_aside": {"panels": given}})
    )
    assert (aside.scale.verdict, aside.remarks) == (unsure.scale.verdict, unsure.remarks), "most boxes are no vehicles"
    assert aside.rejected_boxes == {"panels": doubtful}
    assert unsure.scale.value == sure.scale.value
    assert unsure.scale.verdict == (one_step_below(sure.scale.verdict) if lowered else sure.scale.verdict)
    assert any("as few as among false detections" in check.detail for check in judgements(unsure)) == lowered
    # However narrow the interval: things that are all alike, and anchors that follow them, are sure of themselves.
    good = replace(sure.scale, verdict="good")
    assert if_confirmed(good, believed, doubtful).verdict == ("poor" if lowered else "good")
    # Where many are larger than cars besides, the cars may be something else.
    larger = if_confirmed(replace(good, larger_share=0.3), believed, doubtful)
    assert (larger.verdict == UNUSABLE) == lowered
    assert [r.severity for r in larger.remarks if "larger than cars" in r.text] == ([REFUSAL] if lowered else [])


@pytest.mark.parametrize(
    "believed, open_by, refused", [(135, 0.09, True), (155, 0.07, True), (135, 0.04, False), (165, 0.09, False)]
)
def test_where_hardly_any_box_counts_and_these_do_not_agree_nothing_is_given(believed, open_by, refused):
    """135 of 1602 boxes of a rendered town of look-alikes counted; its scale was 22 % too large, and poor."""
    boxes = car_park(45, 2000, 2000, 60)
    plan = SimpleNamespace(name="plan", width=2000, height=2000, unit="m/px", claimed=SimpleNamespace(aspect=1.0))
    plan.plan, plan.posed = plan, None
    found = Detections({"plan": boxes}, 1.0, UNKNOWN_RULER, UNKNOWN_HEIGHT, "a detector")
    scale = measure_source(plan, found, DE).scale
    scale = replace(scale, interval90=(scale.value * np.exp(-open_by), scale.value * np.exp(open_by)))
    judged = if_confirmed(scale, believed, 1602 - believed)
    assert (judged.verdict == UNUSABLE) == refused
    (remark,) = [r for r in judged.remarks if "as few as among false detections" in r.text]
    assert (remark.severity, bool(remark.hint)) == ((REFUSAL, True) if refused else (CAUTION, False))


@pytest.mark.parametrize("turn, agreement", [(0.0, 1.0), (np.pi / 2, 1.0), (np.pi / 4, -1.0), (np.pi / 8, 0.0)])
def test_neighbours_agree_where_they_are_parallel_or_across(turn, agreement):
    k = np.arange(40)
    rows = np.column_stack([60.0 * k + 20.0 * (k // 2), 0 * k, np.full(40, 45.0), np.full(40, 19.0), turn * (k % 2)])
    pairs, found = alignment(Boxes(rows, np.ones(40)))
    assert pairs == 20 and found == pytest.approx(agreement, abs=1e-9)


CAR, VAN = [0.9, 0.0, 0.1, 0.0], [0.1, 0.0, 0.9, 0.0]


@pytest.mark.parametrize(
    "factor, others, kind, given, refused",
    [
        (2.2, 4, CAR, False, True),
        (0.4, 4, CAR, False, True),
        (2.2, 3, CAR, False, False),  # of ten: two boxed as one now and then
        (2.2, 4, VAN, False, False),  # lorries
        (2.2, 4, [np.nan] * 4, False, False),
        (2.2, 4, CAR, True, False),  # the user says how large vehicles are
    ],
)
def test_cars_of_another_size_are_another_reading(tmp_path, factor, others, kind, given, refused):
    """Four pairs of lamps and a hatch gave 2.3 times the scale of the three cars beside them, and it was fair."""
    park = car_park(45, 2000, 2000, 10)
    strange = park[:others].mapped(1.0, (0.0, 800.0))
    rows = np.concatenate([park.xylwa, strange.xylwa * [1, 1, factor, factor, 1]])
    kinds = np.array([CAR] * len(park) + [kind] * others)
    boxes = Boxes(rows, np.full(len(rows), 0.9), kinds=kinds)
    plan = SimpleNamespace(name="plan", width=2000, height=2000, unit="m/px", claimed=SimpleNamespace(aspect=1.0))
    plan.plan, plan.posed = plan, None
    found = Detections({"plan": boxes}, 1.0, UNKNOWN_RULER, UNKNOWN_HEIGHT, "a detector", zoom_given=given)
    save_detections(found, tmp_path / "boxes.json")
    measured = measure_source(plan, load_detections(tmp_path / "boxes.json"), DE)
    assert measured.scale.vehicles_used == len(park)
    said = [remark for remark in measured.remarks if "look like cars" in remark.text]
    assert [(r.severity, bool(r.hint)) for r in said] == [(REFUSAL, True)] * refused
    assert (measured.scale.verdict == UNUSABLE) >= refused
    if refused:
        value = measured.scale.value
        usual, other = np.median(park.length), np.median(boxes.length[len(park) :])
        assert f"{usual:.0f} px" in said[0].text and f"{other:.0f} px" in said[0].text
        assert f"{value:.3g} m/px, or {value * usual / other:.3g}" in said[0].text


@pytest.mark.parametrize(
    "vehicles, doubtful, given, refused",
    [
        (6, 20, False, True),
        (6, 20, True, False),  # the user says how large vehicles are
        (6, 14, False, True),
        (7, 13, False, False),
        (5, 14, False, False),  # too few boxes to say
        (20, 60, False, False),  # too many for chance
    ],
)
def test_few_vehicles_among_many_boxes_may_agree_by_chance(vehicles, doubtful, given, refused):
    """Of a tank farm without cars six of 26 boxes happened to agree, on 0.6 times its scale."""
    boxes = {"plan": car_park(45, 2000, 2000, vehicles)}
    others = {"plan": random_boxes(doubtful, 1900)}
    plan = SimpleNamespace(name="plan", width=2000, height=2000, unit="m/px", claimed=SimpleNamespace(aspect=1.0))
    plan.plan, plan.posed = plan, None
    found = Detections(boxes, 1.0, UNKNOWN_RULER, UNKNOWN_HEIGHT, "a file", doubtful=others, zoom_given=given)
    scale = measure_source(plan, found, DE).scale
    assert scale.vehicles_used == vehicles
    said = [remark for remark in scale.remarks if "by chance" in remark.text]
    assert [(r.severity, bool(r.hint)) for r in said] == [(REFUSAL, True)] * refused
    assert (scale.verdict == UNUSABLE) >= refused
