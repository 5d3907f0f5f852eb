"""Drift of the scale within a picture: found where there is one, silent where there is none."""

import json
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import orthoscale
from orthoscale.core.boxes import Boxes
from orthoscale.core.measuring import judgement
from orthoscale.core.measuring.drift import FEWEST, Drift, Trend, drift, with_drift
from orthoscale.core.measuring.surface import Cells, SurfaceFit
from orthoscale.core.measuring.vehicles import VEHICLE, vehicle_table
from orthoscale.core.normal import Z90
from orthoscale.core.pooling.robust import pool
from orthoscale.core.remarks import CAUTION, ON_PLACES, REFUSAL, SUPPORT, Remark
from orthoscale.core.ruler import Ruler
from orthoscale.core.scale import Scale
from orthoscale.core.votes import Sightings, gather
from orthoscale.errors import EvidenceDisagrees
from orthoscale.fleets import load_fleet

WIDTH, HEIGHT, GSD = 8000, 6000, 0.1


def measured(rng, n, change=lambda x, y: 0.0, clusters=None):
    """The table of `n` vehicles whose local scale is GSD * (1 + change); x, y in -1/2..1/2 of each side."""
    place = rng.random((n, 2)) if clusters is None else rng.random((clusters, 2))[rng.integers(clusters, size=n)]
    place = np.clip(place + (0 if clusters is None else rng.normal(0, 0.01, (n, 2))), 0, 0.999)
    local = GSD * (1 + np.array([change(*(p - 0.5)) for p in place]))
    size = np.exp(rng.multivariate_normal(np.log([4.4, 1.8]), [[0.006, 0.002], [0.002, 0.002]], n)) / local[:, None]
    votes = gather(Sightings(size, np.ones(n), place * (WIDTH, HEIGHT), np.ones(n)), repeated=False)
    return table(votes)


def table(votes):
    boxes = Boxes(np.column_stack([votes.place, votes.size, np.zeros(len(votes))]), votes.score)
    scale = pool(votes, load_fleet("DE"), Ruler(), "m/px")
    return vehicle_table(votes, votes.size, scale, boxes, np.full(len(boxes), "a.tif"))


def test_a_tilt_is_found_with_its_size_and_direction():
    result = drift(measured(np.random.default_rng(1), 600, lambda x, y: 0.08 * x), WIDTH, HEIGHT, GSD)
    assert result.trend.tilt == pytest.approx(0.08, abs=3 * result.trend.tilt_sd) and result.trend.tilt_sd < 0.03
    assert abs(result.direction) < 0.4 and result.trend.tilts
    assert "towards the right" in result.warnings[0] and "is bent" not in result.warnings[0]
    upwards = drift(measured(np.random.default_rng(1), 600, lambda x, y: -0.08 * y), WIDTH, HEIGHT, GSD)
    assert "towards the top" in upwards.warnings[0]


