"""An orthophoto and a model of the same vehicles: their places tie the two together."""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from rasterio import Affine
from support.flights import UNIT, found_by, vehicles
from support.models import make_model, put_frames, save

from orthoscale.actions.cross_check import check_against_model, match
from orthoscale.actions.estimate import estimate
from orthoscale.cli.main import cli
from orthoscale.core.boxes import Boxes
from orthoscale.errors import TooLittleEvidence, UsageError
from orthoscale.formats.detections.own import save_detections

GSD = 0.08  # [m/px] of the orthophoto


def turned(points, scale, angle, shift):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return scale * points @ turn.T + shift


@pytest.mark.parametrize("seed", range(4))
def test_places_give_the_similarity(seed):
    """Half of the vehicles in common, the rest only in one, places off by half a metre."""
    rng = np.random.default_rng(seed)
    a = rng.uniform(0, 120, (50, 2))
    b = turned(a, 1.08, rng.uniform(0, 6), [300, -40]) + rng.normal(0, 0.4, a.shape)
    b = np.concatenate([b[:25], rng.uniform(b.min(0), b.max(0), (20, 2))])[rng.permutation(45)]
    factor, common = match(a, b, 1.6)
    assert factor == pytest.approx(1.08, rel=0.01) and common >= 22


@pytest.mark.parametrize("seed", range(4))
def test_strangers_do_not_match(seed):
    rng = np.random.default_rng(seed)
    assert match(rng.uniform(0, 120, (50, 2)), rng.uniform(0, 120, (45, 2)), 1.6) is None
    assert match(rng.uniform(0, 120, (4, 2)), rng.uniform(0, 120, (45, 2)), 1.6) is None


@pytest.mark.parametrize("rows", [1, 2])
def test_rows_of_other_places_do_not_match(rows):
    """Bays are alike everywhere: a row falls on any other."""
    found = []
    for seed in range(6):
        rng = np.random.default_rng(seed)

        def row(rng=rng):
            line, bay = np.nonzero(rng.random((rows, 20)) < 0.6)
            return np.stack([2.5 * bay, 5.2 * line], -1) + rng.normal(0, 0.15, (len(bay), 2))

        found.append(match(row(), 1.15 * row(), 1.6))
    assert found == [None] * 6


def test_a_vehicle_far_from_few_others_is_no_harm():
    found = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        a = rng.uniform(0, 60, (8, 2))
        b = turned(a, 1.08, 2.0, [300, -40]) + rng.normal(0, 0.2, a.shape)
        found.append(match(np.r_[a, [[400.0, 300.0]]], b, 1.6))
    assert sum(each is not None and abs(each[0] / 1.08 - 1) < 0.02 for each in found) >= 5


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """The folder of a model with boxes of its vehicles, and an orthophoto with boxes of the same ones."""
    folder = tmp_path_factory.mktemp("pair")
    model, turn = make_model()
    save(model, folder / "sparse/0", "bin")
    put_frames(model, folder / "images")
    found = found_by(folder, turn)
    save_detections(found, folder / "model.json")
    bodies, ends = (points @ turn * UNIT for points in vehicles(turn))
    cv2.imwrite(str(folder / "ortho.png"), np.full((1500, 1500, 3), 90, np.uint8))
    rows = []
    for body, end in zip(bodies, ends, strict=True):
        plan = (body[:, :2] * (1, -1)) / GSD + 750
        u = (end[1] - end[0])[:2] * (1, -1) / np.linalg.norm((end[1] - end[0])[:2])
        along, across = plan @ u, plan @ (-u[1], u[0])
        middle = [(v.min() + v.max()) / 2 for v in (along, across)]
        centre = middle[0] * u + middle[1] * np.array([-u[1], u[0]])
        rows.append([*centre, np.ptp(along), np.ptp(across), np.arctan2(u[1], u[0])])
    ruler = replace(found.ruler, margin=(0.0, 0.0))
    boxes = {"ortho.png": Boxes(np.array(rows), np.full(len(rows), 0.9))}
    save_detections(replace(found, boxes=boxes, ruler=ruler, planar=None), folder / "ortho.json")
    return folder


@pytest.fixture(scope="module")
def results(pair):
    ortho = estimate(pair / "ortho.png", fleet="DE", detections=pair / "ortho.json")
    return ortho, estimate(pair, fleet="DE", detections=pair / "model.json")


@pytest.mark.slow
def test_an_orthophoto_and_its_model_agree(results):
    checked = check_against_model(*results)
    assert checked.units_per_pixel == pytest.approx(GSD / UNIT, rel=0.01), "from places alone, better than by sizes"
    assert checked.by_model == pytest.approx(GSD, rel=0.03) and checked.common > 30
    low, high = checked.interval90_by_model
    assert low < GSD < high and not checked.agreement.contradicts
    assert checked.document()["metres_per_pixel_by_model"] == checked.by_model


