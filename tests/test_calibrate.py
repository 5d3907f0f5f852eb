"""Calibration: a margin that is known comes back, from simulated boxes and through the whole program."""

import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import orthoscale
from orthoscale.actions.calibrate import box_noise, measure_ruler, same_vehicles
from orthoscale.cli.main import cli
from orthoscale.core.boxes import Boxes
from orthoscale.core.calibration import Calibration, fit_margin, local_fleet_entry
from orthoscale.core.detections import UNKNOWN_RULER
from orthoscale.core.fleet import Fleet
from orthoscale.core.ruler import Ruler
from orthoscale.errors import InputError, TooLittleEvidence, UsageError
from orthoscale.fleets import load_fleet
from orthoscale.formats.calibration import load_calibration, save_calibration
from orthoscale.sources.country import country_of
from orthoscale.sources.raster import RasterSource

GSD = 0.1
ZOOMS = np.array([0.6, 0.85, 1.2])


def looks_at(sizes, margin, noise, rng):
    """Boxes [px of the picture] of vehicles of `sizes` (N, 2) [m] at ZOOMS, `margin` and `noise` in detector px."""
    spots = np.stack(np.meshgrid(np.arange(len(sizes)) * 70.0, [50.0]), -1).reshape(-1, 2)
    return [
        Boxes(
            np.column_stack([spots, sizes / GSD + (margin + noise * rng.standard_normal(sizes.shape)) / z,
                             np.zeros(len(sizes))]),
            np.full(len(sizes), 0.9),
        )
        for z in ZOOMS
    ]  # fmt: skip


def test_exact_sizes_and_margins_are_solved_for():
    pixel = np.array([0.08, 0.11, 0.16])
    fit = fit_margin(4.4 + 2.5 * pixel, pixel, np.full(3, 0.01), (4.6, 9.0), (0.0, 99.0))
    assert (fit.size, fit.margin) == (pytest.approx(4.4, abs=0.001), pytest.approx(2.5, abs=0.01))
    held = fit_margin(4.4 + 2.5 * pixel, pixel, np.full(3, 9.0), (4.4, 0.001), (0.0, 1e4))
    assert held.margin == pytest.approx(2.5, abs=0.01), "without the zooms' help the fleet tells the margin"
    assert held.margin_sd < 99


def test_a_contradiction_widens():
    pixel = np.array([0.08, 0.11, 0.16])
    agreed = fit_margin(4.4 + 0 * pixel, pixel, np.full(3, 0.05), (4.4, 0.1), (0.0, 0.5))
    torn = fit_margin(4.4 + 4 * pixel, pixel, np.full(3, 0.05), (4.4, 0.1), (0.0, 0.5))
    assert torn.margin_sd > 1.5 * agreed.margin_sd


@pytest.mark.parametrize("ruler", [UNKNOWN_RULER, Ruler()], ids=["unknown detector", "detector with a card"])
def test_the_margin_is_within_what_is_said_of_it(ruler):
    """Places whose fleet, margin and boxes stray as much as they claim to."""
    fleet = load_fleet("DE")
    pulls = []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        margin = np.array([3.0, 2.0]) if ruler is UNKNOWN_RULER else rng.normal(ruler.margin, ruler.margin_sd)
        stray = np.exp(rng.multivariate_normal([0, 0], fleet.log_mean_covariance + ruler.common_sd**2))
        sizes = fleet.sample(rng, 80)[:, :2] * stray
        looks = looks_at(sizes, margin, np.array([2.0, 1.2]), rng)
        got, fits, sizes, _ = measure_ruler(looks, ZOOMS, GSD, fleet, ruler)
        pulls.append((np.array(got.margin) - margin) / got.margin_sd)
        assert len(sizes) > 60 and fits[0].margin == got.margin[0]
    spread = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert (spread > 0.5).all() and (spread < 1.4).all()
    assert np.abs(np.mean(pulls, axis=0)).max() < 0.6


