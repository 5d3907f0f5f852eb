"""Vehicles that several frames show say where the ground is, whatever the sparse points lie on."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from orthoscale.core.measuring import parallax
from orthoscale.core.measuring.footing import GROUND_SD
from orthoscale.core.measuring.parallax import MIDDLE, MIDDLE_SD, standing

SIZE = (4.5, 1.8)
HEIGHT = 60.0


def boxes(lower, seed=0, vehicles=20, frames=9, noise=0.08, middle=MIDDLE * SIZE[0], spot=None):
    """Places of boxes on a sheet that lies `lower` (vehicles,) above the ground on which the vehicles stand [m]."""
    rng = np.random.default_rng(seed)
    cameras = np.stack(np.meshgrid(*[np.linspace(-25, 25, 3)] * 2), -1).reshape(-1, 2)[:frames]
    # Side by side in rows, as parked vehicles stand: neighbours may be taken for one another.
    if spot is None:
        spot = np.stack([2.6 * (np.arange(vehicles) % 10), 12.0 * (np.arange(vehicles) // 10)], -1)
    vehicle, frame = np.nonzero(rng.random((vehicles, frames)) < 0.7)
    foot = cameras[frame]
    above = HEIGHT - lower[vehicle]  # of the camera over the sheet
    away = (spot[vehicle] - foot) / (HEIGHT - middle)
    place = foot + away * above[:, None] + rng.normal(0, noise, (len(vehicle), 2))
    return place, foot, above, np.array([f"{k}.jpg" for k in frame]), vehicle


def shown(place, frames=9):
    """All `frames` show each place."""
    return np.full(len(place), frames)


@pytest.mark.parametrize("lower", [-12.0, -8.0, -3.0, -2.0, 0.0, 4.0, 9.0, 13.0])
def test_the_ground_is_found_where_the_sheet_is_not(lower):
    lower = np.full(20, lower)
    place, foot, above, picture, _ = boxes(lower)
    stands = standing(place, foot, above, picture, SIZE, np.full(len(place), 0.15), shown(place))
    true = lower[0] / (HEIGHT - lower[0])
    assert np.median(stands.lower) == pytest.approx(true, abs=2.5 * np.median(stands.sd))
    assert np.median(stands.sd) < 0.01
    assert stands.trees > 0.9 if lower[0] else stands.trees < 0.05


@pytest.mark.parametrize("lower", [1.0, 2.0, 3.0])
def test_a_sheet_that_is_too_high_by_the_same_everywhere(lower):
    """A crop, or a low canopy: nothing but its height tells it from the ground, over however many places."""
    place, foot, above, picture, _ = boxes(np.full(80, lower), vehicles=80)
    stands = standing(place, foot, above, picture, SIZE, np.full(len(place), 0.1), shown(place))
    assert np.median(stands.lower) == pytest.approx(lower / (HEIGHT - lower), abs=2 * np.median(stands.sd))


def test_where_it_differs_from_place_to_place():
    lower = np.where(np.arange(20) < 10, 1.0, 5.0)
    place, foot, above, picture, vehicle = boxes(lower)
    place[vehicle >= 10] += (0, 70)
    foot[vehicle >= 10] += (0, 70)
    stands = standing(place, foot, above, picture, SIZE, np.full(len(place), 0.15), shown(place))
    error = stands.lower - lower[vehicle] / above
    assert np.sqrt(np.mean(error**2)) < 0.012
    assert np.sqrt(np.mean((error / stands.sd) ** 2)) < 2


@pytest.mark.parametrize("height", [-10.0, -6.0])
def test_vehicles_on_a_deck_beside_others_on_the_ground(height):
    """Neither are taken for traffic, for mistakes, or for standing on the level of the others."""
    deck = np.arange(40) >= 20
    spot = np.random.default_rng(1).uniform((-30, -30), (30, -5), (40, 2)) + deck[:, None] * (0, 35)
    lower = np.where(deck, height, 0.0)
    place, foot, above, picture, vehicle = boxes(lower, vehicles=40, spot=spot)
    stands = standing(place, foot, above, picture, SIZE, np.full(len(place), 0.15), shown(place))
    error = stands.lower - lower[vehicle] / above
    assert abs(np.median(error[deck[vehicle]])) < 0.01 and abs(np.median(error[~deck[vehicle]])) < 0.01


def test_a_sheet_that_is_known_well_is_hardly_moved():
    place, foot, above, picture, _ = boxes(np.zeros(20), noise=0.3)
    stands = standing(place, foot, above, picture, SIZE, np.full(len(place), 0.1), shown(place))
    assert np.abs(stands.lower).max() < 0.004
    assert stands.trees < 0.5


def test_what_stands_far_below_the_others_is_no_vehicle_and_does_not_move_the_ground():
    place = np.random.default_rng(0).uniform(0, 60, (20, 2))
    lower = np.where(np.arange(20) % 7 == 0, 9.0, 0.0)
    seen = parallax._SeenVehicles(place, lower, np.full(20, 0.1), np.full(20, 9))
    stands = parallax._combined(seen, place, np.full(20, 0.15), np.full(20, HEIGHT), HEIGHT, MIDDLE_SD * SIZE[0])
    assert stands.vehicles == 17 and stands.trees < 0.05
    assert np.abs(stands.lower).max() < 0.002


@pytest.mark.parametrize("frames", [2, 3, 6])
def test_how_well_few_views_tell_where_a_vehicle_stands(frames):
    pulls = []
    for seed in range(4):
        place, foot, above, picture, _ = boxes(np.full(100, 5.0), seed, 100, frames, noise=0.25, middle=0.0)
        offset, start = (place - foot) / above[:, None], np.full(len(place), 5.0)
        seen = parallax._triangulated(place, offset, picture, start, SIZE[1])
        pulls.append((seen.lower - 5.0) / np.sqrt(seen.variance))
    assert 0.8 < np.sqrt(np.mean(np.square(np.concatenate(pulls)))) < 1.15


def test_a_vehicle_whose_boxes_stray_is_less_certain_and_makes_no_other_so():
    place, foot, above, picture, vehicle = boxes(np.full(60, 5.0), 1, 60, noise=0.1, middle=0.0)
    straying = place + (vehicle < 4)[:, None] * np.random.default_rng(2).normal(0, 0.4, place.shape)
    start = np.full(len(place), 5.0)
    steady, mixed = (
        parallax._triangulated(p, (p - foot) / above[:, None], picture, start, SIZE[1]) for p in (place, straying)
    )
    bad = mixed.place[:, 0] < 2.6 * 3.5
    bad &= mixed.place[:, 1] < 6
    assert len(mixed.lower) == len(steady.lower) == 60 and bad.sum() == 4
    assert np.median(mixed.variance[~bad]) < 1.2 * np.median(steady.variance)
    assert mixed.variance[bad].min() > 3 * np.median(steady.variance)


@pytest.mark.parametrize("frames", [1, 9])
def test_without_parallax_the_sheet_stands(frames):
    place, foot, above, picture, _ = boxes(np.full(20, 4.0), frames=frames, vehicles=20 if frames == 1 else 1)
    sd = np.full(len(place), 0.2)
    stands = standing(place, foot, above, picture, SIZE, sd, shown(place, frames))
    assert stands.vehicles == 0 and not stands.lower.any()
    assert stands.shared == GROUND_SD
    assert stands.each == pytest.approx(sd / above), "the two together are what is not known"


@pytest.mark.parametrize("seed", [2, 3])
def test_of_traffic_the_sheet_stands(seed, monkeypatch):
    """Views of moving vehicles meet by chance, and at some depth below the sheet more of them than on it."""
    place, foot, above, picture, _ = boxes(np.zeros(60), vehicles=60)
    moved = place + np.random.default_rng(seed).uniform(-30, 30, place.shape)
    given = (moved, foot, above, picture, SIZE, np.full(len(place), 0.15), shown(place))
    stands = standing(*given)
    assert stands.vehicles == 0 and not stands.lower.any()
    monkeypatch.setattr(parallax, "FOUND_AGAIN", 0.0)
    assert np.abs(standing(*given).lower).max() > 0.09, "else this test tells nothing"


def test_what_all_vehicles_err_by_alike_counts_apart_and_once():
    error, claimed = [], []
    for seed in range(40):  # how high over the ground rays meet is another thing in each
        middle = (MIDDLE + MIDDLE_SD * np.random.default_rng([seed, 1]).standard_normal()) * SIZE[0]
        place, foot, above, picture, _ = boxes(np.full(20, 5.0), seed, middle=middle)
        stands = standing(place, foot, above, picture, SIZE, np.full(len(place), 0.15), shown(place))
        error.append(np.mean(stands.lower - 5.0 / above))
        claimed.append(stands.shared)
        assert stands.each**2 + stands.shared**2 == pytest.approx(np.maximum(stands.sd, stands.shared) ** 2)
    assert max(claimed) < GROUND_SD, "what the sheet alone leaves open is claimed besides"
    assert 0.5 < np.sqrt(np.mean(np.square(error) / np.square(claimed))) < 1.2


@pytest.mark.slow
def test_many_vehicles_take_little_memory(monkeypatch):
    """A thousand of them in 24 views each were matrices of their product."""
    rng = np.random.default_rng(0)
    vehicles, boxes = 1000, 24_000
    seen = parallax._SeenVehicles(
        rng.uniform(0, 900, (vehicles, 2)),
        rng.normal(0.5, 0.2, vehicles),
        np.full(vehicles, 0.01),
        np.full(vehicles, 24),
    )
    place, sd = rng.uniform(0, 900, (boxes, 2)), rng.uniform(0.1, 0.3, boxes)
    tracemalloc.start()
    stands = parallax._combined(seen, place, sd, np.full(boxes, HEIGHT), HEIGHT, 0.1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert stands.vehicles > 900 and peak < 100e6
    some = slice(0, 1500)
    given = (seen, place[some], sd[some], np.full(1500, HEIGHT), HEIGHT, 0.1)
    by_parts = parallax._combined(*given)
    monkeypatch.setattr(parallax, "BOXES_AT_ONCE", boxes)
    at_once = parallax._combined(*given)
    assert (by_parts.lower == pytest.approx(at_once.lower)) and by_parts.sd == pytest.approx(at_once.sd)
    assert by_parts.shared == pytest.approx(at_once.shared)