@pytest.mark.slow
def test_pixels_that_are_not_square_are_laid_on_the_ground_first(results, monkeypatch):
    """As in pictures in degrees: the places of the vehicles are squeezed, their sizes are told in square pixels."""
    ortho, model = results
    square = check_against_model(ortho, model)
    aspect = 0.85
    squeezed = replace(ortho.votes, place=ortho.votes.place / (np.sqrt(aspect), 1 / np.sqrt(aspect)))
    monkeypatch.setattr(ortho.source, "claimed", replace(ortho.source.claimed, aspect=aspect))
    checked = check_against_model(replace(ortho, measured=replace(ortho.measured, votes=squeezed)), model)
    assert checked.common == square.common
    assert checked.units_per_pixel == pytest.approx(square.units_per_pixel, rel=1e-6)


@pytest.mark.slow
def test_a_picture_whose_rows_go_north_shows_the_same_ground(results, monkeypatch):
    ortho, model = results
    usual = check_against_model(ortho, model)
    mirrored = replace(ortho.votes, place=ortho.votes.place * (1, -1) + (0, 1500))
    rows_north = Affine(GSD, 0, 500_000, 0, GSD, 5_400_000)
    monkeypatch.setattr(ortho.source, "claimed", replace(ortho.source.claimed, transform=rows_north))
    checked = check_against_model(replace(ortho, measured=replace(ortho.measured, votes=mirrored)), model)
    assert checked.common == usual.common
    assert checked.units_per_pixel == pytest.approx(usual.units_per_pixel, rel=1e-6)


@pytest.mark.slow
def test_an_orthophoto_that_contradicts_its_model(results):
    ortho, model = results
    stretched = replace(ortho.measured.scale, value=1.2 * ortho.scale.value)
    checked = check_against_model(replace(ortho, measured=replace(ortho.measured, scale=stretched)), model)
    assert checked.agreement.contradicts
    assert checked.by_model == pytest.approx(GSD, rel=0.03)


@pytest.mark.slow
def test_what_cannot_be_checked(results):
    ortho, model = results
    with pytest.raises(UsageError):
        check_against_model(model, ortho)
    elsewhere = np.random.default_rng(0).uniform(0, 1500, ortho.votes.place.shape)
    votes = replace(ortho.votes, place=elsewhere)
    with pytest.raises(TooLittleEvidence, match="do not line up"):
        check_against_model(replace(ortho, measured=replace(ortho.measured, votes=votes)), model)


@pytest.mark.slow
def test_the_command(pair):
    options = ["--detections", pair / "ortho.json", "--model-detections", pair / "model.json", "--fleet", "DE"]
    command = ["check", pair / "ortho.png", "--model", pair, *options]
    shown = CliRunner().invoke(cli, list(map(str, command)), catch_exceptions=False)
    assert shown.exit_code == 0 and "vehicles seen in both" in shown.output
    told = CliRunner().invoke(cli, [*map(str, command), "--json"], catch_exceptions=False)
    assert json.loads(told.stdout)["metres_per_pixel_by_model"] == pytest.approx(GSD, rel=0.03)
    found = json.loads((pair / "ortho.json").read_text())
    for box in found["pictures"]["ortho.png"]:
        box["length"], box["width"] = 1.2 * box["length"], 1.2 * box["width"]
    (pair / "large.json").write_text(json.dumps(found))
    command[command.index(pair / "ortho.json")] = pair / "large.json"
    assert CliRunner().invoke(cli, list(map(str, command))).exit_code == 4


@pytest.mark.slow
@pytest.mark.parametrize("vehicles", [200, 800, 4000])
def test_many_vehicles_are_matched_and_take_little_memory(vehicles):
    """Of 800 vehicles 41 were laid on others at 0.86 times the size, and that was believed."""
    rng = np.random.default_rng(0)
    a = rng.uniform(0, np.sqrt(200 * vehicles), (vehicles, 2))
    b = turned(a, 1.08, 2.0, [300, -40]) + rng.normal(0, 0.3, a.shape)
    b = b[rng.permutation(vehicles)[: 3 * vehicles // 4]]
    tracemalloc.start()
    factor, common = match(a, b, 1.6)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert factor == pytest.approx(1.08, rel=0.003) and common > 0.7 * vehicles and peak < 100e6
    assert match(rng.uniform(0, np.ptp(a), a.shape), b, 1.6) is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_in_a_car_park_the_place_with_most_in_common_is_the_one(seed):
    """Laid a bay further, nearly as many fall on others."""
    rng = np.random.default_rng(seed)
    row, column = np.nonzero(rng.random((12, 40)) < 0.8)
    a = np.stack([2.5 * column, 5.2 * row + 6.0 * (row // 2)], -1) + rng.normal(0, 0.15, (len(row), 2))
    b = turned(a, 1.08, 1.0, [300, -40]) + rng.normal(0, 0.4, a.shape)
    b = b[rng.permutation(len(b))[: 7 * len(b) // 10]]
    factor, _ = match(a[rng.random(len(a)) < 0.8], b, 1.6)
    assert factor == pytest.approx(1.08, rel=0.005)