@pytest.mark.parametrize("ruler", [Ruler(common_sd=0.03), Ruler(bias_sd=(0.05, 0.06))], ids=["alike", "each axis"])
def test_sizes_are_known_no_better_than_what_all_boxes_share(ruler):
    """A detector that draws all vehicles of a place too large or small alike, at all zooms."""
    fleet = load_fleet("DE")
    shared = np.hypot(ruler.bias_sd, ruler.common_sd)
    pulls = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        margin = rng.normal(ruler.margin, ruler.margin_sd)
        stray = np.exp(rng.multivariate_normal([0, 0], fleet.log_mean_covariance))
        true = fleet.sample(rng, 80)[:, :2] * stray
        drawn = np.exp(rng.normal(0, ruler.bias_sd) + rng.normal(0, ruler.common_sd))
        _, fits, sizes, _ = measure_ruler(
            looks_at(true * drawn, margin, np.array([2.0, 1.2]), rng), ZOOMS, GSD, fleet, ruler
        )
        known = np.array([fit.size_sd / fit.size for fit in fits])
        assert (known > shared).all()
        pulls.append(np.log(np.median(sizes, axis=0) / np.median(true, axis=0)) / known)
    spread = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert (spread > 0.6).all() and (spread < 1.2).all()


def test_box_noise_comes_back():
    rng = np.random.default_rng(1)
    looks = looks_at(load_fleet("US").sample(rng, 600)[:, :2], 0.0, np.array([2.0, 1.2]), rng)
    assert box_noise(looks, ZOOMS) == pytest.approx((2.0, 1.2), rel=0.15)


def test_only_vehicles_that_all_looks_show_count():
    rng = np.random.default_rng(2)
    fine, middle, coarse = looks_at(np.full((5, 2), [4.4, 1.8]), 0.0, 0.1, rng)
    here = same_vehicles([fine[np.array([4, 1, 2])], middle[np.array([0, 2, 4])], coarse[np.array([2, 4, 3, 1])]])
    assert [look.centre[:, 0].tolist() for look in here] in ([[140.0, 280.0]] * 3, [[280.0, 140.0]] * 3)


def test_vehicles_of_another_scale_are_refused():
    rng = np.random.default_rng(0)
    looks = looks_at(load_fleet("DE").sample(rng, 60)[:, :2] * 2, 0.0, 1.0, rng)
    with pytest.raises(InputError, match="would be"):
        measure_ruler(looks, ZOOMS, GSD, load_fleet("DE"), Ruler())


@pytest.mark.parametrize(("factor", "said"), [(0.8, "-"), (0.95, ""), (1.05, ""), (1.25, "+")])
def test_vehicles_of_a_scale_that_is_somewhat_wrong_are_said(factor, said):
    """A ruler measured at a scale 20 % off was written without a word."""
    rng = np.random.default_rng(0)
    looks = looks_at(load_fleet("DE").sample(rng, 200)[:, :2] * factor, 0.0, 1.0, rng)
    _, _, _, doubts = measure_ruler(looks, ZOOMS, GSD, load_fleet("DE"), Ruler())
    assert [f"fleet DE by {said}" in doubt and "check the scale" in doubt for doubt in doubts] == [True] * bool(said)


def test_a_local_fleet_has_the_sizes_that_were_measured_without_their_noise():
    rng, germany = np.random.default_rng(3), load_fleet("DE")
    noise = np.array([0.2, 0.12])
    size = 1.1 * germany.sample(rng, 4000)[:, :2] + rng.normal(0, noise, (4000, 2))
    size[:100] = 6.5, 2.1  # lorries
    local = Fleet.from_entry("x", local_fleet_entry(size, noise, np.array([0.01, 0.02]), load_fleet("US"), "n", "s"))
    assert local.mean[:2] == pytest.approx(1.1 * germany.mean[:2], rel=0.02)
    assert local.sd[:2] == pytest.approx(1.1 * germany.sd[:2], rel=0.3)  # a flat mixture has a wide middle
    assert local.mean_sd[:2] == pytest.approx(local.mean[:2] * [0.01, 0.02], rel=0.01)


