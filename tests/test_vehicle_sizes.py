"""One vehicle has one size: in the report, the layers for other programs, on the page, and on the ground."""

from __future__ import annotations

import json
import re
from types import SimpleNamespace

import numpy as np
import pyogrio
import pytest
from support.flights import FLEET, UNIT, vehicles
from support.reports import GSD, car_park, fixed

from orthoscale.core.boxes import Boxes
from orthoscale.core.measuring.vehicles import vehicle_table
from orthoscale.core.votes import Sightings, gather
from orthoscale.report.page import page
from orthoscale.report.result import Result
from orthoscale.report.scene import ReportPictures
from orthoscale.report.stored import read_json
from orthoscale.sources.colmap import ColmapSource


def test_an_orthophotos_vehicles_have_one_size_in_every_output_and_the_true_one(tmp_path):
    truth = car_park(tmp_path)["size"]
    html = fixed(tmp_path, also=["gpkg", "tiles"]).read_text()
    report = read_json(tmp_path / "scaled.tif.json")
    said = np.array([[v["length"], v["width"]] for v in report["vehicles"]])
    layer = pyogrio.raw.read(tmp_path / "scaled.tif.gpkg", layer="vehicles")
    columns = dict(zip(layer[0]["fields"], layer[3], strict=True))
    assert np.stack([columns["length_m"], columns["width_m"]], -1) == pytest.approx(said, rel=1e-12)
    assert said[:60] == pytest.approx(truth * report["scale"] / GSD, abs=1e-6)
    shown = set(re.findall(r"<figcaption>(\d+\.\d\d × \d+\.\d\d) m", html))
    assert len(shown) > 20 and shown <= {f"{length:.2f} × {width:.2f}" for length, width in said}


@pytest.mark.parametrize("mode", ["oblique", "planar", None])
def test_a_models_vehicles_have_one_size_in_every_output_and_the_true_one(flight, found, measured, mode):
    folder, turn = flight
    source = ColmapSource.open(folder)
    measured = measured if mode is None else measured.modes[mode]
    result = Result(source, FLEET, found, 0.0, measured)
    report = json.loads(json.dumps(result.to_dict()))
    said = np.array([[v["length"], v["width"]] for v in report["vehicles"]])
    assert said == pytest.approx(np.stack([result.vehicles["length"], result.vehicles["width"]], -1), rel=1e-12)
    assert said == pytest.approx(measured.size * measured.scale.value, rel=1e-12), "the margin is off it once"

    bodies, ends = vehicles(turn)
    along = ends[:, 1] - ends[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(turn[:, 2], along)
    true = np.stack([np.ptp(np.einsum("npk,nk->np", bodies, axis), axis=1) for axis in (along, across)], -1) * UNIT
    place = np.array([v["place_unit"] for v in report["vehicles"]])
    gap = np.linalg.norm(place[:, None] - ends.mean(1), axis=2)
    ratio = said / report["scale"] * UNIT / true[gap.argmin(1)]
    assert (gap.min(1) < 0.2).all()
    # The bodies are meshes with lamps and shoulders, the ruler's a hull: that far the two may part.
    assert np.median(ratio, axis=0) == pytest.approx(1, abs=0.012)

    labels = re.findall(r"<figcaption>(\d+\.\d\d × \d+\.\d\d) m", page(report, ReportPictures.of(report, source)))
    assert labels and set(labels) <= {f"{length:.2f} × {width:.2f}" for length, width in said}


def test_how_far_a_vehicle_is_off_is_told_from_the_mean_of_those_that_count():
    boxes = Boxes(np.array([[50.0 * k, 9.0, side, side / 2, 0.0] for k, side in enumerate((40, 44, 90))]), np.ones(3))
    votes = gather(Sightings(boxes.xylwa[:, 2:4], np.ones(3), boxes.centre, boxes.score), repeated=False)
    used = np.array([True, True, False])
    scale = SimpleNamespace(value=0.1, weights=(0.7, 0.3), used=used, reasons=["", "", "too large for a car"])
    off = vehicle_table(votes, votes.size, scale, boxes, np.full(3, "a"))["scale_deviation"]
    assert off[:2].sum() == pytest.approx(0) and off[2] == pytest.approx(-np.log(90 / np.sqrt(40 * 44)))
