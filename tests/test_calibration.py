"""The ruler, fitted from views of vehicles without any metres: what was put in comes back."""

from __future__ import annotations

import numpy as np
import pytest

from orthoscale.projection.calibration import Calibration, calibrate, trends

METRES = 3.7  # per unit
CARD = Calibration(np.array([0.7, 0.5]), np.full(2, 0.25), np.zeros(2), np.full(2, 1.5))


def views(height, margin, noise=(0.12, 0.06), seed=0, vehicles=80, each=8, alike=0.0):
    """Sizes of vehicles seen flatly and steeply, near and far: flat sizes [units], lean, pixel, members."""
    rng = np.random.default_rng(seed)
    vehicle = np.repeat(np.arange(vehicles), each)
    true_size = rng.normal([4.5, 1.8], [0.4, 0.1], (vehicles, 2))
    leaning = rng.uniform(0, 1, (len(vehicle), 2))
    pixel = rng.uniform(0.04, 0.12, len(vehicle))  # [m]
    own = alike * rng.normal(size=(vehicles, 2))[vehicle] * leaning  # what a vehicle does in all its flat views
    size = true_size[vehicle] + np.array(height) * leaning + np.array(margin) * pixel[:, None]
    size = size + own + rng.normal(0, noise, size.shape)
    return size / METRES, leaning, pixel / METRES, [np.flatnonzero(vehicle == k) for k in range(vehicles)]


@pytest.mark.parametrize("height", [(0.5, 0.5), (0.8, 0.4), (1.6, 0.2)])
@pytest.mark.parametrize("margin", [(0.0, 0.0), (2.0, 1.0), (4.0, 4.0)])
def test_height_and_margin_come_back(height, margin):
    flat, leaning, pixel, members = views(height, margin)
    flat[::45] += 3.0 / METRES  # an odd box now and then
    card = Calibration(np.full(2, 0.9), np.full(2, 1.0), np.full(2, 2.0), np.full(2, 3.0))
    ruler = calibrate(flat, leaning, pixel, members, METRES, card, 2.0)
    assert ruler.height == pytest.approx(height, abs=0.15)
    assert ruler.margin == pytest.approx(margin, abs=1.0)
    assert (np.abs(ruler.margin - margin) < 3 * ruler.margin_sd).all()
    tight = flat - leaning * ruler.height / METRES - ruler.margin * pixel[:, None]
    changes = trends(flat, tight, 90 - 60 * leaning.mean(1), pixel, members)
    for name, (slope, sd) in changes["after"].items():
        assert abs(slope) < 3.5 * sd, name


def test_what_the_views_do_not_tell_stays_as_the_card_says():
    flat, leaning, pixel, members = views((0.7, 0.5), (0, 0))
    single = [np.array([k]) for k in range(80)]
    assert calibrate(flat, leaning, pixel, single, METRES, CARD, 1.5) is CARD
    assert trends(flat, flat, leaning[:, 0], pixel, single) is None
    same = calibrate(flat, np.full_like(leaning, 0.5), np.full_like(pixel, 0.02), members, METRES, CARD, 1.5)
    assert same.height == pytest.approx(CARD.height) and same.margin == pytest.approx(CARD.margin)
    assert same.height_sd == pytest.approx(CARD.height_sd) and same.margin_sd == pytest.approx(CARD.margin_sd)


def test_boxes_that_err_alike_count_less():
    own = calibrate(*views((0.7, 0.5), (1, 1)), METRES, CARD, 1.5)
    alike = calibrate(*views((0.7, 0.5), (1, 1), alike=0.5), METRES, CARD, 1.5)
    assert (alike.height_sd > 1.5 * own.height_sd).all()


def test_the_height_stays_within_reason():
    assert calibrate(*views((3.0, -2.0), (0, 0)), METRES, CARD, 1.5).height == pytest.approx([1.5, 0.0])
