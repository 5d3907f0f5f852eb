"""Frames and regions that disagree are named, and those that agree are not."""

from __future__ import annotations

import numpy as np
import pytest

from orthoscale.core.measuring.model_drift import by_region, model_drift
from orthoscale.core.pooling.robust import pool
from orthoscale.core.ruler import Ruler
from orthoscale.core.votes import gather
from orthoscale.fleets import load_fleet
from orthoscale.report.document import _model_drift
from orthoscale.report.drift_map import regions_panel, side_by_side

UNIT = 5.0  # [m]


def seen(stray=(), bend=0.0, seed=0, vehicles=60, frames=12, bowl=0.0):
    """Vehicles of one fleet, each seen by half of the frames; `stray` says by how much frames see them too small,
    `bend` by how much the scale grows from side to side, `bowl` from the middle to the corners."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(0, 40, (vehicles, 2))
    true = load_fleet("DE").sample(rng, vehicles)[:, :2] / UNIT
    true *= np.exp(-bend * (place[:, :1] / 40 - 0.5))
    true *= np.exp(-bowl * ((place / 20 - 1) ** 2).sum(1, keepdims=True) / 2)
    vehicle, frame = np.nonzero(rng.random((vehicles, frames)) < 0.5)
    wrong = np.ones(frames)
    for k, by in stray:
        wrong[k] = 1 + by
    size = true[vehicle] / wrong[frame, None] * np.exp(rng.normal(0, 0.03, (len(vehicle), 2)))
    votes = gather(size, np.full(len(size), 0.004), place[vehicle], np.ones(len(size)), repeated=True)
    scale = pool(votes, load_fleet("DE"), Ruler(), "m/model-unit")
    return model_drift(size, np.array([f"{k:02d}.jpg" for k in frame]), votes, scale, votes.place), scale


def test_a_frame_that_disagrees_is_named():
    found, scale = seen(stray=[(3, 0.2)])
    assert [name for name, _ in found.odd] == ["03.jpg"]
    assert found.frames["03.jpg"].scale == pytest.approx(1.2 * scale.value, rel=0.04)
    assert "03.jpg by +2" in found.warnings[0]


def test_two_frames_are_named_worst_first():
    found, _ = seen(stray=[(3, 0.12), (7, -0.25)])
    assert [name for name, _ in found.odd] == ["07.jpg", "03.jpg"]


@pytest.mark.parametrize("seed", range(5))
def test_frames_that_agree_are_not(seed):
    found, scale = seen(seed=seed)
    assert list(found.odd) == [] and len(found.frames) == 12
    assert all(abs(f.scale / scale.value - 1) < 0.05 for f in found.frames.values())


def test_a_bent_model_shows_a_trend():
    straight, _ = seen()
    assert straight.trend.chance > 0.01 and straight.warnings == []
    bent, _ = seen(bend=0.3)
    assert bent.trend.chance < 0.001 and 15 < bent.trend.percent_across < 50
    assert "across the model" in bent.warnings[-1]
    scales = [region.scale for region in sorted(bent.regions, key=lambda r: r.centre[0])]
    assert scales[-1] > 1.1 * scales[0]


def test_a_bowl_is_told_from_a_tilt_and_drawn():
    found, scale = seen(bowl=0.3, vehicles=120)
    assert found.bends and found.drifts and found.trend.bend_chance < 1e-4
    assert 20 < found.trend.percent_bent < 45
    assert found.amplitude >= found.trend.percent_bent / 100 * 0.99
    assert "as in a bowl" in found.warnings[-1]
    plain, _ = seen(vehicles=120)
    assert not plain.bends
    values = {"regions": _model_drift(found)["regions"], "drifts": True}
    panel = regions_panel(values, scale.value, 600)
    orange = (panel.astype(int)[..., 0] - panel[..., 2] > 60).sum()
    blue = (panel.astype(int)[..., 2] - panel[..., 0] > 60).sum()
    assert orange > 1000 and blue > 1000
    assert (panel == 255).all(2).mean() > 0.1


def test_a_strip_without_breadth_has_a_trend_all_the_same():
    along = np.linspace(0, 50, 30)
    plan = np.column_stack([along, np.zeros(30)])
    _, trend = by_region(0.1 * (along / 50 - 0.5) ** 2 + 1e-3 * np.sin(np.arange(30)), plan, 5.0)
    assert trend.bend_chance < 1e-6 and trend.percent_bent == pytest.approx(2.5, rel=0.3)


def test_few_vehicles_have_no_trend():
    assert by_region(np.zeros(6), np.random.default_rng(0).uniform(size=(6, 2)), 5.0)[1] is None


def test_squares_of_regions_do_not_hide_each_other():
    crowded = np.random.default_rng(2).uniform(0, 300, (9, 2))
    placed = side_by_side(crowded, 100.0)
    apart = np.abs(placed[:, None] - placed[None]).max(2)
    assert apart[~np.eye(9, dtype=bool)].min() > 99.9, "the labels of one would cover the other's"
    far = np.array([[0.0, 0.0], [150.0, 0.0], [0.0, 150.0]])
    assert (side_by_side(far, 100.0) == far).all(), "what has room stays at its place"
