"""Found vehicles are measured once more: their sizes, their noise, what is no vehicle, and what is not measured."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support.drawings import Drawing, car_park

import orthoscale
from orthoscale.actions import find
from orthoscale.core.boxes import Boxes, matched
from orthoscale.core.detections import UNKNOWN_RULER, Detections
from orthoscale.core.measuring.ways import measure_source
from orthoscale.core.projection.exact import BODIES
from orthoscale.core.ruler import Ruler
from orthoscale.detect.effort import Effort
from orthoscale.detect.measurer import Measured, Measurer, MeasurerCard
from orthoscale.detect.remeasure import MOST, WHY_NONE, remeasured
from orthoscale.errors import InputError, UsageError
from orthoscale.fleets import load_fleet
from orthoscale.formats.detections.own import load_detections, save_detections
from orthoscale.requests import EstimateRequest
from orthoscale.sources.opening import open_source
from orthoscale.synthetic import make_scene, write_ortho

WEIGHTS = Path(orthoscale.__file__).parent / "detect" / "weights"

CARD = MeasurerCard("a measurer", Ruler(margin_sd=(0.4, 0.2), noise=(1.0, 0.5)), (2.0, 3.0), (0.8, 0.8), "cuboid")
QUIET = Effort(workers=1, cache=False)


class Sees:
    """A measurer that knows where vehicles are: the nearest of `truth`, or none within its length."""

    card, sha256 = CARD, "measurer"

    def __init__(self, truth: Boxes) -> None:
        self.truth, self.looks = truth, 0

    def __call__(self, picture: object, boxes: Boxes, enlarged: Fraction, contrast: float) -> Measured:
        self.looks += len(boxes)
        apart = np.linalg.norm(boxes.centre[:, None] - self.truth.centre, axis=2)
        near = apart.argmin(1)
        there = apart.min(1) < self.truth.length[near]
        xylwa = np.where(there[:, None], self.truth.xylwa[near], boxes.xylwa)
        kind = np.where(there[:, None], [0.2, 0.6, 0.1, 0.1, 0.0], [0.1, 0, 0, 0, 0.9])
        sigma = np.repeat([[0.3, 0.4, 0.1, 0.1]], len(boxes), 0)
        return Measured(Boxes(xylwa, boxes.score), sigma, np.ones((len(boxes), 4)), kind, np.full(len(boxes), np.nan))


def found(boxes: Boxes, zoom: float = 0.5) -> Detections:
    return Detections({"drawing": boxes}, zoom, UNKNOWN_RULER, (0.7, 0.5), "a detector", "detector")


def proposed(truth: Boxes, larger: tuple[float, float] = (1.1, 1.05)) -> Boxes:
    return Boxes(truth.xylwa * [1, 1, *larger, 1], np.linspace(0.9, 0.4, len(truth)))


def test_the_measurers_sizes_take_the_place_of_the_detectors():
    truth = car_park(40, 1800, 1500, 30)
    picture = Drawing(1800, 1500, truth)
    got = remeasured([picture], found(proposed(truth)), Sees(truth), QUIET)
    boxes = got.boxes["drawing"]
    assert boxes.xylwa == pytest.approx(truth.xylwa)
    assert (boxes.score == proposed(truth).score).all(), "how sure a vehicle is, the detector says"
    assert boxes.sigma * boxes.xylwa[:, 2:4] == pytest.approx(
        np.array([[2 * 0.5, 3 * np.hypot(0.1, 0.1)]] * len(truth))
    )
    assert boxes.kinds == pytest.approx(np.array([[0.2, 0.6, 0.1, 0.1]] * len(truth)))
    assert got.ruler.margin_sd == (0.2, 0.1) and got.ruler.noise == (0.5, 0.25), "in detector pixels, of two each"
    assert (got.effective_height, got.body) == ((0.8, 0.8), "cuboid")
    assert got.detector == "a detector, measured by a measurer" and got.detector_sha256 == "measurer"


def test_what_is_no_vehicle_does_not_count():
    truth = car_park(40, 1800, 1500, 30)
    seen = proposed(truth)
    got = remeasured([Drawing(1800, 1500, truth)], found(seen), Sees(truth[5:]), QUIET)
    near = np.linalg.norm(seen.centre[:, None] - truth[5:].centre, axis=2).min(1) < truth.length.max()
    unlike = len(got.set_aside[WHY_NONE]["drawing"])
    assert not got.doubtful, "the detector saw it in both passes"
    again = remeasured([Drawing(1800, 1500, truth)], replace(got, boxes={"drawing": seen}), Sees(truth[5:]), QUIET)
    assert len(again.set_aside[WHY_NONE]["drawing"]) == 2 * unlike
    assert unlike >= (~near).sum() > 0 and unlike + len(got) == len(seen)
    assert not got.notes, "reports count them among the rejected"


def test_of_very_many_vehicles_some_are_measured_and_tell_of_the_others():
    rng = np.random.default_rng(0)
    count = 3 * MOST
    place = np.stack(np.meshgrid(np.arange(60), np.arange(count // 60)), -1).reshape(-1, 2) * 60.0 + 40
    truth = Boxes(np.column_stack([place, rng.normal([40, 16], [3, 0.5], (count, 2)), np.zeros(count)]), np.ones(count))
    seen = proposed(truth)
    seen = Boxes(seen.xylwa * np.exp([0, 0, 0.04, 0.02, 0] * rng.standard_normal((count, 5))), seen.score)
    sees = Sees(truth)
    got = remeasured([Drawing(3700, 1300, truth)], found(seen), sees, QUIET).boxes["drawing"]
    assert sees.looks == MOST and len(got) == count
    order = np.argsort(got.xylwa[:, 1] * 1e4 + got.xylwa[:, 0])
    size, sigma = got.xylwa[order, 2:4], got.sigma[order]
    others = np.isnan(got.kinds[order]).any(1)
    assert others.sum() == count - MOST
    error = np.log(size / truth.xylwa[:, 2:4])
    assert np.median(error, axis=0) == pytest.approx([0, 0], abs=0.004)
    assert np.std(error[others], axis=0) == pytest.approx(sigma[others].mean(0), rel=0.15)
    assert np.abs(np.corrcoef(others, seen.score)[0, 1]) < 0.1, "measured are the best and the worst alike"


def test_measured_sizes_travel_in_files(tmp_path):
    truth = car_park(20, 1200, 900, 30)
    got = remeasured([Drawing(1200, 900, truth)], found(proposed(truth)), Sees(truth), QUIET)
    save_detections(got, tmp_path / "found.json")
    again = load_detections(tmp_path / "found.json")
    assert again.detector == got.detector and again.ruler == got.ruler and again.body == "cuboid"
    a, b = again.boxes["drawing"], got.boxes["drawing"]
    assert a.xylwa == pytest.approx(b.xylwa, abs=0.01) and a.sigma == pytest.approx(b.sigma, abs=1e-5)
    assert a.kinds == pytest.approx(b.kinds, abs=1e-3)


def test_a_second_run_looks_at_nothing_again(tmp_path, monkeypatch):
    monkeypatch.setenv("ORTHOSCALE_CACHE", str(tmp_path))
    truth = car_park(20, 1200, 900, 30)
    picture = Drawing(1200, 900, truth)
    picture.fingerprint = lambda: "content"
    first, second, other = Sees(truth), Sees(truth), Sees(truth)
    results = [remeasured([picture], found(proposed(truth)), sees, Effort(workers=1)) for sees in (first, second)]
    assert first.looks == len(truth) and second.looks == 0
    assert (results[0].boxes["drawing"].xylwa == results[1].boxes["drawing"].xylwa).all()
    other.sha256 = "another"
    remeasured([picture], found(proposed(truth)), other, Effort(workers=1))
    assert other.looks == len(truth)


def test_in_a_model_frames_and_ground_pictures_are_measured(monkeypatch):
    """Each in their own pixels; by default, with the detector's own boxes, and not with a calibration."""
    truth = car_park(20, 1200, 900, 30)
    picture = Drawing(1200, 900, truth)
    picture.frame = picture
    monkeypatch.setattr(find, "Measurer", lambda path: Sees(truth))
    seen = found(proposed(truth))
    model = SimpleNamespace(pictures=[picture], ground_pictures=[picture], path="model")
    model.posed = model
    got = find.measured_anew(model, replace(seen, planar=seen), EstimateRequest(), QUIET)
    for found_so in (got, got.planar, find.measured_anew(model, seen, EstimateRequest(), QUIET)):
        assert found_so.boxes["drawing"].xylwa == pytest.approx(truth.xylwa) and found_so.ruler != UNKNOWN_RULER
    only = find.measured_anew(model, replace(seen, boxes={}, planar=seen), EstimateRequest(), QUIET)
    assert not len(only) and only.planar.boxes["drawing"].xylwa == pytest.approx(truth.xylwa)

    ortho = SimpleNamespace(pictures=[picture], posed=None)
    for options, measures in (
        ({}, True),
        ({"measurer": "none"}, False),
        ({"detector": "d.onnx"}, False),
        ({"detector": "d.onnx", "measurer": "built-in"}, True),
        ({"detections": "boxes.json"}, False),
        ({"detections": "boxes.json", "measurer": "m.onnx"}, True),
        ({"calibration": "c.json"}, False),
    ):
        got = find.measured_anew(ortho, seen, EstimateRequest(**options), QUIET)
        assert (got is not seen) == measures, options
    with pytest.raises(UsageError, match="--calibration is for a detector's boxes"):
        EstimateRequest(calibration="c.json", measurer="built-in")