@pytest.mark.parametrize("along, across", [(0.08, 0.0), (0.0, 0.08), (0.06, 0.06)])
def test_a_tilt_is_the_change_from_one_end_of_the_picture_to_the_other(along, across):
    """Along the steepest direction, in a picture that is wider than high."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-0.5, 0.5, (2, 800))
    table = np.zeros(800, VEHICLE)
    table["used"], table["scale_deviation"] = True, along * x + across * y + rng.normal(0, 0.003, 800)
    table["x_unit"], table["y_unit"] = (x + 0.5) * WIDTH, (y + 0.5) * HEIGHT
    steepest = np.array([along / WIDTH, across / HEIGHT])
    far = np.abs(steepest / np.linalg.norm(steepest)) @ (WIDTH, HEIGHT)
    assert drift(table, WIDTH, HEIGHT, GSD).trend.tilt == pytest.approx(np.linalg.norm(steepest) * far, rel=0.05)


@pytest.mark.parametrize("aspect", [0.5, 2.0])
def test_a_drift_is_that_of_the_ground_where_pixels_are_not_square(aspect):
    """Lots were stretched as the pixels are, and how far chance makes a trend of their differences was wrong."""
    rng = np.random.default_rng(8)
    square = measured(rng, 200, lambda x, y: 0.06 * x - 0.02 * y + 0.1 * y * y, clusters=20)
    wide = np.array([aspect**0.5, aspect**-0.5])
    oblong = square.copy()
    oblong["x_unit"] /= wide[0]
    oblong["y_unit"] /= wide[1]
    one, other = drift(square, WIDTH, HEIGHT, GSD), drift(oblong, WIDTH / wide[0], HEIGHT / wide[1], GSD, aspect)
    assert vars(other.trend) == pytest.approx(vars(one.trend), rel=1e-6)
    assert other.direction == pytest.approx(one.direction, rel=1e-6)
    assert other.cell == pytest.approx(one.cell / wide), "pixels of the picture"
    assert other.cells[:, :2] == pytest.approx(one.cells[:, :2] / wide)


def test_a_bowl_is_found():
    result = drift(measured(np.random.default_rng(2), 900, lambda x, y: 0.3 * (x * x + y * y)), WIDTH, HEIGHT, GSD)
    assert result.trend.p_bend < 1e-3 and "bent" in result.warnings[0]


def test_the_map_shows_the_scale_by_place():
    result = drift(measured(np.random.default_rng(3), 2000, lambda x, y: 0.1 * x), WIDTH, HEIGHT, GSD)
    assert result.cells[:, 2].sum() > 1900 and len(result.cells) == 8 * 6
    slope = np.polyfit(result.cells[:, 0] / WIDTH, result.cells[:, 3], 1)[0]
    assert slope == pytest.approx(0.1, abs=0.015)


@pytest.mark.slow
@pytest.mark.parametrize("clusters", [None, 12])
def test_false_alarms_are_as_rare_as_promised(clusters):
    rng = np.random.default_rng(4)
    alarms = sum(bool(drift(measured(rng, 120, clusters=clusters), WIDTH, HEIGHT, GSD).warnings) for _ in range(80))
    assert alarms <= 4, "two tests at half a per cent: 0.8 expected"


def test_too_few_vehicles_say_nothing():
    assert drift(measured(np.random.default_rng(5), FEWEST - 5), WIDTH, HEIGHT, GSD) is None


def test_vehicles_in_one_corner_are_no_drift():
    rng = np.random.default_rng(6)
    vehicles = measured(rng, 100)
    vehicles["x_unit"] *= 0.05
    vehicles["y_unit"] *= 0.05
    result = drift(vehicles, WIDTH, HEIGHT, GSD)
    assert result.warnings == [] and result.trend.p_tilt == 1.0


def scale_of_whole(sd=0.025):
    used = np.ones(50, bool)
    low, high = GSD * np.exp(-Z90 * sd), GSD * np.exp(Z90 * sd)
    checks = {"length": GSD, "width": GSD}
    return Scale(GSD, "m/px", (low, high), {"fleet": sd}, checks, (0.5, 0.5), 0.0, "DE", "good", used, [""] * 50)


@pytest.mark.parametrize("p, tilt, drifts", [(0.007, 0.05, False), (0.004, 0.003, False), (0.004, 0.05, True)])
def test_one_judgement_of_drift(p, tilt, drifts):
    """Warned of and shown alike: not what chance makes, not what nobody need know."""
    found = Drift(Trend(tilt, p, tilt_sd=0.01), np.empty((0, 5)), (1.0, 1.0), direction=0.0)
    assert found.drifts is drifts and bool(found.warnings) is drifts and (found.amplitude > 0) is drifts
    told = SimpleNamespace(drift=found, scale=scale_of_whole(), remarks=[], modes={})
    assert judgement._places(told).severity == (CAUTION if drifts else SUPPORT)


def test_places_of_one_lot_err_alike_and_those_of_others_do_not():
    place = np.array([[0.0, 0.0], [1000.0, 0.0], [9000.0, 0.0]])
    cells = Cells(place, place, np.ones(3), np.zeros(3), np.full(3, 0.01), (1.0, 1.0))
    covariance = cells.covariance(1000.0, 0.02)
    assert np.diag(covariance) == pytest.approx(0.02**2 + 0.01**2)
    assert covariance[0, 1] == pytest.approx(0.02**2 / np.e) and covariance[0, 2] < 1e-7


def test_cells_that_scatter_less_than_they_may_make_no_drift_surer():
    """Half a sigma to each end is little, however straight it is."""
    x = np.linspace(-1, 1, 20)
    flat, tilted = (SurfaceFit.of(terms, 0.5 * x, np.eye(20)) for terms in (np.ones((20, 1)), np.stack([x**0, x], 1)))
    assert 0.1 < tilted.p_against(flat) < 0.3
    assert tilted.covariance[1, 1] == pytest.approx(1 / (x**2).sum())


@pytest.mark.parametrize(
    "amplitude, sd, word",
    [
        (0.0, 0.025, "good"),
        (0.04, 0.025, "good"),  # within the interval of 8 %, and 1.2 % of one sigma beside 2.5 %
        (0.05, 0.020, "good"),  # more than half of it does not exclude each other's scale
        (0.07, 0.025, "fair"),  # 2.0 % and 2.5 % are 3.2 %
        (0.05, 0.010, "fair"),  # 1.4 % and 1.0 % are still good; but the ends exclude each other's scale
        (0.30, 0.025, "poor"),
        (0.52, 0.025, "unusable"),  # from 15 % of one sigma
    ],
)
def test_a_drift_is_a_part_of_the_uncertainty_and_lowers_the_verdict(amplitude, sd, word):
    before = scale_of_whole(sd)
    after = with_drift(before, amplitude, [Remark(CAUTION, "the scale drifts", check=ON_PLACES)] if amplitude else [])
    assert after.verdict == word and after.value == before.value
    # Of a change that is spread evenly over the source, one sigma is the amplitude over the root of twelve.
    evenly = np.linspace(-amplitude / 2, amplitude / 2, 100_001).std()
    assert after.relative_sd == pytest.approx(np.hypot(sd, evenly), rel=1e-4)
    assert np.log(after.interval90[1] / after.interval90[0]) == pytest.approx(2 * Z90 * after.relative_sd, rel=1e-9)
    severities = [remark.severity for remark in after.remarks]
    assert severities == ([] if amplitude == 0 else [REFUSAL if word == "unusable" else CAUTION])
    assert all(remark.check == ON_PLACES for remark in after.remarks)


@pytest.mark.parametrize("change, verdicts", [(0.02, {"good", "fair"}), (0.25, {"poor"}), (0.6, {"unusable"})])
def test_a_scene_whose_scale_drifts_is_judged_by_it(tmp_path, change, verdicts):
    """Cars of known size in a picture whose pixels grow from left to right: found, measured and judged as a whole."""
    park = drifting_park(tmp_path, change)
    result = orthoscale.estimate(park, fleet="DE", detections=tmp_path / "detections.json", anchors=["none"])
    scale = result.scale
    assert scale.verdict in verdicts
    local = GSD * (1 + change * np.linspace(-0.5, 0.5, 101))
    inside = (local > scale.interval90[0]) & (local < scale.interval90[1])
    assert inside.mean() > 0.8, "the interval is that of any place"
    assert ("drift" in scale.parts) == (change > 0.02)
    found = result.measured
    anew = drift(found.vehicles, 2000, 1500, scale.value)
    assert found.drift.trend.p_tilt == pytest.approx(anew.trend.p_tilt, rel=0.01)
    if verdicts != {"unusable"}:
        assert result.disagreement is None
    else:
        with pytest.raises(EvidenceDisagrees, match=r"the scale grows by \d\d\.\d % towards the right"):
            result.require_useful()


def drifting_park(folder, change):
    """400 cars on a picture of 2000 x 1500 px whose GSD grows by `change` from its left side to its right."""
    random = np.random.default_rng(11)
    place = random.permutation(np.stack(np.meshgrid(np.arange(25), np.arange(16)), -1).reshape(-1, 2)) * (78, 90) + 60
    local = GSD * (1 + change * (place[:, :1] / 2000 - 0.5))
    sizes = load_fleet("DE").sample(random, len(place))[:, :2] / local
    boxes = [
        {"cx": float(x), "cy": float(y), "length": float(a), "width": float(b), "angle": 0.3, "score": 0.9}
        for (x, y), (a, b) in zip(place, sizes, strict=True)
    ]
    cv2.imwrite(str(folder / "park.png"), np.zeros((1500, 2000, 3), np.uint8))
    head = {"detector": "known", "detector_sha256": "", "zoom": 1.0, "effective_height": [0.7, 0.5]}
    ruler = {"margin": [0.0, 0.0], "margin_sd": [0.1, 0.1], "noise": [0.3, 0.3]}
    text = json.dumps({**head, "ruler": ruler, "pictures": {"park.png": boxes}})
    (folder / "detections.json").write_text(text)
    return folder / "park.png"


def test_boxes_that_are_all_alike_show_no_drift(capfd):
    """They scatter not at all, which is no reason to be infinitely sure."""
    place = np.random.default_rng(7).random((200, 2)) * (WIDTH, HEIGHT)
    size = np.tile([44.0, 18.0], (200, 1))
    votes = gather(Sightings(size, np.ones(200), place, np.ones(200)), repeated=False)
    result = drift(table(votes), WIDTH, HEIGHT, GSD)
    assert result.warnings == [] and np.isfinite(result.trend.tilt_sd)
    assert capfd.readouterr() == ("", "")
