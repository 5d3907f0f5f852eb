"""Drift of the scale within a picture: found where there is one, silent where there is none."""

import numpy as np
import pytest

from orthoscale.core.boxes import Boxes
from orthoscale.core.measuring.drift import FEWEST, Drift, drift
from orthoscale.core.measuring.vehicles import vehicle_table
from orthoscale.core.pooling.robust import pool
from orthoscale.core.ruler import Ruler
from orthoscale.core.votes import gather
from orthoscale.fleets import load_fleet
from orthoscale.report import document, judgement

WIDTH, HEIGHT, GSD = 8000, 6000, 0.1


def measured(rng, n, change=lambda x, y: 0.0, clusters=None):
    """The table of `n` vehicles whose local scale is GSD * (1 + change); x, y in -1/2..1/2 of each side."""
    place = rng.random((n, 2)) if clusters is None else rng.random((clusters, 2))[rng.integers(clusters, size=n)]
    place = np.clip(place + (0 if clusters is None else rng.normal(0, 0.01, (n, 2))), 0, 0.999)
    local = GSD * (1 + np.array([change(*(p - 0.5)) for p in place]))
    size = np.exp(rng.multivariate_normal(np.log([4.4, 1.8]), [[0.006, 0.002], [0.002, 0.002]], n)) / local[:, None]
    votes = gather(size, np.ones(n), place * (WIDTH, HEIGHT), np.ones(n), repeated=False)
    return table(votes)


def table(votes):
    boxes = Boxes(np.column_stack([votes.place, votes.size, np.zeros(len(votes))]), votes.score)
    scale = pool(votes, load_fleet("DE"), Ruler(), "m/px")
    return vehicle_table(votes, votes.size, scale, boxes, np.full(len(boxes), "a.tif"))


def test_a_tilt_is_found_with_its_size_and_direction():
    result = drift(measured(np.random.default_rng(1), 600, lambda x, y: 0.08 * x), WIDTH, HEIGHT)
    assert result.tilt == pytest.approx(0.08, abs=3 * result.tilt_sd) and result.tilt_sd < 0.015
    assert abs(result.direction) < 0.4 and result.p_tilt < 1e-4
    assert "towards the right" in result.remark and "is bent" not in result.remark
    upwards = drift(measured(np.random.default_rng(1), 600, lambda x, y: -0.08 * y), WIDTH, HEIGHT)
    assert "towards the top" in upwards.remark


def test_a_bowl_is_found():
    result = drift(measured(np.random.default_rng(2), 900, lambda x, y: 0.3 * (x * x + y * y)), WIDTH, HEIGHT)
    assert result.p_bend < 1e-4 and "bent" in result.remark


def test_the_map_shows_the_scale_by_place():
    result = drift(measured(np.random.default_rng(3), 2000, lambda x, y: 0.1 * x), WIDTH, HEIGHT)
    assert result.cells[:, 2].sum() > 1900 and len(result.cells) == 8 * 6
    slope = np.polyfit(result.cells[:, 0] / WIDTH, result.cells[:, 3], 1)[0]
    assert slope == pytest.approx(0.1, abs=0.015)


@pytest.mark.parametrize("clusters", [None, 12])
def test_false_alarms_are_as_rare_as_promised(clusters):
    rng = np.random.default_rng(4)
    alarms = sum(bool(drift(measured(rng, 120, clusters=clusters), WIDTH, HEIGHT).remark) for _ in range(80))
    assert alarms <= 4, "two tests at half a per cent: 0.8 expected"


def test_too_few_vehicles_say_nothing():
    assert drift(measured(np.random.default_rng(5), FEWEST - 5), WIDTH, HEIGHT) is None


def test_vehicles_in_one_corner_are_no_drift():
    rng = np.random.default_rng(6)
    vehicles = measured(rng, 100)
    vehicles["x_unit"] *= 0.05
    vehicles["y_unit"] *= 0.05
    result = drift(vehicles, WIDTH, HEIGHT)
    assert result.remark == "" and result.p_tilt == 1.0


@pytest.mark.parametrize("p, tilt, drifts", [(0.007, 0.05, False), (0.004, 0.003, False), (0.004, 0.05, True)])
def test_one_judgement_of_drift(p, tilt, drifts):
    """Warned of and shown alike: not what chance makes, not what nobody need know."""
    found = Drift(np.empty((0, 5)), (1.0, 1.0), tilt, 0.01, 0.0, p, 0.0, 1.0)
    assert found.drifts is drifts and bool(found.remark) is drifts
    report = {"unit": "m/px", "scale": 0.1, "interval90": [0.08, 0.12], "drift": document.drift_values(found)}
    assert judgement._places(report).state == ("look" if drifts else "ok")


def test_boxes_that_are_all_alike_show_no_drift(capfd):
    """They scatter not at all, which is no reason to be infinitely sure."""
    place = np.random.default_rng(7).random((200, 2)) * (WIDTH, HEIGHT)
    size = np.tile([44.0, 18.0], (200, 1))
    votes = gather(size, np.ones(200), place, np.ones(200), repeated=False)
    result = drift(table(votes), WIDTH, HEIGHT)
    assert result.remark == "" and np.isfinite(result.tilt_sd)
    assert capfd.readouterr() == ("", "")