@pytest.mark.parametrize("code, country", [("US", "US"), ("US_TX", "US"), ("world", "")])
def test_a_local_fleet_keeps_the_country_whose_standards_hold_there(tmp_path, code, country):
    """Else its lane dashes do not count: "the country is not known". So may a fleet of one's own name it."""
    fleet = load_fleet(code)
    size = fleet.sample(np.random.default_rng(3), 400)[:, :2]
    entry = local_fleet_entry(size, np.array([0.1, 0.1]), np.array([0.01, 0.02]), fleet, "n", "s")
    (tmp_path / "here.json").write_text(json.dumps(entry))
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((64, 64, 3), np.uint8))
    for local in (Fleet.from_entry("local", entry), load_fleet(tmp_path / "here.json")):
        with RasterSource.open(tmp_path / "a.png") as nowhere:
            assert country_of(nowhere, local) == country
    (tmp_path / "here.json").write_text(json.dumps(entry | {"country": "Germany"}))
    with pytest.raises(InputError, match="country"):
        load_fleet(tmp_path / "here.json")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A picture at 0.1 m/px and a network that boxes its 60 German vehicles 3 px too long and 2 px too wide, at any
    zoom, which it reads off a white square of 100 px."""
    onnx = pytest.importorskip("onnx")
    helper, numpy_helper = onnx.helper, onnx.numpy_helper
    folder = tmp_path_factory.mktemp("place")
    image = np.full((800, 800, 3), 60, np.uint8)
    image[600:700, 600:700] = 255
    cv2.imwrite(str(folder / "place.png"), image)
    n = 60
    rng = np.random.default_rng(5)
    sizes = load_fleet("DE").sample(rng, n)[:, :2] / GSD
    spots = np.stack(np.meshgrid(np.arange(10) * 65 + 60.0, np.arange(6) * 65 + 60.0), -1).reshape(-1, 2)
    sized = np.column_stack([spots, sizes, np.zeros((n, 2))])[None]
    rest = np.tile([0, 0, 3, 2, 0.3, 0.9], (n, 1))[None]
    nodes = [
        helper.make_node("Greater", ["images", "half"], ["white"]),
        helper.make_node("Cast", ["white"], ["white_share"], to=1),
        helper.make_node("ReduceSum", ["white_share"], ["area"], keepdims=0),
        helper.make_node("Mul", ["area", "per_area"], ["zoom_squared"]),
        helper.make_node("Sqrt", ["zoom_squared"], ["zoom"]),
        helper.make_node("Mul", ["sized", "zoom"], ["boxes"]),
        helper.make_node("Add", ["boxes", "rest"], ["dets"]),
        helper.make_node("Identity", ["fours"], ["labels"]),
    ]
    weights = {"sized": np.float32(sized), "rest": np.float32(rest), "fours": np.full((1, n), 4),
               "half": np.float32(0.7), "per_area": np.float32(1 / 3 / 100**2)}  # fmt: skip
    graph = helper.make_graph(
        nodes,
        "margins",
        [helper.make_tensor_value_info("images", 1, [1, 3, "h", "w"])],
        [helper.make_tensor_value_info("dets", 1, [1, n, 6]), helper.make_tensor_value_info("labels", 7, [1, n])],
        [numpy_helper.from_array(w, name) for name, w in weights.items()],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), folder / "net.onnx")
    return folder


def command(*words):
    return CliRunner().invoke(cli, [str(w) for w in words])


def test_a_calibration_from_a_picture_whose_name_is_not_utf_8_reads_back(tmp_path):
    made_from = {"orthophoto": "caf\udce9.tif"}
    save_calibration(Calibration("net", "", UNKNOWN_RULER, None, made_from), tmp_path / "ruler.json")
    assert load_calibration(tmp_path / "ruler.json").made_from == {"orthophoto": r"caf\udce9.tif"}


@pytest.mark.slow
def test_a_calibrated_detector_measures_better(place, tmp_path):
    common = ["--detector", place / "net.onnx", "--fleet", "DE"]
    out = tmp_path / "ruler.json"
    result = command("calibrate", place / "place.png", "--gsd", GSD, *common, "--out", out)
    assert result.exception is None, result.output
    assert "60, at 0.1 m/px, against fleet DE" in result.output
    ruler = load_calibration(out).ruler
    assert ruler.margin == pytest.approx((3, 2), abs=0.8)
    assert ruler.noise[0] < 1

    options = {"detector": place / "net.onnx", "zoom": 0.9, "fleet": "DE"}
    before = orthoscale.estimate(place / "place.png", **options)
    after = orthoscale.estimate(place / "place.png", calibration=out, **options)
    assert before.scale.value < 0.96 * GSD
    assert after.scale.value == pytest.approx(GSD, rel=0.03)
    assert after.scale.relative_sd < before.scale.relative_sd
    assert after.detections.ruler == ruler


@pytest.mark.parametrize("detector", [None, "other.onnx"])
def test_what_calibrating_the_built_in_detector_costs_is_said(tmp_path, monkeypatch, detector):
    """Its boxes are measured again unless there is a calibration: on manila +-5.2 % became +-6.9 %."""
    made = {"size_m": (4.4, 1.8), "size_sd_m": (0.1, 0.1), "vehicles": 60, "gsd_m": 0.1, "fleet": "DE", "notes": []}
    ready = Calibration("a detector", "ff", Ruler(), None, made)
    monkeypatch.setattr("orthoscale.actions.calibrate.calibrate", lambda *given, **options: ready)
    words = [] if detector is None else ["--detector", tmp_path / detector]
    said = command("calibrate", tmp_path / "place.png", "--fleet", "DE", *words).output
    assert ("less certain with this file than without it" in said) == (detector is None), said
    assert said.count(" px (1 sigma)") == 2, said
    save_calibration(ready, tmp_path / "here.json")
    with pytest.raises(InputError, match="not a fleet") as refused:
        load_fleet(tmp_path / "here.json")
    assert "given by --calibration" in refused.value.hint


@pytest.mark.slow
def test_the_local_fleet_travels_with_the_file(place, tmp_path):
    out = tmp_path / "ruler.json"
    words = ["calibrate", place / "place.png", "--gsd", GSD, "--detector", place / "net.onnx", "--fleet", "US"]
    result = command(*words, "--local-fleet", "--out", out, "--json")
    assert result.exception is None, result.output
    told = json.loads(result.output)
    assert told.items() <= json.loads(out.read_text()).items()
    american = load_fleet("US").mean
    assert told["fleet"]["length"][0] < american[0], "these are German vehicles"
    options = {"detector": place / "net.onnx", "zoom": 0.9, "calibration": out}
    local = orthoscale.estimate(place / "place.png", **options)
    assert local.fleet.code == "local" and local.scale.value == pytest.approx(GSD, rel=0.03)
    assert orthoscale.estimate(place / "place.png", fleet="DE", **options).fleet.code == "DE"


def test_a_calibration_is_for_its_own_detector(place, tmp_path):
    out = tmp_path / "ruler.json"
    save_calibration(Calibration("another", "ff", Ruler(), None, {}), out)
    with pytest.raises(UsageError, match="was measured for another, not for "):
        orthoscale.estimate(place / "place.png", detector=place / "net.onnx", zoom=0.9, calibration=out)


def test_a_calibration_of_another_detector_is_refused_before_the_sweep(place, tmp_path):
    """Where the detector found nothing, the scale came from anchors alone and nobody heard of it; nor did --dry-run
    say so."""
    out, empty = tmp_path / "ruler.json", tmp_path / "empty.jpg"
    save_calibration(Calibration("another", "ff", Ruler(), None, {}), out)
    cv2.imwrite(str(empty), np.full((200, 200, 3), 60, np.uint8))
    options = ["--detector", place / "net.onnx", "--calibration", out]
    for words in (["estimate", empty], ["estimate", empty, "--dry-run"], ["photo", empty, "--focal-px", 300]):
        result = command(*words, *options)
        assert isinstance(result.exception, UsageError) and "was measured for another" in str(result.exception)


def test_what_cannot_be_calibrated(place, tmp_path):
    from orthoscale.actions.calibrate import calibrate

    with pytest.raises(UsageError, match="scale is not known"):
        calibrate(place / "place.png", detector=place / "net.onnx")
    with pytest.raises(UsageError, match="positive"):
        calibrate(place / "place.png", gsd=-1)
    with pytest.raises((InputError, TooLittleEvidence)):
        calibrate(place / "place.png", gsd=0.3, detector=place / "net.onnx", fleet="DE")
    with pytest.raises(UsageError, match="would search for vehicles"):
        calibrate(place / "place.png", gsd=20, detector=place / "net.onnx")
    cv2.imwrite(str(tmp_path / "empty.png"), np.full((200, 200, 3), 60, np.uint8))
    with pytest.raises(TooLittleEvidence, match="0 vehicles detected at all three resampling factors"):
        calibrate(tmp_path / "empty.png", gsd=0.1, detector=place / "net.onnx", fleet="DE")


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"kind": "another"}', '{"kind": "orthoscale calibration 1", "detector": "x"}',
             '{"kind": "orthoscale calibration 1", "detector": "x", "detector_sha256": "", "ruler": {},'
             ' "fleet": {"name": "x"}, "made_from": {}}']
)  # fmt: skip
def test_a_file_that_is_no_calibration(tmp_path, text):
    (tmp_path / "bad.json").write_text(text)
    with pytest.raises(InputError, match=r"bad\.json: not a calibration"):
        load_calibration(tmp_path / "bad.json")
    with pytest.raises(InputError, match="cannot be read"):
        load_calibration(tmp_path / "none.json")