def test_a_network_that_is_no_measurer_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        Measurer(tmp_path / "missing.onnx")
    with pytest.raises(InputError, match="not a measurer"):
        Measurer(WEIGHTS / "small_vehicle.onnx")
    card = Measurer().card
    assert card.body in BODIES and min(card.sigma_times) >= 1 and "m" in card.name
    with pytest.raises(InputError, match="card"):
        MeasurerCard.from_json("", "a file")


@pytest.mark.slow
def test_measured_vehicles_are_as_long_as_they_are(tmp_path):
    """The shipped measurer in a rendered suburb that it has not seen, with boxes too large and beside the mark; and a
    file of what it measured gives the same scale."""
    scene = make_scene(seed=77, fleet=load_fleet("DE"), extent_m=60, n_vehicles=30, style="suburb")
    truth = write_ortho(scene, tmp_path / "town.png", 0.11, seed=7)
    fields = ("cx", "cy", "length", "width", "angle")
    true = np.array([[box[k] for k in fields] for box in truth["boxes"] if box["visible"] > 0.9])
    boxes = Boxes(true * [1, 1, 1.1, 1.15, 1] + [2, -1, 0, 0, 0.05], np.ones(len(true)))
    source = open_source(tmp_path / "town.png", None, True)
    seen = Detections({"town.png": boxes}, 0.9, UNKNOWN_RULER, (0.7, 0.5), "a detector")
    got = find.measured_anew(source, seen, EstimateRequest(), QUIET)
    measured = got.boxes["town.png"]
    i, j, _ = matched(measured, Boxes(true, np.ones(len(true))), 0.5)
    error = np.log(measured.xylwa[i, 2:4] / true[j, 2:4])
    assert len(i) > 0.85 * len(true) > 15
    assert np.median(error, axis=0) == pytest.approx([0, 0], abs=0.03)
    assert (np.median(np.abs(error) / measured.sigma[i], axis=0) < 1.4).all(), "0.67, if sigmas are right"

    before = measure_source(source, got, load_fleet("DE")).scale
    save_detections(got, tmp_path / "boxes.json")
    again = orthoscale.estimate(tmp_path / "town.png", fleet="DE", detections=tmp_path / "boxes.json", anchors=["none"])
    assert again.scale.value == pytest.approx(before.value, rel=1e-3)
    assert before.value == pytest.approx(0.11, rel=0.06)
